"""Chunks executed while the next is asked for."""

import itertools
import threading
import time

import numpy as np
import pytest
from served_runs import linear_request, linear_service, serving
from test_import_hygiene import loaded

from jaxcam.client import Client
from jaxcam.errors import PortError
from jaxcam.rays.rotations import matrix_from_rotvec
from jaxcam.robot.ahead import Ahead, Pace
from jaxcam.sim.actions import decode


class Slow:
    """A policy that answers when it is let; chunk n is what `chunks` has."""

    def __init__(self, chunks):
        self._chunks, self._gate = iter(chunks), threading.Semaphore(0)
        self.requests, self._thread = [], None

    def __call__(self, observation):
        self.requests.append(observation)
        self._thread = threading.current_thread()
        self._gate.acquire()
        return {"actions": next(self._chunks)}

    def answer(self):
        """Answer what was asked, and return when that is done."""
        while self._thread is None:
            time.sleep(0.001)
        thread, self._thread = self._thread, None
        self._gate.release()
        thread.join()


def chunk(number, length=6, size=2):
    """Actions that tell their chunk and their place in it."""
    return np.tile(100.0 * number + np.arange(length)[:, None], (1, size))


def first(actions):
    return [None if a is None else float(a[0]) for a in actions]


def counting():
    steps = itertools.count()
    return lambda: {"observation.state": np.float32([next(steps)])}


def test_where_steps_may_wait_it_is_chunk_after_chunk():
    asked = []

    def ask(observation):
        asked.append(observation)
        return {"actions": chunk(len(asked))}

    with Ahead(ask, counting(), execute=4, wait=None) as ahead:
        done = first(ahead.action() for _ in range(10))
    assert done == [100, 101, 102, 103, 200, 201, 202, 203, 300, 301]
    assert len(asked) == 3
    assert (ahead.lateness.held, ahead.lateness.late) == (0, 0)


def test_late_actions_are_dropped_and_the_next_chunk_is_asked_for_earlier():
    policy = Slow(map(chunk, itertools.count(1)))
    ahead = Ahead(policy, counting(), execute=4, wait=0.0)
    assert ahead.action() is None  # nothing to execute yet
    policy.answer()
    done = [ahead.action() for _ in range(6)]  # the second chunk is asked for before the fifth
    policy.answer()
    done += [ahead.action() for _ in range(2)]
    assert first(done) == [100, 101, 102, 103, 104, 105, 202, 203]
    # It took two steps, so the third is asked for two steps before it is wanted.
    assert len(policy.requests) == 3
    assert ahead.lateness.late == 2
    policy.answer()
    assert first([ahead.action()]) == [302]


def test_a_robot_that_waited_goes_on_where_it_stopped():
    policy = Slow(map(chunk, itertools.count(1)))
    with Ahead(policy, counting(), wait=0.0) as ahead:
        ahead.action()
        policy.answer()
        for _ in range(6):
            ahead.action()
        assert first(ahead.action() for _ in range(3)) == [None] * 3
        policy.answer()
        assert first(ahead.action() for _ in range(2)) == [200, 201]
        assert (ahead.lateness.held, ahead.lateness.late) == (3, 0)
        assert "3 steps held" in str(ahead.lateness)


@pytest.mark.parametrize(
    ("space", "size"),
    [("eef_delta", 7), ("eef_delta_componentwise", 7), ("joint_delta", 8), ("eef_abs", 7)],
)
def test_the_robot_ends_on_the_path_that_the_policy_meant(space, size):
    """Whatever was executed while the second chunk was late, from its first action on."""
    rng = np.random.default_rng(1)
    chunks = rng.uniform(-0.5, 0.5, (2, 6, size))
    policy = Slow(iter(chunks))
    ahead = Ahead(policy, counting(), execute=2, space=space, wait=0.0)
    ahead.action()
    policy.answer()
    before = [ahead.action() for _ in range(5)]  # asked for before the third: three are late
    policy.answer()
    after = [ahead.action() for _ in range(3)]
    anchor = rng.uniform(-1, 1, (1, size - 1))
    nominal = np.eye(3)

    def targets(actions, start):
        return decode(space, np.stack(actions)[None].astype(float), start, nominal)

    at_asking = targets(before[:2], anchor)[0][:, -1]
    meant, gripper = targets(chunks[1], at_asking)
    sent, closed = targets([*before, *after], anchor)
    if space.startswith("eef"):
        assert_same_pose(sent[0, 5:], meant[0, 3:])
    else:
        np.testing.assert_allclose(sent[0, 5:], meant[0, 3:], atol=1e-5)
    np.testing.assert_allclose(closed[0, 5:], gripper[0, 3:], atol=1e-6)


@pytest.mark.parametrize(
    ("space", "names", "kept"),
    [
        ("eef_delta", tuple("abcdefghi"), [6, 7, 8]),
        ("joint_delta", ("left_a", "left_gripper", "right_a", "right_gripper"), [1, 3]),
    ],
)
def test_numbers_that_are_no_differences_do_not_add_up(space, names, kept):
    chunks = np.random.default_rng(1).uniform(0.1, 0.2, (2, 6, len(names)))
    policy = Slow(iter(chunks))
    ahead = Ahead(policy, counting(), execute=2, space=space, wait=0.0, names=names)
    ahead.action()
    policy.answer()
    for _ in range(5):
        ahead.action()
    policy.answer()
    action = ahead.action()
    same = np.isclose(action, chunks[1, 3], atol=1e-6)
    assert np.flatnonzero(same).tolist() == kept


def assert_same_pose(a, b):
    np.testing.assert_allclose(a[:, :3], b[:, :3], atol=1e-5)
    turned = matrix_from_rotvec(a[:, 3:]), matrix_from_rotvec(b[:, 3:])
    np.testing.assert_allclose(*turned, atol=1e-5)


def test_several_observations_are_of_consecutive_steps():
    asked = []

    def ask(observation):
        asked.append(observation["observation.state"][:, 0].tolist())
        return {"actions": chunk(0)}

    with Ahead(ask, counting(), execute=3, steps=3, wait=None) as ahead:
        for _ in range(7):
            ahead.action()
    assert asked == [[0, 0, 0], [1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ([np.full((2, 2), np.nan)], "not finite"),
        ([np.zeros(3)], r"float64 \[3\]"),
        ([np.array([["a"]])], r"expected numbers \[T, A\]"),
        ([chunk(1, 1), chunk(2, 1, size=3)], "3 numbers, and 2 before"),
    ],
)
def test_what_are_no_actions_is_refused(answers, words):
    policy = iter(answers)
    ahead = Ahead(lambda _: {"actions": next(policy)}, counting(), wait=None)
    for _ in answers[1:]:
        ahead.action()
    with pytest.raises(PortError, match=words):
        ahead.action()


def test_a_policy_that_is_gone_ends_the_rollout():
    def gone(observation):
        raise PortError("gone")

    with pytest.raises(PortError, match="gone"):
        Ahead(gone, counting(), wait=None).action()


def test_a_robot_is_not_without_actions_for_ever():
    policy = Slow([chunk(1, 1)])
    ahead = Ahead(policy, counting(), wait=0.0, patience=0.02)
    ahead.action()
    policy.answer()
    assert first([ahead.action(), ahead.action()]) == [100, None]
    time.sleep(0.03)
    with pytest.raises(PortError, match=r"without actions for 0\.02 s"):
        ahead.action()


def test_steps_come_at_the_rate_and_missed_ones_are_not_made_up_for():
    pace, began = Pace(100), time.monotonic()
    for _ in range(3):
        pace.wait()
    assert time.monotonic() - began >= 0.029
    time.sleep(0.05)
    before, began = pace.late, time.monotonic()
    pace.wait()
    assert pace.late == before + 1
    assert pace.worst > 0.03
    pace.wait()
    pace.wait()
    assert time.monotonic() - began >= 0.01  # not all at once
    assert "began late" in str(pace)


def test_a_robot_needs_what_the_client_needs():
    modules, _ = loaded("import jaxcam.robot.ahead")
    assert not modules & {"jax", "scipy", "rich", "tyro", "mujoco"}


def test_our_server_takes_several_observations_as_they_are_sent():
    numbers = itertools.count()
    with serving(linear_service(obs_steps=2)) as url, Client(url) as client:
        with Ahead(
            client.infer,
            lambda: linear_request(next(numbers)),
            steps=client.metadata["observation_steps"],
            wait=None,
        ) as ahead:
            done = [ahead.action() for _ in range(4)]  # two chunks of two
        client.reset()
        for i in (0, 2):  # the policy looks at the newest only
            np.testing.assert_array_equal(
                done[i : i + 2], client.infer(linear_request(i))["actions"]
            )
