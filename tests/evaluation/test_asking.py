"""A batch of episodes asks a foreign policy; what goes wrong is one episode's, and is told."""

import re
import sys
import time

import numpy as np
import pytest
from policy_servers import HANG_UP, policy_server

from jaxcam.errors import NoServerError, PortError
from jaxcam.evaluation.asking import Asking
from jaxcam.evaluation.mapping import renamed
from jaxcam.evaluation.sources import PolicyFunction, PolicyServer

BATCH, SIDE, CHUNK = 3, 16, 4
OBS = {
    "image": np.full((BATCH, 1, SIDE, SIDE, 3), 7, np.uint8),
    "K": np.broadcast_to(np.eye(3, dtype=np.float32), (BATCH, 1, 3, 3)),
    "base_from_camera": np.broadcast_to(np.eye(4, dtype=np.float32), (BATCH, 1, 4, 4)),
    "proprio": np.arange(BATCH * 11, dtype=np.float32).reshape(BATCH, 11),
}
"""Episode i has 11 i as the first number of its state."""
ALL = np.ones(BATCH, bool)


def episode(observation):
    return int(observation["observation.state"][0]) // 11


def good(observation):
    return np.full((CHUNK, 7), episode(observation), np.float32)


def but(number, otherwise):
    """A policy that is good but for one episode."""

    def infer(observation):
        return otherwise(observation) if episode(observation) == number else good(observation)

    return infer


def asking(source, **changes):
    settings = {"prompt": "Lift", "answer": "actions", "size": 7, "execute": None, **changes}
    return Asking(source, renamed(["view_0"]), **settings)


def server(address, **settings):
    return PolicyServer(address, **{"timeout": 5.0, "patience": 0.3, **settings})


def function(monkeypatch, value):
    """A policy in Python, as `module:function` names it."""
    module = type(sys)("their_policy")
    module.policy = value
    monkeypatch.setitem(sys.modules, "their_policy", module)
    return PolicyFunction("their_policy:policy")


@pytest.mark.parametrize("at_once", [1, 8])
def test_each_episode_gets_its_own_answer_and_only_those_that_go_on_are_asked(at_once):
    asked = []

    def infer(observation):
        asked.append(episode(observation))
        return good(observation)

    with policy_server(infer) as address:
        act = asking(server(address, at_once=at_once))
        with act.at_work():
            whole = act(OBS, 0, ALL)
            part = act(OBS, 1, np.array([True, False, True]))
    assert sorted(asked) == [0, 0, 1, 2, 2]
    assert whole.shape == (BATCH, CHUNK, 7)
    np.testing.assert_array_equal(whole[:, 0, 0], range(BATCH))
    np.testing.assert_array_equal(part[[0, 2]], whole[[0, 2]])
    assert act.causes == {}


WRONG = {
    "nan": (lambda o: np.where(np.arange(28).reshape(4, 7) == 9, np.nan, 0), "nan at step 1, num"),
    "large": (lambda o: np.full((4, 7), 1e9), "1000000000.0 at step 0"),
    "width": (lambda o: np.zeros((4, 6)), r"shape \[4, 6\], expected \[T, 7\]"),
    "axes": (lambda o: np.zeros((1, 4, 7)), r"shape \[1, 4, 7\]"),
    "none": (lambda o: np.zeros((0, 7)), r"shape \[0, 7\]"),
    "short": (lambda o: np.zeros((2, 7)), "2 steps, and 4 are to be executed"),
    "text": (lambda o: np.array(["a"]), "expected numbers"),
    "hang up": (lambda o: HANG_UP, "ended the connection"),
    "error": (lambda o: o["wrist"], "KeyError: 'wrist'"),
}


@pytest.mark.parametrize(("answer", "cause"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_with_an_answer_is_that_episodes_failure(answer, cause):
    with policy_server(but(1, answer)) as address:
        act = asking(server(address))
        with act.at_work():
            chunk = act(OBS, 0, ALL)
    assert np.isnan(chunk[1]).all()
    np.testing.assert_array_equal(chunk[2], np.full((CHUNK, 7), 2))
    assert list(act.causes) == [1]
    assert re.search(cause, act.causes[1])


def test_a_slow_answer_is_that_episodes_failure():
    def slow(observation):
        time.sleep(0.5)
        return good(observation)

    with policy_server(but(1, slow)) as address:
        act = asking(server(address, timeout=0.2))
        with act.at_work():
            chunk = act(OBS, 0, ALL)
    assert "did not answer within 0.2 s" in act.causes[1]
    np.testing.assert_array_equal(chunk[2], np.full((CHUNK, 7), 2))


def test_a_connection_that_was_lost_between_questions_is_that_episodes_failure():
    """Made again, the server may have forgotten the episode."""
    lost = []

    def infer(observation):
        if episode(observation) == 2 and len(lost) == 1:
            lost.append(2)
            return HANG_UP
        lost.extend([1] * (episode(observation) == 2))
        return good(observation)

    with policy_server(infer) as address:
        act = asking(server(address))
        with act.at_work():
            act(OBS, 0, ALL)
            chunk = act(OBS, 1, ALL)
    assert np.isnan(chunk[2]).all()
    assert "was lost, and made again" in act.causes[2]


@pytest.mark.parametrize("at_once", [1, 8])
def test_a_server_that_is_gone_is_nobodys_failure(at_once):
    with policy_server(good) as address:
        act = asking(server(address, at_once=at_once))
    with act.at_work(), pytest.raises(NoServerError, match="No policy server answers"):
        act(OBS, 0, ALL)
    assert act.causes == {}


def test_another_policy_at_the_same_address_is_refused():
    said = {"checkpoint": 1}
    with policy_server(good, said) as address:
        act = asking(server(address))
        said["checkpoint"] = 2
        with act.at_work(), pytest.raises(NoServerError, match="another policy is served"):
            act(OBS, 0, ALL)


def test_a_policy_that_refuses_all_first_observations_was_set_up_wrongly():
    with policy_server(lambda observation: observation["wrist"]) as address:
        act = asking(server(address))
        with act.at_work(), pytest.raises(PortError, match=r"KeyError: 'wrist'") as refused:
            act(OBS, 0, ALL)
    assert "sent observation.images.view_0" in str(refused.value)


def test_the_answer_has_the_name_that_the_map_gives():
    with policy_server(good, answer="chunk") as address:
        act = asking(server(address), answer="chunk", execute=2)
        with act.at_work():
            assert act(OBS, 0, ALL).shape == (BATCH, 2, 7)
        act = asking(server(address))
        with act.at_work():
            act(OBS, 0, ALL)
    assert "answered without actions: ['chunk', 'server_timing']" in act.causes[0]


def test_a_function_is_asked_with_arrays_of_its_own(monkeypatch):
    def infer(observation):
        for value in observation.values():
            if isinstance(value, np.ndarray):
                value[...] = 0
        return {"actions": [[1.0] * 7] * 2}

    before = {name: value.copy() for name, value in OBS.items()}
    act = asking(function(monkeypatch, infer))
    with act.at_work():
        np.testing.assert_array_equal(act(OBS, 0, ALL), np.ones((BATCH, 2, 7)))
    for name, value in before.items():
        np.testing.assert_array_equal(OBS[name], value)


class Counting:
    """Remembers how often it was asked in an episode."""

    def reset(self):
        self.asked = 0

    def infer(self, observation):
        self.asked += 1
        return np.full((1, 7), self.asked)


def test_each_episode_has_an_object_of_its_own(monkeypatch):
    source = function(monkeypatch, Counting)
    for _ in range(2):  # batches
        act = asking(source)
        with act.at_work():
            act(OBS, 0, ALL)
            chunk = act(OBS, 1, np.array([True, False, True]))
        np.testing.assert_array_equal(chunk[[0, 2], 0, 0], 2)
    assert not source.remembers
    assert function(monkeypatch, Counting()).remembers


class Batched:
    """Answers all that is asked at once."""

    answers = None

    def infer_batch(self, observations):
        return [good(o) for o in observations][: self.answers]


def test_a_batch_is_answered_at_once(monkeypatch):
    act = asking(function(monkeypatch, Batched()))
    with act.at_work():
        chunk = act(OBS, 0, np.array([False, True, True]))
    np.testing.assert_array_equal(chunk[1:, 0, 0], [1, 2])
    short = Batched()
    short.answers = 1
    act = asking(function(monkeypatch, short))
    with act.at_work():
        act(OBS, 0, ALL)
    assert act.causes[0] == "1 answers to 3 observations"


class _Refuses:
    def reset(self):
        if _Refuses.ill:
            raise RuntimeError("cannot begin")

    def infer(self, observation):
        return good(observation)

    def infer_batch(self, observations):
        raise AssertionError("a class has no object of all episodes")


@pytest.mark.parametrize("wrong", [lambda _: None, lambda _: iter([1 / 0]), lambda _: sys.exit(3)])
def test_an_object_of_all_episodes_that_fails_has_failed_all(monkeypatch, wrong):
    broken = type("Policy", (), {"infer_batch": lambda self, some: wrong(some)})()
    act = asking(function(monkeypatch, broken))
    assert np.isnan(act(OBS, 1, ALL)).all()
    assert len(act.causes) == BATCH


def test_an_episode_that_cannot_begin_has_failed(monkeypatch):
    _Refuses.ill = True
    act = asking(function(monkeypatch, _Refuses))
    act(OBS, 1, np.array([True, False, False]))
    assert act.causes == {0: "RuntimeError: cannot begin"}
    _Refuses.ill = False
    assert np.isfinite(act(OBS, 1, np.array([False, True, True]))[1:]).all()


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ([["0"] * 7] * 3, "actions are list, expected numbers [T, 7]"),
        (np.full((3, 7), 1j), "actions are complex128, expected numbers [T, 7]"),
        (None, "actions are NoneType, expected numbers [T, 7]"),
    ],
)
def test_what_would_have_to_be_converted_is_no_action(monkeypatch, answer, words):
    act = asking(function(monkeypatch, but(1, lambda _: answer)))
    act(OBS, 1, ALL)
    assert act.causes == {1: words}


def test_of_an_endless_chunk_no_more_is_executed_than_an_episode_can_have(monkeypatch):
    act = asking(function(monkeypatch, lambda _: np.zeros((5000, 7))))
    assert act(OBS, 0, ALL).shape == (BATCH, 1000, 7)
