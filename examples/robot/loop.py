"""A loop at 20 Hz for a robot of your own: `python examples/robot/loop.py ws://127.0.0.1:8000`.

It needs NumPy, msgpack and websockets, and of jaxcam `jaxcam.client` and `jaxcam.robot.ahead`. Put
your robot into `MyRobot`; as it stands, it is one that is always where it was sent. The address is
a policy server's, or the one that `python -m jaxcam.trial` prints: the loop then waits there for
the operator before each rollout.
"""

import argparse
import sys
import time

import numpy as np

from jaxcam.client import Client
from jaxcam.errors import PortError
from jaxcam.robot.ahead import Ahead, Pace

RATE = 20.0
"""Control steps a second; that of the demonstrations that the policy learned from."""
FASTEST = 0.02
"""Metres that a step may move the grip at most, whatever a policy says."""


class MyRobot:
    """What a robot has to do. Replace the bodies.

    Args:
        cameras: What the server calls the views that it wants.
        numbers: Numbers of the state.
    """

    def __init__(self, cameras: list[str], numbers: int) -> None:
        self._cameras, self._numbers = cameras, numbers
        self.position = np.zeros(3)
        self.steps = self.holds = 0

    def observe(self) -> dict[str, np.ndarray]:
        """The newest picture of each camera, and the state: take them at the same moment."""
        picture = np.zeros((84, 84, 3), np.uint8)
        observation = {f"observation.images.{name}": picture for name in self._cameras}
        return observation | {"observation.state": np.zeros(self._numbers, np.float32)}

    def act(self, action: np.ndarray) -> None:
        """Send a target and return; here a step of the grip, which is never longer than allowed."""
        step = action[:3]
        length = np.linalg.norm(step)
        self.position += step * min(1.0, FASTEST / max(length, 1e-9))
        self.steps += 1

    def hold(self) -> None:
        """Stay at the last target: a robot that wants a target in every step gets the last one."""
        self.holds += 1

    def stop(self) -> None:
        """Come to rest."""


def run(robot: MyRobot, policy: Client, seconds: float) -> str:
    """One rollout; what came of it, in numbers.

    Args:
        robot: The robot, at its start.
        policy: Connected.
        seconds: After which it is over.
    """
    metadata = policy.metadata
    policy.reset()
    ahead = Ahead(
        policy.infer,
        robot.observe,
        execute=metadata.get("execute"),
        space=metadata.get("action_space", ""),
        steps=metadata.get("observation_steps", 1),
        names=metadata.get("action_names", ()),
    )
    pace, until = Pace(RATE), time.monotonic() + seconds
    try:
        with ahead:
            while time.monotonic() < until:
                action = ahead.action()
                if action is None:
                    robot.hold()
                else:
                    robot.act(action)
                pace.wait()
    except PortError as error:  # the server is gone, or the operator has ended the rollout
        print(error)
    finally:
        robot.stop()  # also after Ctrl-C
    return f"{ahead.lateness}; {pace}."


def main() -> None:
    """Rollouts until Ctrl-C, or one."""
    parser = argparse.ArgumentParser()
    parser.add_argument("url")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a rollout")
    parser.add_argument("--again", action="store_true", help="rollout after rollout")
    asked = parser.parse_args()
    while True:
        try:
            # The patience is for the operator, who begins the rollout at another terminal.
            patience = 3600.0 if asked.again else 10.0
            with Client(asked.url, timeout=5.0, patience=patience) as policy:
                metadata = policy.metadata
                state = metadata.get("state_names") or [""] * 11
                robot = MyRobot(metadata.get("views") or ["front"], len(state))
                print(run(robot, policy, asked.seconds))
        except PortError as error:  # there is no server, or it is gone
            if not asked.again:
                sys.exit(str(error))
            print(error)
            time.sleep(1.0)
        if not asked.again:
            break


if __name__ == "__main__":
    main()
