"""Pictures of a tag or a board, with the moment of each in its episode."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from jaxcam.config.calibrate import HandEyeConfig, TagFamily
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.grips import GripNumbers, poses_between, poses_of_grip
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interrupts import check_stop
from jaxcam.robot.calibration.boards import Board, why_not
from jaxcam.robot.calibration.hand_eye.fit import (
    ENOUGH,
    Seen,
    most_different_poses,
    slow_steps,
)
from jaxcam.robot.calibration.page import spread_out
from jaxcam.robot.calibration.pictures import NamedPicture
from jaxcam.robot.calibration.tags.pictures import NEEDS, find_tags, why_no_tag
from jaxcam.robot.calibration.tags.places import square

MORE = 3
"""Pictures that are looked at for each that is wanted: the target is not in all."""
MOVING = 30
"""Pictures of a hand in motion that are wanted: they tell whether states are of other moments."""


@dataclass(frozen=True)
class Shots:
    """Pictures of the target."""

    episodes: np.ndarray
    """Number of each picture's episode, [n]."""
    steps: np.ndarray
    """Its step there, [n]."""
    moving: np.ndarray
    """Whether the hand was in motion, bool [n]."""
    sights: tuple[Seen, ...] = field(repr=False)
    pictures: tuple[NamedPicture, ...] = field(repr=False)
    states: Mapping[int, np.ndarray] = field(repr=False)
    """All states of each episode, [T, P]."""
    on_hand: bool = False
    """Whether the hand carries the camera, and not the target."""

    def some(self, which: np.ndarray) -> "Shots":
        """Those of the pictures."""
        chosen = np.flatnonzero(which) if which.dtype == bool else which
        return replace(
            self,
            episodes=self.episodes[chosen], steps=self.steps[chosen], moving=self.moving[chosen],
            sights=tuple(self.sights[i] for i in chosen),
            pictures=tuple(self.pictures[i] for i in chosen),
        )  # fmt: skip

    def grips(self, columns: GripNumbers) -> Callable[[float], np.ndarray]:
        """Base from grip in each picture, [n, 4, 4], by the steps by which states are late.

        Args:
            columns: Which numbers of the state are it.
        """
        numbers = [int(number) for number in np.unique(self.episodes)]
        poses = {i: poses_of_grip(self.states[i], columns, f"episode {i}") for i in numbers}

        @lru_cache(maxsize=4)  # a fit asks for the same delay again and again
        def late(delay: float) -> np.ndarray:
            result = np.zeros((len(self.steps), 4, 4))
            for i in numbers:
                own = self.episodes == i
                result[own] = poses_between(poses[i], self.steps[own] + delay)
            return result

        return late

    def carried(self, columns: GripNumbers) -> Callable[[float], np.ndarray]:
        """The target's holder in the frame of the camera's mount, as `fit_hand_eye` takes it."""
        grips = self.grips(columns)
        return (lambda delay: np.linalg.inv(grips(delay))) if self.on_hand else grips


def board_of(config: HandEyeConfig) -> Board | None:
    """The board that is looked for; None if it is a tag."""
    if config.target == "tag":
        return None
    marker = 0.7 * config.square_mm if config.marker_mm is None else config.marker_mm
    family = config.family or "4x4_50"
    return Board(config.target, config.columns, config.rows, config.square_mm / 1000,
                 marker / 1000, family)  # fmt: skip


def take_shots(
    recording: Recording, config: HandEyeConfig, columns: GripNumbers, optics: Optics
) -> Shots:
    """Pictures with the target, of poses that differ: slow ones, then some of a hand in motion.

    Args:
        recording: The dataset.
        config: Settings.
        columns: Which numbers of the state are the grip's pose.
        optics: How the camera sees.

    Raises:
        DatasetError: The target is in too few.
    """
    seen_by = [i for i, e in enumerate(recording.episodes) if config.view in e.sights]
    poses = [poses_of_grip(recording.episodes[i].state, columns, f"episode {i}") for i in seen_by]
    slow, together = slow_steps(poses), np.concatenate(poses)
    still = most_different_poses(together, slow, MORE * config.most)
    moving = most_different_poses(together, ~slow, 2 * MOVING)
    ends = np.cumsum([0, *map(len, poses)])
    finder, rows = _Finder(config, optics), []
    for place, number in enumerate(seen_by):
        steps = {i - ends[place] for i in (*still, *moving) if ends[place] <= i < ends[place + 1]}
        if not steps:
            continue
        for step, rgb in enumerate(recording.episodes[number].sights[config.view].decode()):
            check_stop()
            if step not in steps:
                continue
            picture = NamedPicture(f"episode {number}, step {step}", rgb)
            target = finder.find(picture)
            if target is not None:
                rows.append((number, step, not slow[ends[place] + step], target, picture))
    at_rest = [row for row in rows if not row[2]]
    if len(at_rest) < ENOUGH:
        raise DatasetError(
            f"View '{config.view}' shows {finder.words} in {len(at_rest)} of the {len(still)} "
            f"pictures that differ most; at least {ENOUGH} are needed. {finder.why()}"
        )
    in_motion = [row for row in rows if row[2]]
    rows = [at_rest[i] for i in spread_out(len(at_rest), config.most)]
    rows += [in_motion[i] for i in spread_out(len(in_motion), MOVING)]
    numbers, steps, is_moving, targets, pictures = zip(*rows, strict=True)
    states = {i: recording.episodes[i].state for i in seen_by}
    return Shots(np.array(numbers), np.array(steps), np.array(is_moving), targets, pictures,
                 states, config.mount == "grip")  # fmt: skip


class _Finder:
    """Finds the target in pictures, and remembers where it was not."""

    def __init__(self, config: HandEyeConfig, optics: Optics) -> None:
        self._config, self._optics = config, optics
        self._family: TagFamily = config.family or "36h11"
        self._others: set[int] = set()
        self._without: list[NamedPicture] = []
        self._board: Board | None = board_of(config)

    @property
    def words(self) -> str:
        if self._board:
            return f"the board ({self._board.words})"
        return f"tag {self._config.tag} of the family {self._family}"

    def find(self, picture: NamedPicture) -> Seen | None:
        if board := self._board:
            view = board.find(picture.grey, picture.name)
            sights = Seen(board.points[view.ids], view.pixels) if view else None
        else:
            tags = find_tags(picture, self._family, self._optics)
            self._others |= tags.keys() - {self._config.tag}
            corners = tags.get(self._config.tag)
            size = self._config.size_mm / 1000
            sights = None if corners is None else Seen(square(size), corners)
        if sights is None and len(self._without) < 8:
            self._without.append(picture)
        return sights

    def why(self) -> str:
        """Why there is no target in pictures, and in which."""
        names = ", ".join(p.name for p in self._without[:4])
        words = f"Not in {names}, for example. " if names else ""
        if self._board:
            reasons = (why_not(p.grey, self._board) for p in self._without)
            reason = next((why for why in reasons if why), "")
            more = f"There, {reason}. " if reason else ""
            return words + more + "The detector needs squares of 10 pixels or more, sharp."
        known = {self._config.tag}
        reasons = (why_no_tag(p, self._family, self._others, known) for p in self._without)
        reason = next((why for why in reasons if why), "")
        return words + reason + ("" if not self._others else "--tag names which. ") + NEEDS
