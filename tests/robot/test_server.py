"""The server on a real socket: good clients, bad ones, and both at once."""

import re
import socket
import threading
import time
import urllib.error
import urllib.request
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from served_runs import linear_request, linear_service, local_chunks, serving
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from jaxcam.client import Client, from_wire, to_wire
from jaxcam.errors import PortError
from jaxcam.robot.server import Limits

WIDTH = 3


@pytest.fixture(scope="module")
def service():
    return linear_service(width=WIDTH)


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def url(service, lines):
    with serving(service, lines=lines, limits=Limits(largest=2**20)) as address:
        yield address


def get(url, path, **headers):
    request = urllib.request.Request(url.replace("ws:", "http:") + path, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=5) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with closing(error):
            return error.code, error.read().decode()


def exchange(connection, message):
    connection.send(message)
    return connection.recv(5)


def until(condition):
    for _ in range(100):
        if condition():
            return True
        time.sleep(0.02)
    return False


def test_a_client_is_told_what_the_server_is_and_gets_chunks(service, url, lines):
    requests = [linear_request(seed, row=seed) for seed in range(WIDTH)]
    local = local_chunks(service, requests)
    with Client(url) as client:
        assert client.metadata["views"] == ["front"]
        assert client.metadata["action_names"] == ["dx", "dy"]
        for message, chunk in zip(requests, local, strict=True):
            answer = client.infer(message)
            assert answer["actions"].tobytes() == chunk.tobytes()
            assert answer["actions"].dtype == np.float32
        assert answer["server_timing"]["infer_ms"] > 0
        assert answer["server_timing"]["prev_total_ms"] > 0
        client.reset()
    assert until(lambda: any("gone after 4 requests; 0 clients." in line for line in lines))
    assert re.search(r"127\.0\.0\.1:\d+ came; 1 client\.", " ".join(lines))


def test_clients_who_ask_together_get_what_they_would_get_alone(service, url):
    requests = [linear_request(seed, row=seed % WIDTH) for seed in range(2 * WIDTH)]
    local = np.concatenate(
        [local_chunks(service, requests[:WIDTH]), local_chunks(service, requests[WIDTH:])]
    )
    wrong = []

    def ask(number):
        with Client(url) as client:
            for _ in range(20):
                actions = client.infer(requests[number])["actions"]
                if actions.tobytes() != local[number].tobytes():
                    wrong.append(number)

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(len(requests))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert wrong == []


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("hello", "Expected a binary message, .* got text: 'hello'"),
        (b"\xc1garbage", "Expected a message in msgpack"),
        (b"", "Expected a message in msgpack"),
        (to_wire([1, 2]), "entries by their names, got list"),
        (to_wire({"__ctrl__": "dance"}), "Unknown __ctrl__ 'dance'"),
        (to_wire({}), "expected these: observation.images.front; got none"),
        (to_wire({b"__ndarray__": True}), "damaged"),
        (to_wire(linear_request(observation__state=np.full(3, np.nan))), "finite numbers"),
        (to_wire(linear_request(observation__state=None)), "observation.state is missing"),
    ],
)
def test_a_bad_message_is_answered_and_the_next_one_served(url, message, words):
    with connect(url, compression=None) as connection:
        connection.recv(5)
        connection.send(message)
        answer = connection.recv(5)
        assert isinstance(answer, str)
        assert re.search(words, answer)
        connection.send(to_wire(linear_request()))
        assert from_wire(connection.recv(5))["actions"].shape == (2, 2)


def test_a_huge_message_ends_its_connection_and_says_why(url):
    with connect(url, compression=None) as connection:
        connection.recv(5)
        with pytest.raises(ConnectionClosed, match=r"1009 .*1048576"):
            exchange(connection, bytes(2**20 + 1))
    with Client(url) as client:
        assert client.infer(linear_request())["actions"].shape == (2, 2)


def test_each_client_has_its_own_history():
    with serving(linear_service(obs_steps=2)) as url, Client(url) as one, Client(url) as two:
        assert one.metadata["observation_steps"] == 2
        first = [c.infer(linear_request(i))["actions"] for i, c in enumerate((one, two))]
        again = [c.infer(linear_request(i))["actions"] for i, c in enumerate((one, two))]
    np.testing.assert_array_equal(first, again)


def test_chance_is_the_same_again_from_the_start_of_an_episode():
    with serving(linear_service(noise=True)) as url, Client(url) as client:
        first = [client.infer(linear_request())["actions"] for _ in range(2)]
        assert not np.array_equal(*first)
        client.reset()
        np.testing.assert_array_equal(client.infer(linear_request())["actions"], first[0])
        again = client.infer(linear_request(call=1, row=0))["actions"]
        np.testing.assert_array_equal(again, first[1])


def test_health_and_what_is_no_client(url):
    assert get(url, "/healthz") == (200, "OK\n")
    assert get(url, "/")[0] == 426
    with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2]))) as rubbish:
        rubbish.sendall(b"\x16\x03\x01 this is no HTTP\r\n\r\n")
        assert rubbish.recv(100) == b""
    assert get(url, "/healthz") == (200, "OK\n")


def test_a_client_that_goes_with_words_writes_no_line_of_its_own(url, lines):
    with connect(url) as client:
        client.close(4000, "bye\nServing something else \x1b[31m")
    assert until(lambda: any("bye" in line for line in lines))
    assert not any("\n" in line or "\x1b" in line for line in lines)


def test_pages_in_a_browser_are_refused(url):
    with pytest.raises(InvalidStatus, match="403"), connect(url, origin=Origin("http://a.com")):
        pass


def test_a_key_is_asked_for_in_the_handshake(service):
    with serving(service, key="sesame") as url:
        assert get(url, "/healthz")[0] == 200
        headers = {"Authorization": "Api-Key schlüssel"}
        with pytest.raises(InvalidStatus, match="401"):
            connect(url, additional_headers=headers).close()
        for key in (None, "sesam", "sesame2"):
            with pytest.raises(PortError, match=r"401\. It says: The key is missing or wrong"):
                Client(url, key=key, patience=1)
        with Client(url, key="sesame") as client:
            assert client.infer(linear_request())["actions"].shape == (2, 2)


def test_more_clients_than_there_is_room_for_are_turned_away(service):
    with serving(service, limits=Limits(clients=1)) as url:
        with (
            Client(url),
            pytest.raises(PortError, match=r"503\. It says: There is room for 1"),
        ):
            Client(url, patience=1)
        assert until(lambda: _comes_in(url))


def _comes_in(url):
    try:
        with Client(url, patience=0):
            return True
    except PortError:
        return False


def test_more_requests_than_a_client_may_make_are_refused(service):
    with serving(service, limits=Limits(per_second=3)) as url, Client(url) as client:
        for _ in range(3):
            client.infer(linear_request())
        with pytest.raises(PortError, match="More than 3 requests a second"):
            client.infer(linear_request())
        time.sleep(0.5)
        assert client.infer(linear_request())["actions"].shape == (2, 2)


def test_a_client_that_takes_no_answers_is_let_go(service, monkeypatch):
    monkeypatch.setattr("jaxcam.robot.server.SLOW", 0.2)

    class Talkative(type(service)):
        def metadata(self):
            return {"words": bytes(2**25)}

    lines = []
    talkative = Talkative(**vars(service))
    with serving(talkative, lines=lines) as url:
        port = int(url.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as deaf:
            deaf.sendall(
                b"GET / HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
            )
            assert until(lambda: any("took no answer" in line for line in lines))


def test_a_policy_that_fails_fails_at_one_request(service, caplog):
    failing = replace(service, policy=linear_service().policy)
    with serving(failing) as url, Client(url) as client:
        real = failing.policy.chunks
        failing.policy.chunks = lambda asked: 1 / 0
        with pytest.raises(PortError, match=r"The server failed .*ZeroDivisionError.*goes on"):
            client.infer(linear_request())
        failing.policy.chunks = real
        assert client.infer(linear_request())["actions"].shape == (2, 2)
    assert "could not be answered" in caplog.text


def test_actions_that_are_no_numbers_are_an_error():
    service = linear_service()
    service.policy.chunks = lambda asked: [np.full((2, 2), np.nan)]
    with (
        serving(service) as url,
        Client(url) as client,
        pytest.raises(PortError, match="no numbers"),
    ):
        client.infer(linear_request())
