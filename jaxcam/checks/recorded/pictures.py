"""Whether films show anything, and go on while the robot moves."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import cv2
import numpy as np

from jaxcam.checks.findings import bad, good
from jaxcam.checks.recorded.judged import Judged, names
from jaxcam.checks.recorded.looks import Looks
from jaxcam.data.recorded.recording import Recording

BLACK = 8
"""Grey level up to which a picture is black: a covered lens, or a camera that died."""
NOISE = 5
"""Grey levels that sensors and codecs add to what is of one colour or stands still."""
ODD = 0.5
"""Percent of a picture's pixels, at either end, that do not count for its colour."""
MOST = 0.75
"""Share of a film's pictures that are alike, one after the other, if it stands still."""
WAY = 0.03
"""Distance (m) that the grip goes while pictures cannot stay the same."""
SPAN = 0.1
"""The same of most numbers of the state, as a share of what each spans in all episodes, where
nobody says where the grip is."""
NOISY = 0.4
"""Share of what a number spans that one step in twenty exceeds if it is noise (0.7 if that is
normal), as of forces or of joints that nobody moves: it does not tell whether the robot moves."""

Goes = Callable[[int, int, int], bool]
"""Whether the robot moves in an episode between two of its steps."""


def check_pictures(looks: Looks, grip: Sequence[int] | None, *, states: bool) -> Iterator[Judged]:
    """Whether pictures can be decoded, are not black or mostly of one colour, and move.

    Some of one colour may be right: a camera may stand so near to the robot that it sees nothing
    else for a while.

    Args:
        looks: What was looked at.
        grip: Columns of the state that are the grip's position (m), where that is known.
        states: Whether states can be read at all, to tell whether the robot moves.
    """
    recording = looks.recording
    for (episode, view), why in looks.broken.items():
        where = f"view {view}, {names(recording, [episode])}"
        fix = "Copy that file anew, or leave the episode out."
        yield Judged(bad("pictures", got=why, where=where, fix=fix), (episode,))
    goes = _motion(recording, grip) if states else None
    odd: dict[tuple[str, str], list[int]] = {}
    total = 0
    for view in recording.views:
        for e, look in looks.of(view).items():
            total += len(look.grey)
            words = _fault(
                look.grey, look.steps, lambda *steps, e=e: bool(goes and goes(e, *steps))
            )
            if words:
                odd.setdefault((words, view), []).append(e)
    for (words, view), episodes in sorted(odd.items()):
        where = f"view {view}, {names(recording, episodes)}"
        fix = "Leave those out: a policy learns from them to ignore its eyes."
        finding = bad("pictures", got=f"pictures are {words}", where=where, fix=fix)
        yield Judged(finding, tuple(episodes))
    if not (looks.broken or odd):
        still = ", no film stands still" if goes else "; whether films stand still is not known"
        yield Judged(good("pictures", got=f"{total} looked at; none is blank{still}"))


def _fault(grey: np.ndarray, steps: np.ndarray, goes: Callable[[int, int], bool]) -> str:
    """What is wrong with pictures [n, h, w] of some steps [n]; empty if nothing is."""
    smooth = np.stack([cv2.blur(picture, (5, 5)) for picture in grey]).astype(np.int16)
    low, high = np.percentile(smooth, [ODD, 100 - ODD], axis=(1, 2))
    if (high <= BLACK).any():
        return "black"
    if (high - low <= NOISE).mean() > 0.5:
        return "of one colour"
    first = 0
    for i in range(1, len(smooth) + 1):
        if i < len(smooth) and abs(smooth[i] - smooth[first]).max() <= NOISE:
            continue
        if i - first >= max(2, MOST * len(smooth)) and goes(steps[first], steps[i - 1]):
            return "all the same"
        first = i
    return ""


def _motion(recording: Recording, grip: Sequence[int] | None) -> Goes | None:
    """None where no state says whether the robot moves."""
    states = [episode.state for episode in recording.episodes]
    moves = _robot_moves(states) if grip is None else partial(_grip_moves, columns=list(grip))
    if not any(map(moves, states)):
        return None
    return lambda e, first, last: moves(states[e][first : last + 1])


def _grip_moves(state: np.ndarray, columns: list[int]) -> bool:
    return bool(np.linalg.norm(_between(state[:, columns], 0, 100)) > WAY)


def _robot_moves(states: Sequence[np.ndarray]) -> Callable[[np.ndarray], bool]:
    """Whether most numbers of a state go far, of those that are not noise."""
    usual = _between(np.concatenate(states), 2, 98)
    steps = _between(np.concatenate([_steps(state) for state in states]), 0, 95)
    tells = steps < NOISY * usual

    def moves(state: np.ndarray) -> bool:
        goes = _between(state, 0, 100) > SPAN * usual
        return bool(2 * goes[tells].sum() > tells.sum())

    return moves


def _steps(state: np.ndarray) -> np.ndarray:
    """How far numbers go from one step to the next."""
    with np.errstate(invalid="ignore"):  # from infinity to infinity
        return abs(np.diff(state, axis=0))


def _between(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """How far apart two percentiles of each column are [S], of numbers that are some."""
    columns = [column[np.isfinite(column)] for column in values.T]
    return np.array([np.ptp(np.percentile(c, [low, high])) if len(c) else 0.0 for c in columns])
