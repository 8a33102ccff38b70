"""Runs as services, and the command from its start to Ctrl-C."""

import os
import signal
import socket
import threading
import time
from dataclasses import replace

import jax
import numpy as np
import pytest
from port_requests import camera, request
from running import exit_code
from served_runs import linear_request, linear_service, opened, serving, untrained_run

from jaxcam.client import Client
from jaxcam.config.serve import ServeConfig
from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError, ConfigError, PortError
from jaxcam.robot.asked import AskedPolicy
from jaxcam.robot.serving import address_of, key_of, listen
from jaxcam.runs.identity import resolve
from jaxcam.runs.interface import Interface, write_interface

CUPS = Interface(
    ("front", "side", "wrist"), ("x", "y", "z", "turn", "grip"), tuple("abcde"), 5.0, "Stack them."
)
ROOM = {"task": "recorded", "proprio": 5, "actions": 5, "conditioning": "none"}


class Cold(AskedPolicy):
    """A policy that is compiled for the first request only."""

    def warm(self, *, lens=False):
        pass


@pytest.fixture(scope="module")
def lift_run(tmp_path_factory):
    return untrained_run(tmp_path_factory.mktemp("runs") / "lift")


@pytest.fixture(scope="module")
def lift(lift_run):
    return opened(lift_run)


def test_a_run_of_a_task_is_served_as_its_policy_acts(lift):
    message = request(("view_0",), (16, 16), state=11)
    with serving(lift) as url, Client(url) as client:
        about, answer = client.metadata, client.infer(message)
    assert about["views"] == ["view_0"]
    assert (about["task"], about["action_space"], about["rate"]) == ("lift", "eef_abs", 20)
    assert (about["chunk"], about["execute"], about["image_size"]) == (6, 6, [16, 16])
    assert (about["needs_cameras"], about["cameras_given"]) == (True, False)
    assert about["weights_sha"] == lift.candidate.weights_sha
    assert about["prompt"] == "Lift the cube"
    obs = {
        "image": message["observation.images.view_0"][None, None],
        "K": message["camera.view_0.intrinsics"][None, None],
        "base_from_camera": message["camera.view_0.base_from_camera"][None, None],
        "proprio": message["observation.state"][None],
    }
    local = jax.jit(lift.candidate.policy.act)(lift.candidate.params, obs, jax.random.key(0))
    assert answer["actions"].tobytes() == np.asarray(local)[0].tobytes()


def test_a_run_of_a_recorded_dataset_has_the_datasets_names(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxcam.robot.serving.AskedPolicy", Cold)
    run = untrained_run(tmp_path / "cups", views=2, n=3, resolution="16x24", **ROOM)
    older = opened(run)
    assert older.metadata()["views"] == ["view_0", "view_1"]
    assert older.metadata()["rate"] is None
    assert older.metadata()["action_space"] == "native"
    known = replace(older, config=replace(older.config, action_is="eef_delta"))
    assert known.metadata()["action_space"] == "eef_delta"
    write_interface(run, CUPS)
    service = opened(run)
    about = service.metadata()
    assert (about["views"], about["views_at_once"]) == (["front", "side", "wrist"], 2)
    assert (about["action_names"], about["rate"]) == (list("abcde"), 5.0)
    assert not about["needs_cameras"]
    pictures = {
        f"observation/images/{view}": np.zeros((48, 64, 3), np.uint8) for view in ("side", "wrist")
    }
    session = service.session(0)
    assert session.ask({**pictures, "observation/state": np.zeros(5)}).obs["K"].shape == (2, 3, 3)
    with pytest.raises(PortError, match=r"did you mean 'observation\.images\.front"):
        session.ask({**pictures, "observation.images.font": 0})


def test_ensembling_gives_one_action_at_a_time(tmp_path):
    with pytest.raises(ConfigError, match="eef_delta, which say how far"):
        opened(untrained_run(tmp_path / "lift", action_space="eef_delta"), ensemble=0.01)
    config = resolve(TrainConfig(task="recorded", action_is="joint_abs"), accelerator=False)
    service = replace(linear_service(), config=config, ensemble=0.01)
    plain = service.session(0)
    assert (service.metadata()["chunk"], service.metadata()["execute"]) == (1, 1)
    with serving(service) as url, Client(url) as one, Client(url) as two:
        message = linear_request()
        first = one.infer(message)["actions"]
        second = one.infer(message)["actions"]
        assert first.shape == (1, 2)
        chunk = service.policy.chunks([plain.ask(message)])[0]
        np.testing.assert_array_equal(first[0], chunk[0])
        shares = np.exp([0, -0.01])
        np.testing.assert_allclose(
            second[0], np.average(chunk[[1, 0]], axis=0, weights=shares), rtol=1e-5, atol=1e-6
        )
        np.testing.assert_array_equal(two.infer(message)["actions"], first)
        one.reset()
        np.testing.assert_array_equal(one.infer(message)["actions"], first)


def test_runs_that_are_not_there(tmp_path, lift_run):
    with pytest.raises(ConfigError, match=r"There is no run .*none"):
        opened(tmp_path / "none")
    with pytest.raises(CheckpointError, match="No checkpoint in"):
        opened(tmp_path)
    with pytest.raises(CheckpointError, match=r"No checkpoint of step 5.*Known: 0"):
        opened(lift_run, step=5)


def test_keys(tmp_path):
    file = tmp_path / "key"
    file.write_text("sesame\nnot this\n")
    assert key_of(ServeConfig("run", key_file=str(file))) == "sesame"
    assert key_of(ServeConfig("run", key="sesame")) == "sesame"
    assert key_of(ServeConfig("run")) == ""
    for text, words in [("", "is empty"), ("two words", "one word"), ("schlüssel", "ASCII")]:
        file.write_text(text)
        with pytest.raises(ConfigError, match=words):
            key_of(ServeConfig("run", key_file=str(file)))
    with pytest.raises(ConfigError, match="cannot be read"):
        key_of(ServeConfig("run", key_file=str(tmp_path / "none")))


def test_addresses():
    with listen("localhost", 0, has_key=False) as one:
        port = one.getsockname()[1]
        assert address_of(one).endswith(f":{port}")
        with pytest.raises(ConfigError, match=f"Port {port} of .* is taken"):
            listen(one.getsockname()[0], port, has_key=False)
    for host in ("0.0.0.0", "::", ""):
        with pytest.raises(ConfigError, match="Give --key-file"):
            listen(host, 0, has_key=False)
    with listen("0.0.0.0", 0, has_key=True) as everywhere:
        assert everywhere.getsockname()[0] == "0.0.0.0"
    for host in ("256.0.0.1", "a..b", "a" * 70):
        with pytest.raises(ConfigError, match="no such address"):
            listen(host, 0, has_key=True)
    with pytest.raises(ConfigError, match=r"Cannot listen at 192.0.2.1"):
        listen("192.0.2.1", 0, has_key=True)


def test_the_command_serves_until_ctrl_c(tmp_path, lift_run, capfd, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    file = tmp_path / "cameras.json"
    K, pose = camera(16, 16)
    entry = f'{{"K": {K.tolist()}, "size": [16, 16], "base_from_camera": {pose.tolist()}}}'
    file.write_text(f'{{"format": 1, "views": {{"view_0": {entry}, "spare": {entry}}}}}')
    shapes, warmed, warm = [], [], AskedPolicy.warm

    def warms(policy, *, lens=False):
        warmed.append(lens)
        if not lens:  # it would only take its time here
            warm(policy)

    monkeypatch.setattr(AskedPolicy, "warm", warms)

    def ask():
        try:
            with Client(f"ws://127.0.0.1:{port}", patience=60) as client:
                message = request(("view_0",), (32, 32), state=11)
                bare = {k: v for k, v in message.items() if not k.startswith("camera.")}
                shapes.append(client.infer(bare)["actions"].shape)
            time.sleep(0.2)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    client = threading.Thread(target=ask)
    client.start()
    code = exit_code("serve", lift_run, "--port", port, "--cameras", file)
    client.join(10)
    assert (code, shapes, warmed) == (130, [(6, 7)], [False, True])
    shown = capfd.readouterr()
    lines = shown.out.splitlines()
    assert lines[0].endswith("cameras.json: spare not used: the policy's views are view_0.")
    assert lines[1] == f"Serving lift, step 0, on ws://127.0.0.1:{port}"
    assert ["came" in lines[2], "gone after 1 request" in lines[3]] == [True, True]
    assert shown.err.strip() == "Stopping the server."


@pytest.mark.parametrize(
    ("flags", "words"),
    [(["none"], "There is no run"), (["none", "--host", "0.0.0.0"], "--key-file")],
)
def test_what_cannot_be_served_is_told_without_a_traceback(flags, words, capfd):
    assert exit_code("serve", *flags, "--port", 0) == 2
    assert words in " ".join(capfd.readouterr().err.split())
