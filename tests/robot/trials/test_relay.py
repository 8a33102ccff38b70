"""Somebody's own loop, which asks at one address whoever's turn it is."""

import contextlib
import threading
import time

import numpy as np
import pytest
from policy_servers import answering, socket_server
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from jaxcam.client import Client
from jaxcam.errors import ConfigError, PortError
from jaxcam.robot.driver import Setup
from jaxcam.robot.trials.attempts import Attempt
from jaxcam.robot.trials.order import Condition, Rollout
from jaxcam.robot.trials.policies import Served
from jaxcam.robot.trials.relay import OVER, Relay
from jaxcam.robot.trials.sheet import PolicyEntry
from jaxcam.robot.trials.sights import PolicySight

METADATA = {"run": "act-early-0", "policy": "act", "views": ["v"], "execute": 3, "rate": 20.0}
SIGHT = PolicySight(("left", "right"), {"right": "v"})
PICTURES = {
    "observation/images/left": np.zeros((2, 2, 3), np.uint8),
    "observation/images/right": np.ones((2, 2, 3), np.uint8),
}


def total(observation):
    """A policy that answers with the sum of what it sees, and refuses what it is not to see."""
    if set(observation) != {"observation.images.v"}:
        raise ValueError(f"unknown entries: {sorted(observation)}")
    return np.array([[observation["observation.images.v"].sum()]])


@pytest.fixture
def relay():
    relay = Relay(0)
    yield relay
    relay.close()


@contextlib.contextmanager
def attempt(act=total, name="ACT with poses"):
    with socket_server(answering(METADATA, act)) as url:
        entry = PolicyEntry(name, url)
        rollout = Rollout(1, Condition(0, "1", ("right",), 0), 0, "B")
        yield Attempt(rollout, Served(entry, None, METADATA), SIGHT, Setup(0, "", "1", {}), 60.0)


class Operator:
    """Runs a rollout in a thread, and ends it when he is told to."""

    def __init__(self, relay, attempt):
        self._over, self.ran = threading.Event(), None
        self._thread = threading.Thread(target=self._run, args=(relay, attempt))
        self._thread.start()

    def _run(self, relay, attempt):
        self.ran = relay.run(attempt, self._over.is_set)

    def end(self):
        self._over.set()
        return self.ended()

    def ended(self):
        self._thread.join(10)
        return self.ran


def test_a_loop_waits_for_the_operator_and_is_told_when_it_is_over(relay):
    connected = []
    loop = threading.Thread(target=lambda: connected.append(Client(relay.url)))
    loop.start()
    time.sleep(0.1)
    assert connected == []  # nobody has begun
    with attempt() as one:
        operator = Operator(relay, one)
        loop.join(10)
        [client] = connected
        assert client.infer(PICTURES)["actions"] == 12  # one of two cameras, renamed
        client.reset()
        assert operator.end().fault == ""
        with pytest.raises(PortError, match=OVER):
            client.infer(PICTURES)
        client.close()


def test_the_loop_is_not_told_who_it_is(relay):
    with attempt() as one:
        operator = Operator(relay, one)
        with Client(relay.url) as client:
            shown = client.metadata
            assert shown["policy"] == "B"
            assert shown["views"] == ["left", "right"]
            assert shown["execute"] == 3
            assert "act" not in str(sorted(shown.items())).replace("action", "")
            with pytest.raises(PortError, match=r"policy B refused: unknown entries") as refused:
                client.infer(PICTURES | {"speed": 1})
            assert one.served.entry.url not in str(refused.value)
        assert "unknown entries" in operator.end().fault


def test_a_picture_that_is_missing_is_told_by_the_camera_s_name(relay):
    with attempt() as one:
        operator = Operator(relay, one)
        with Client(relay.url) as client:
            with pytest.raises(PortError, match="No picture of the camera 'right'"):
                client.infer({"observation.images.left": PICTURES["observation/images/left"]})
            client.infer(PICTURES)
        ran = operator.end()
    assert (ran.fault, ran.lateness) == ("", "1 answers")


def test_a_rollout_that_no_loop_asked_for(relay):
    with attempt() as one:
        assert Operator(relay, one).end().fault == "no loop asked for actions"


def test_a_policy_that_is_gone_is_told_without_its_name(relay, monkeypatch):
    monkeypatch.setattr("jaxcam.robot.trials.policies.PATIENCE", 0.0)
    with attempt() as one:
        pass
    operator = Operator(relay, one)
    with pytest.raises(PortError, match="but with 'No policy server answers at policy B"):
        Client(relay.url, patience=0.0)
    ran = operator.ended()  # there is nothing to wait for
    assert "No policy server answers at policy B" in ran.fault


def test_a_loop_that_waits_when_the_trial_ends_is_let_go():
    relay = Relay(0)
    with connect(relay.url) as loop:
        relay.close()
        with pytest.raises(ConnectionClosed):
            loop.recv(10)


def test_a_port_that_is_taken(relay):
    with pytest.raises(ConfigError, match="Set 'listen' in the sheet"):
        Relay(int(relay.url.rpartition(":")[2]))
