"""The recorded states as the witness of what commands mean, whatever a file says of them.

Each command is executed in our physics for one control step, from the state that it was given in,
and must lead to the state that was recorded next. Robosuite's own recordings do so to 1 % of their
leads and better; another scale, frame, sign, order or rate, or a shift by one step, does not.
"""

from dataclasses import dataclass

import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.interop.robosuite_model import GripPath
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim.controllers import CONTROL_HZ, OSC_KP, gripper_command
from jaxcam.sim.engine import Engine
from jaxcam.sim.types import Command, Start

_SPEED = np.sqrt(OSC_KP) / CONTROL_HZ
_GAIN = 1 - (1 + _SPEED) * np.exp(-_SPEED)
"""What a critically damped arm at rest covers of its lead in one control step."""
LEADS = ((0.01, 0.1), (0.1, 1.0))
"""Least and largest lead (m, rad) of a target over the grip that errors are measured by. Below,
friction and contacts move the arm as much; beyond, its motors have no more to give."""
STRAY = 0.08
"""Error of the grip in a control step, as a share of what commands move it by, that is no doubt
yet. Recorded episodes of robosuite 1.4.1 and 1.5.2 have 0.0001 to 0.007; commands of 0.9 times
their size have 0.11, those of a frame that is turned by 10 degrees 0.08, a step too late 0.2."""
FINGERS_STRAY = 0.5
"""Likewise of the fingers' opening. Recorded episodes have 0.001 to 0.27 (their fingers are damped
otherwise in 1.4), commands a step too late 0.65, of 0 for open and 1 for closed 2.5."""
LEAST_OPENING = 1e-3
"""Change (m) of the fingers' opening that their errors are measured by where they move less."""
STILL = 1e-4
"""Change (rad) of the joints in a control step below which the arm stands still."""
OTHER_PACE = 1.2
"""How many times as fast as their speeds joints may move: twice at half the rate."""


@dataclass(frozen=True)
class Missed:
    """How far commands lead from where states go, as shares of what they move."""

    arm: float
    fingers: float


@dataclass(frozen=True)
class Witness:
    """The states of a demonstration, in our scene."""

    engine: Engine
    """Steps our scene, with the controller of poses."""
    qpos: np.ndarray
    """[T, nq]."""
    qvel: np.ndarray
    """[T, nv]."""
    path: GripPath
    """Of the grip, in each of them."""
    geom_size: np.ndarray
    """Sizes (m) of the task's varied geoms [v, 3]."""

    def check_pace(self) -> None:
        """Refuses states that are not a control step of ours apart.

        Raises:
            DatasetError: Joints move faster or slower from state to state than their speeds say.
        """
        moves = np.diff(self.qpos[:, self.engine.scene.arm], axis=0)
        speeds = self.qvel[:, self.engine.scene.arm]
        expected = (speeds[1:] + speeds[:-1]) / 2 / CONTROL_HZ
        if _size(moves) < STILL:
            return
        size = float((expected**2).sum())
        pace = float((moves * expected).sum()) / size if size else np.inf
        if not 1 / OTHER_PACE <= pace <= OTHER_PACE:
            raise DatasetError(
                f"its joints move {pace:.2g} times as far from state to state as their speeds say: "
                f"states are not 1/{CONTROL_HZ:g} s apart, or are out of order."
            )

    def missed(self, targets: np.ndarray, signs: np.ndarray) -> Missed:
        """Holds commands against the states.

        Args:
            targets: Absolute grip targets (m, rotation vector; the scene's world) of all states but
                the last [T - 1, 6].
            signs: Of the gripper's commands, positive closes [T - 1].
        """
        count = len(targets)
        closed = closedness(signs)
        repeated = (np.broadcast_to(x, (count, *x.shape)) for x in (self.geom_size, np.eye(2, 7)))
        before = self.engine.reset(Start(self.qpos[:-1], *repeated))._replace(
            qvel=self.qvel[:-1].copy(),
            closed=closed[:-1],
            rest=np.tile(self.qpos[0, self.engine.scene.arm], (count, 1)),
        )
        after = self.engine.step(before, Command(targets, signs))
        there, axes = self.path.position, self.path.rotation
        goals = matrix_from_rotvec(targets[:, 3:])
        leads = (targets[:, :3] - there[:-1], rotvec_from_matrix(goals @ axes[:-1].mT))
        errors = (
            there[1:] - after.grip_position, rotvec_from_matrix(axes[1:] @ after.grip_rotation.mT)
        )  # fmt: skip
        arm = 0.0
        for error, lead, least, most in zip(errors, leads, *LEADS, strict=True):
            lengths = np.minimum(np.linalg.norm(lead, axis=-1, keepdims=True), most)
            arm = max(arm, _size(error) / (_GAIN * max(_size(lengths), least)))
        opening, predicted = (
            abs(x[:, self.engine.scene.fingers]).sum(-1, keepdims=True)
            for x in (self.qpos, after.qpos)
        )
        moves = max(_size(np.diff(opening, axis=0)), LEAST_OPENING)
        return Missed(arm, _size(opening[1:] - predicted) / moves)


def closedness(signs: np.ndarray) -> np.ndarray:
    """How far the gripper's command has closed before each sign, and after the last [T + 1]."""
    closed = [0.0]
    for sign in signs:
        closed.append(float(gripper_command(np.array(closed[-1]), sign)))
    return np.array(closed)


def _size(vectors: np.ndarray) -> float:
    """Root of the mean square of vectors [T, n]."""
    return float(np.sqrt((vectors**2).sum(-1).mean()))
