"""Rollouts on a robot that we drive: it is stopped, whatever happens."""

import numpy as np
import pytest
from policy_servers import answering, socket_server

from jaxcam.interrupts import Stopped
from jaxcam.robot.driver import Setup
from jaxcam.robot.trials.attempts import Attempt, Driven
from jaxcam.robot.trials.order import Condition, Rollout
from jaxcam.robot.trials.policies import Served
from jaxcam.robot.trials.sheet import PolicyEntry
from jaxcam.robot.trials.sights import PolicySight


class Arm:
    """Writes down what it is asked to do."""

    rate, speed = 20.0, 0.0

    def __init__(self, fails="", outcomes=()):
        self.done, self._fails, self._outcomes = [], fails, list(outcomes)

    def _do(self, word):
        self.done.append(word)
        if word == self._fails:
            raise RuntimeError("the belt slipped")

    def prepare(self, setup):
        self._do(f"prepare {setup.start}")

    def observe(self):
        self._do("observe")
        return {"observation.state": np.zeros(2, np.float32)}

    def act(self, action):
        self._do("act")

    def hold(self):
        self._do("hold")

    def stop(self):
        self._do("stop")

    def outcome(self):
        return self._outcomes.pop(0) if self._outcomes else None


def never():
    return False


def run(robot, act=lambda _: np.zeros((4, 2)), is_over=never, seconds=0.3, name="ACT"):
    with socket_server(answering({"weights_sha": "abc"}, act)) as url:
        served = Served(PolicyEntry(name, url), None, {"weights_sha": "abc"})
        rollout = Rollout(1, Condition(0, "", (), 3), 0, "B")
        attempt = Attempt(rollout, served, PolicySight(), Setup(3, "", "", {}), seconds)
        return Driven(robot).run(attempt, is_over)


def test_a_rollout_takes_its_time_and_the_robot_is_stopped():
    robot = Arm()
    ran = run(robot)
    assert robot.done[:3] == ["stop", "prepare 3", "observe"]
    assert robot.done.count("act") == 6  # 0.3 s at 20 Hz
    assert robot.done[-1] == "stop"
    assert (ran.seconds, ran.fault) == (0.3, "")
    assert ran.lateness.startswith("6 actions, 0 steps held")


def test_a_success_that_the_robot_sees_ends_it():
    ran = run(Arm(outcomes=[None, "success", "success"]))
    assert (ran.seconds, ran.outcome) == (0.1, "success")


@pytest.mark.parametrize(("fails", "acts"), [("act", 1), ("observe", 0), ("prepare 3", 0)])
def test_a_robot_that_fails_is_stopped(fails, acts, caplog):
    robot = Arm(fails)
    assert run(robot).fault == "the robot: RuntimeError: the belt slipped"
    assert robot.done.count("act") == acts
    assert robot.done[-1] == "stop"
    assert "The robot failed" in caplog.text


def test_a_robot_that_does_not_stop_is_told(caplog):
    assert "the robot did not stop: RuntimeError" in run(Arm("stop")).fault
    assert "did not stop" in caplog.text


def test_a_policy_that_fails_ends_it_without_its_name():
    def refuse(observation):
        raise ValueError("no picture")

    robot = Arm()
    assert run(robot, refuse).fault == "policy B refused: no picture"
    assert run(Arm(), refuse, name="i").fault == "policy B refused: no picture"
    assert run(Arm(), refuse, name="picture").fault == "policy B refused: no policy B"
    assert robot.done[-1] == "stop"
    assert "not finite" in run(Arm(), lambda _: np.full((1, 2), np.nan)).fault


def test_the_operator_ends_it_and_ctrl_c_does():
    robot = Arm()
    turns = iter([False, False, True])
    assert run(robot, is_over=lambda: next(turns)).seconds == 0.1

    def interrupted():
        raise Stopped(130)

    robot = Arm()
    with pytest.raises(Stopped):
        run(robot, is_over=interrupted)
    assert robot.done[-1] == "stop"
