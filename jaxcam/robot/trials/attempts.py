"""A rollout that is about to be run, what came of it, and what runs it where we drive the robot."""

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, get_args
from urllib.parse import urlsplit

from jaxcam.client import Client
from jaxcam.errors import JaxcamError, PortError
from jaxcam.robot.ahead import Ahead, Pace
from jaxcam.robot.driver import Robot, Setup
from jaxcam.robot.trials.order import Rollout
from jaxcam.robot.trials.policies import Served
from jaxcam.robot.trials.rows import Outcome
from jaxcam.robot.trials.sights import PolicySight

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Attempt:
    """A rollout with all that it needs.

    Attributes:
        rollout: Of the order.
        served: The policy's server.
        sight: What the policy is sent.
        setup: How it begins.
        seconds: After which it is over.
    """

    rollout: Rollout
    served: Served
    sight: PolicySight
    setup: Setup
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
        names = [entry.url, urlsplit(entry.url).netloc, entry.name]
        hidden = "|".join(map(re.escape, names))  # as words: a name may be "a"
        return re.sub(rf"(?<!\w)(?:{hidden})(?!\w)", letter, str(error))


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

    def run(self, attempt: Attempt, is_over: Callable[[], bool]) -> Ran:
        """Run one.

        Args:
            attempt: The rollout.
            is_over: Whether the operator wants it to end; raises `Stopped` at Ctrl-C.
        """
        ...


@dataclass
class _Played:
    """How far a rollout came, also where it was broken off."""

    steps: int = 0
    lateness: str = ""


class Driven:
    """Runs rollouts on a robot that we drive.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def run(self, attempt: Attempt, is_over: Callable[[], bool]) -> Ran:
        """Run one, see `Runner`. The robot is stopped after it, whatever happens."""
        robot, fault, played = self._robot, "", _Played()
        try:
            robot.stop()
            robot.prepare(attempt.setup)
            with attempt.served.connect() as client:
                client.reset()
                self._play(attempt, self._ahead(attempt, client), is_over, played)
        except JaxcamError as error:
            fault = attempt.blinded(error)
        except Exception as error:  # the robot's own code: it may raise anything
            _log.warning("The robot failed.", exc_info=True)
            fault = f"the robot: {type(error).__name__}: {error}"
        finally:
            fault = self._stop() or fault
        return Ran(played.steps / robot.rate, fault, played.lateness, self._outcome())

    def _play(
        self, attempt: Attempt, ahead: Ahead, is_over: Callable[[], bool], played: "_Played"
    ) -> None:
        """Control step after control step."""
        robot, speed = self._robot, self._speed
        pace = Pace(robot.rate * speed) if speed else None
        with ahead:  # which waits a moment for an answer: the robot is stopped before
            try:
                while played.steps < attempt.seconds * robot.rate and not is_over():
                    action = ahead.action()
                    if action is None:
                        robot.hold()
                    else:
                        robot.act(action)
                    played.steps += 1
                    if self._outcome() == "success":
                        break
                    if pace:
                        pace.wait()
            finally:
                robot.stop()
                played.lateness = f"{ahead.lateness}; {pace}" if pace else str(ahead.lateness)

    def _stop(self) -> str:
        """Stop the robot; what went wrong, if it does not."""
        try:
            self._robot.stop()
        except Exception as error:  # the robot's own code
            _log.warning("The robot did not stop.", exc_info=True)
            return f"the robot did not stop: {type(error).__name__}: {error}"
        return ""

    def _ahead(self, attempt: Attempt, client: Client) -> Ahead:
        told_by_server = attempt.served.metadata
        steps, wait = told_by_server.get("observation_steps"), 0.1
        names = told_by_server.get("action_names")
        if told_by_server.get("chunk") == 1:
            wait = 0.8
        return Ahead(
            lambda observation: attempt.answer(client, observation),
            self._robot.observe,
            execute=attempt.served.execute,
            space=str(told_by_server.get("action_space") or ""),
            steps=steps if isinstance(steps, int) and steps > 1 else 1,
            # One action alone, as of a server that averages, cannot be asked for ahead.
            wait=wait / (self._robot.rate * self._speed) if self._speed else None,
            names=[str(name) for name in names] if isinstance(names, list) else (),
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
