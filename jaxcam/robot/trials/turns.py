"""A rollout that is about to be run, what came of it, and what runs it where we drive the robot."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, get_args

from jaxcam.client import Client
from jaxcam.errors import PortError
from jaxcam.robot.ahead import Ahead, Pace
from jaxcam.robot.driver import Robot, Scene
from jaxcam.robot.trials.order import Rollout
from jaxcam.robot.trials.policies import Served
from jaxcam.robot.trials.rows import Outcome
from jaxcam.robot.trials.sights import Sight

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Turn:
    """A rollout with all that it needs.

    Attributes:
        rollout: Of the order.
        served: The policy's server.
        sight: What the policy is sent.
        scene: How it begins.
        seconds: After which it is over.
    """

    rollout: Rollout
    served: Served
    sight: Sight
    scene: Scene
    seconds: float

    def answer(self, client: Client, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The policy's answer to what the robot sees.

        Args:
            client: Connected to its server.
            observation: With the names of the robot's cameras.

        Raises:
            PortError: It has none; the message does not say who the policy is.
        """
        request = self.sight.request(observation)
        try:
            return client.infer(request)
        except PortError as error:
            raise PortError(self.blinded(error)) from error

    def blinded(self, error: Exception) -> str:
        """An error's words without what says who the policy is."""
        letter, entry = f"policy {self.rollout.letter}", self.served.entry
        return str(error).replace(entry.url, letter).replace(entry.name, letter)


@dataclass(frozen=True)
class Ran:
    """What came of a rollout before anybody rated it.

    Attributes:
        seconds: It took.
        fault: What ended it, if it was neither the operator nor the time; empty if nothing.
        lateness: How well actions were there when they were needed.
        outcome: What the robot says of how it ended, if it can.
    """

    seconds: float
    fault: str = ""
    lateness: str = ""
    outcome: Outcome | None = None


class Runner(Protocol):
    """Runs rollouts."""

    def run(self, turn: Turn, is_over: Callable[[], bool]) -> Ran:
        """Run one.

        Args:
            turn: The rollout.
            is_over: Whether the operator wants it to end; raises `Stopped` at Ctrl-C.
        """
        ...


class Driven:
    """Runs rollouts on a robot that we drive.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def run(self, turn: Turn, is_over: Callable[[], bool]) -> Ran:
        """Run one, see `Runner`. The robot is stopped after it, whatever happens."""
        robot, fault, lateness, steps = self._robot, "", "", 0
        try:
            robot.stop()
            robot.prepare(turn.scene)
            with turn.served.connect() as client:
                client.reset()
                ahead, speed = self._ahead(turn, client), self._speed
                pace = Pace(robot.rate * speed) if speed else None
                try:
                    with ahead:
                        while steps < turn.seconds * robot.rate and not is_over():
                            action = ahead.action()
                            _ = robot.hold() if action is None else robot.act(action)
                            steps += 1
                            if self._outcome() == "success":
                                break
                            _ = pace and pace.wait()
                finally:
                    robot.stop()
                    lateness = f"{ahead.lateness}; {pace}" if pace else str(ahead.lateness)
        except PortError as error:
            fault = turn.blinded(error)
        except Exception as error:  # the robot's own code: it may raise anything
            _log.warning("The robot failed.", exc_info=True)
            fault = f"the robot: {type(error).__name__}: {error}"
        finally:
            robot.stop()
        return Ran(steps / robot.rate, fault, lateness, self._outcome())

    def _ahead(self, turn: Turn, client: Client) -> Ahead:
        told_by_server = turn.served.metadata
        steps = told_by_server.get("observation_steps")
        return Ahead(
            lambda observation: turn.answer(client, observation),
            self._robot.observe,
            execute=turn.served.execute,
            space=str(told_by_server.get("action_space") or ""),
            steps=steps if isinstance(steps, int) and steps > 1 else 1,
            wait=0.1 / (self._robot.rate * self._speed) if self._speed else None,
        )

    @property
    def _speed(self) -> float:
        """How much faster than real time the robot is; 0 where time is only simulated."""
        return float(getattr(self._robot, "speed", 1.0))

    def _outcome(self) -> Outcome | None:
        """What the robot says of how it went, if it can."""
        judge = getattr(self._robot, "outcome", None)
        judged = judge() if callable(judge) else None
        return next((known for known in get_args(Outcome) if known == judged), None)
