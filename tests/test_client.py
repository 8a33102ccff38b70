"""The wire format and the client, against servers made here."""

import re
import subprocess
import sys
import threading
import time
import venv
from pathlib import Path

import msgpack
import numpy as np
import pytest
import websockets
from policy_servers import socket_server

from jaxcam.client import Client, from_wire, to_wire
from jaxcam.errors import PortError


def echo(connection):
    """Answers with the sum of an observation's state, as a chunk of one number."""
    connection.send(to_wire({"name": "echo"}))
    for message in connection:
        state = from_wire(message)["observation.state"]
        connection.send(to_wire({"actions": state.sum(keepdims=True)[None]}))


@pytest.mark.parametrize(
    "array",
    [
        np.arange(24, dtype=np.uint8).reshape(2, 4, 3),
        np.array(2.5),
        np.zeros((0, 3), np.float32),
        np.array([True, False]),
        np.array(["lift", "can"]),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.arange(3, dtype=">i4"),
    ],
)
def test_arrays_come_back_as_they_were(array):
    back = from_wire(to_wire({"x": array}))["x"]
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back, array)


def test_other_things_come_back_as_they_were():
    message = {"prompt": "lift", "list": [1, 2.5, None, True], "nested": {"n": np.float32(2)}}
    assert from_wire(to_wire(message)) == message


def test_bytes_are_those_of_openpi():
    """Keys of an array's header are bytes; openpi's description of its format."""
    header = msgpack.unpackb(to_wire(np.float32([1, 2])), strict_map_key=False)
    assert header == {
        b"__ndarray__": True,
        b"data": np.float32([1, 2]).tobytes(),
        b"dtype": "<f4",
        b"shape": [2],
    }


@pytest.mark.parametrize("value", [object(), np.array([object()]), np.zeros(2, complex), {1, 2}])
def test_what_is_no_data_is_not_sent(value):
    with pytest.raises(PortError, match="cannot be sent"):
        to_wire({"x": value})


def header(**changes):
    values = {"__ndarray__": True, "data": bytes(8), "dtype": "<f4", "shape": [2]} | changes
    return msgpack.packb({k.encode(): v for k, v in values.items() if v is not None})


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\xc1", "msgpack"),
        (b"", "msgpack"),
        (to_wire({"a": 1})[:-1], "msgpack"),
        (b"\x91" * 100_000, "msgpack"),
        (header(dtype="|O"), "not taken"),
        (header(dtype="<c8"), "not taken"),
        (header(dtype="nonsense"), "not taken"),
        (header(dtype=None), "damaged"),
        (header(shape=[3]), "8 bytes"),
        (header(shape=[2**40, 2**40]), "8 bytes"),
        (header(shape=[-2]), "damaged"),
        (header(shape=7), "damaged"),
        (header(dtype="(2,)<f4", shape=[1]), "not taken"),
        (header(dtype="(2,)f4,("), "not taken"),
        (header(dtype="(" * 5000), "not taken"),
        (header(dtype=7), "not taken"),
        (header(dtype="<f7"), "damaged"),
        (b"\xdd\x00\x02\x00\x00" + b"\x80" * 2**17, "more than 100000"),
        (b"\xdd\x00\x02\x00\x00" + b"\x90" * 2**17, "more than 100000"),
        (b"\xd4\x01\x00", "sender's own"),
    ],
)
def test_damaged_messages_are_refused(data, words):
    with pytest.raises(PortError, match=words):
        from_wire(data)


def test_a_client_asks_and_reads_what_the_server_is():
    with socket_server(echo) as url, Client(url) as client:
        assert client.metadata == {"name": "echo"}
        answer = client.infer({"observation.state": np.float32([1, 2, 3])})
        np.testing.assert_array_equal(answer["actions"], [[6]])


def test_a_lost_connection_is_made_again():
    def once(connection):
        connection.send(to_wire({}))
        connection.send(to_wire({"actions": from_wire(connection.recv())["x"]}))

    with socket_server(once) as url, Client(url) as client:
        for i in range(3):
            answer = client.infer({"x": np.full((1, 1), i)})
            np.testing.assert_array_equal(answer["actions"], [[i]])
        assert client.reconnects == 2


def test_words_of_the_server_are_the_error():
    def refuse(connection):
        connection.send(to_wire({}))
        for _ in connection:
            connection.send("no picture of view wrist")

    with socket_server(refuse) as url, Client(url) as client:
        for _ in range(2):
            with pytest.raises(PortError, match="no picture of view wrist"):
                client.infer({"x": 1})


def test_a_late_answer_is_not_taken_for_the_next():
    begun = threading.Event()

    def slow_once(connection):
        connection.send(to_wire({}))
        for message in connection:
            number = from_wire(message)["x"]
            if not begun.is_set():
                begun.set()
                threading.Event().wait(0.3)
            connection.send(to_wire({"actions": number}))

    with socket_server(slow_once) as url, Client(url, timeout=0.1) as client:
        with pytest.raises(PortError, match=r"did not answer within 0\.1 s"):
            client.infer({"x": 1})
        assert client.infer({"x": 2})["actions"] == 2


def test_only_servers_that_know_of_episodes_hear_of_them():
    heard = []

    def knows(connection):
        connection.send(to_wire({"controls": ["episode_start"]}))
        for message in connection:
            heard.append(from_wire(message))
            connection.send(to_wire({"__ack__": "episode_start"}))

    with socket_server(knows) as url, Client(url) as client:
        client.reset()
    assert heard == [{"__ctrl__": "episode_start"}]
    with socket_server(echo) as url, Client(url) as client:
        client.reset()
        assert client.infer({"observation.state": np.ones(1)})["actions"] == 1
        client.metadata = {"controls": 5}
        client.reset()


@pytest.mark.parametrize("first", ["hello", to_wire([1]), b"\xff rubbish"])
def test_a_server_of_another_kind_is_refused(first):
    with (
        socket_server(lambda connection: connection.send(first)) as url,
        pytest.raises(PortError, match="did not begin"),
    ):
        Client(url)


@pytest.mark.parametrize(
    "url",
    ["http://127.0.0.1:1", "nonsense", "ws://127.0.0.1:1", "ws://localhost:99999", "ws://[::1"],
)
def test_an_address_without_a_server_is_told(url):
    with pytest.raises(PortError, match=re.escape(url)):
        Client(url, patience=0.0)


@pytest.mark.parametrize(
    "url",
    ["", "ws://", "ws://x y", "ws://[::1", "ws://a..b:1", "ws://" + "a" * 70, "ws://127.0.0.1:0"]
    + [f"ws://localhost:{port}" for port in ("abc", "99999", "-1")],
)
def test_what_is_no_address_is_refused(url):
    with pytest.raises(PortError, match="is no address of a policy server"):
        Client(url, patience=0.0)


@pytest.mark.parametrize("key", ["two words", "two\nlines", "schlüssel"])
def test_what_is_no_key_is_not_sent(key):
    with pytest.raises(PortError, match="one word of ASCII"):
        Client("ws://127.0.0.1:1", key=key)


def test_no_proxy_is_asked_for_the_way_to_this_machine(monkeypatch):
    for name in ("http_proxy", "https_proxy", "socks_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    with socket_server(echo) as url, Client(url) as client:
        assert client.metadata == {"name": "echo"}
    monkeypatch.setenv("https_proxy", "nonsense")
    monkeypatch.delenv("socks_proxy")
    with pytest.raises(PortError, match="through the proxy that the environment names"):
        Client("ws://192.0.2.1:1", patience=0.0)


def test_an_answer_without_actions_is_refused():
    def empty(connection):
        connection.send(to_wire({}))
        for _ in connection:
            connection.send(to_wire({"server_timing": {}}))

    with (
        socket_server(empty) as url,
        Client(url) as client,
        pytest.raises(PortError, match="without actions"),
    ):
        client.infer({})


def test_a_robot_needs_three_packages_only(tmp_path):
    """In an environment of its own that sees jaxcam's files, NumPy, msgpack and websockets."""
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    site = tmp_path / "site"
    site.mkdir()
    packages = {np: "numpy", msgpack: "msgpack"}

    packages |= {websockets: "websockets", sys.modules["jaxcam"]: "jaxcam"}
    for module, name in packages.items():
        folder = Path(module.__file__).parent
        (site / name).symlink_to(folder)
        libraries = folder.with_name(f"{name}.libs")  # NumPy's wheel has its BLAS beside it
        if libraries.is_dir():
            (site / libraries.name).symlink_to(libraries)
    program = "import jaxcam.client as c; print(c.from_wire(c.to_wire({'x': 1})))"
    result = subprocess.run(
        [python, "-c", program], env={"PYTHONPATH": str(site)}, capture_output=True, text=True
    )
    assert result.stdout.strip() == "{'x': 1}", result.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the time of sending")
def test_a_server_that_takes_nothing_is_given_up():
    """Its process hangs: what is sent fills the buffers between the two, and then waits."""
    quit_now = threading.Event()

    def deaf(connection):
        connection.send(to_wire({}))
        quit_now.wait(20)

    with socket_server(deaf, max_queue=1) as url, Client(url, timeout=0.3, patience=0.0) as client:
        began = time.monotonic()
        with pytest.raises(PortError):
            client.infer({"image": np.zeros((4000, 4000, 3), np.uint8)})
        quit_now.set()
        assert time.monotonic() - began < 15
