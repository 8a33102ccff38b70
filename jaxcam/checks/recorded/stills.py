"""Whether a camera stood where it is said to have stood, by what never moves in its pictures.

A camera that is bumped still has its old pose in the dataset. But what stands still in an episode,
its background, then is elsewhere in the picture than in the episodes before. Corners of one
background are followed into the other; the motion that most of them agree on is the camera's, so
objects that were moved do not count.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from jaxcam.checks.findings import bad, good, note
from jaxcam.checks.recorded.cameras import same_key
from jaxcam.checks.recorded.judged import Judged, called, names
from jaxcam.checks.recorded.looks import Look, Looks
from jaxcam.console.words import some

STILL_LEVELS = 4
"""Levels (of 255) that a pixel of the background may differ from its median in most pictures."""
CORNERS = 200
"""Corners that are followed."""
AROUND = 0.05
"""Width, in pictures, of what a place is compared with, so that light does not matter."""
NOISE = 2.0
"""Levels of contrast that mean nothing."""
LEAST = 8
"""Corners below which nothing is said."""
AGREE = 0.35
"""Share of the followed corners that must agree."""
BACK = 0.5
"""Pixels by which a corner that is followed there and back may miss itself."""
MOVED = (0.3, 0.0025)
"""Pixels, and share of a picture's longer side, beyond both of which a background has moved."""
RESTLESS = 1 / 3
"""Share of the episodes that may be the first of a new place before the surroundings change."""
ROLL_DEG = 0.7
"""Turn about the middle of the picture from which it is worth saying."""
SURE = 2.0
"""How many times `MOVED` a single episode must be elsewhere to be more than worth a look."""
SAID = 4.0
"""How many times `MOVED` a pose must say that the picture moves for its not moving to be odd."""


@dataclass(frozen=True)
class Background:
    """What stands still in an episode."""

    picture: np.ndarray
    """Median of its pictures, uint8 [h, w]."""
    still: np.ndarray
    """Which pixels hardly ever change, uint8 [h, w], 0 or 1."""


@dataclass(frozen=True)
class Shift:
    """How far what never moves has moved between two episodes."""

    pixels: float
    """The median over the corners that agree."""
    roll_deg: float
    """By how much it was turned in the picture."""


def background(look: Look) -> Background:
    """The background of an episode."""
    median = np.median(look.grey, 0)
    spread = np.median(abs(look.grey - median), 0)
    still = cv2.erode((spread <= STILL_LEVELS).astype(np.uint8), np.ones((3, 3), np.uint8))
    return Background(median.astype(np.uint8), still)


def shift(one: Background, other: Background) -> Shift | None:
    """How far what never moves has moved from one episode to another.

    Args:
        one: Background of the first.
        other: Background of the second, of the same size.

    Returns:
        None where too few corners can be followed, or too few agree.
    """
    if one.picture.shape != other.picture.shape:
        return None
    corners = cv2.goodFeaturesToTrack(one.picture, CORNERS, 0.01, 3, mask=one.still)
    if corners is None or len(corners) < LEAST:
        return None
    first, second = _evenly_lit(one.picture), _evenly_lit(other.picture)
    there, ok = _follow(first, second, corners)
    back, ok_back = _follow(second, first, there)
    ok &= ok_back & (np.linalg.norm(back - corners, axis=-1)[:, 0] < BACK)
    if ok.sum() < LEAST:
        return None
    cv2.setRNGSeed(0)
    start, end = corners[ok], there[ok]
    moved, inside = cv2.estimateAffinePartial2D(start, end, ransacReprojThreshold=1.0)
    if inside is None or inside.sum() < max(LEAST / 2, AGREE * len(start)):
        return None
    pixels = float(np.median(np.linalg.norm(end - start, axis=-1)[inside > 0]))
    return Shift(pixels, float(np.rad2deg(np.arctan2(moved[1, 0], moved[0, 0]))))


def _evenly_lit(picture: np.ndarray) -> np.ndarray:
    """A picture without what light adds: each place against the mean and spread around it."""
    values = picture.astype(np.float32)
    sigma = AROUND * max(picture.shape)
    values -= cv2.GaussianBlur(values, (0, 0), sigma)
    spread = np.sqrt(cv2.GaussianBlur(values**2, (0, 0), sigma)) + NOISE
    return np.clip(128 + 50 * values / spread, 0, 255).astype(np.uint8)


def _follow(one: np.ndarray, other: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where corners [N, 1, 2] of a picture are in another, and whether they are, bool [N]."""
    there, ok, _ = cv2.calcOpticalFlowPyrLK(one, other, at, at.copy(), winSize=(15, 15), maxLevel=3)
    return there, ok[:, 0] > 0


class _View:
    """The backgrounds of one view's episodes."""

    def __init__(self, looks: Looks, view: str) -> None:
        self._looks, self.view = looks, view
        self.recording = looks.recording
        self._backgrounds: dict[int, Background] = {}

    def background(self, episode: int) -> Background | None:
        if episode not in self._backgrounds:
            look = self._looks.at(episode, self.view)
            if look is None:
                return None
            self._backgrounds[episode] = background(look)
        return self._backgrounds[episode]

    def apart(self, a: int, b: int) -> Shift | None:
        """How far two episodes' backgrounds are apart, if that can be said."""
        one, other = self.background(a), self.background(b)
        return shift(one, other) if one and other else None

    def limit(self, episode: int) -> float:
        """Pixels beyond which a background has moved."""
        shown = self._backgrounds[episode].picture
        return max(MOVED[0], MOVED[1] * max(shown.shape))

    def same(self, a: int, b: int) -> bool | None:
        """Whether the camera stood where it stood in another episode."""
        apart = self.apart(a, b)
        return None if apart is None else apart.pixels <= self.limit(a)

    def in_words(self, before: Sequence[int], after: Sequence[int]) -> str:
        """How far the picture has moved, in recorded pixels and degrees.

        Args:
            before: Episodes before it moved, the nearest last.
            after: Episodes after it moved, the nearest first.
        """
        for a, b in [(a, b) for b in after for a in reversed(before)]:
            apart, look = self.apart(a, b), self._looks.at(b, self.view)
            if apart is None or look is None:
                continue
            pixels = apart.pixels / look.scale
            words = f"by {pixels:.2g} pixels"
            if calibration := self.recording.episodes[b].sights[self.view].calibration:
                f = float(np.reshape(calibration.K, (-1, 3, 3))[0, 1, 1])
                words += f" ({np.rad2deg(np.arctan(pixels / f)):.2g}°)"
            if abs(apart.roll_deg) > ROLL_DEG:
                words += f", turned about its middle by {abs(apart.roll_deg):.2g}°"
            return words
        return "far"


def check_stills(looks: Looks, episodes: Sequence[int]) -> Iterator[Judged]:
    """Whether each camera that is said to stand still does.

    Args:
        looks: The pictures.
        episodes: Those that are looked at, ascending; others are where a change is looked for.
    """
    for view in looks.recording.views:
        shown = [e for e in episodes if looks.at(e, view) is not None]
        sights = {e: looks.recording.episodes[e].sights[view] for e in shown}
        if any(s.calibration and s.calibration.base_from_camera.ndim == 3 for s in sights.values()):
            what = "it is said to move"
            yield Judged(note("standing still", got=f"not looked at: {what}", where=f"view {view}"))
            continue
        groups: dict[object, list[int]] = {}
        for e in shown:
            key = same_key(sights[e].calibration), sights[e].height, sights[e].width
            groups.setdefault(key, []).append(e)
        several = [group for group in groups.values() if len(group) > 1]
        about = _View(looks, view)
        if several:
            for group in several:
                yield from _check_group(about, group)
        elif len(shown) > 1:
            got = "not looked at: each episode has a pose of its own"
            yield Judged(note("standing still", got=got, where=f"view {view}"))
        yield from _said_to_move(about, shown)


def _check_group(view: _View, group: Sequence[int]) -> Iterator[Judged]:
    """Whether a view stands still in episodes of one calibration."""
    where = f"view {view.view}"
    places = _places(view, group)
    known = [e for e in group if e in places]
    if len(known) < 2:
        got = "not looked at: its pictures have too little that never moves"
        yield Judged(note("standing still", got=got, where=where))
        return
    count = max(places.values()) + 1
    if count > 2 and count - 1 > RESTLESS * len(known):
        got = f"not known: what never moves is elsewhere in {count} of {len(known)} episodes"
        fix = "Right if the surroundings are changed between episodes; else the camera is loose."
        yield Judged(note("standing still", got=got, where=where, fix=fix))
        return
    runs = _runs(known, places)
    if len(runs) == 1:
        yield Judged(good("standing still", got=f"in {len(known)} episodes", where=where))
    been = {places[runs[0][0]]}
    for before, run, after in zip(runs, runs[1:], [*runs[2:], None], strict=False):
        if places[run[0]] not in been:  # else it is back where it was
            been.add(places[run[0]])
            yield _moved(view, before, run, after)


def _runs(known: Sequence[int], places: Mapping[int, int]) -> list[list[int]]:
    """Episodes in a row at one place."""
    return [list(run) for _, run in itertools.groupby(known, key=lambda e: places[e])]


def _moved(
    view: _View, before: Sequence[int], run: Sequence[int], after: Sequence[int] | None
) -> Judged:
    """That a camera stood elsewhere in a run of episodes than in the one before it."""
    recording = view.recording
    first = _first(view, before[-1], run[0])
    end = _first(view, run[-1], after[0]) if after else len(recording.episodes)
    odd = [e for e in range(first, end) if view.view in recording.episodes[e].sights]
    which = names(recording, odd) if after else f"from {called(recording.episodes[first])} on"
    words = view.in_words(before, [first, *(e for e in run if e != first)])
    apart = view.apart(before[-1], run[0])
    is_far = apart is not None and apart.pixels > SURE * view.limit(before[-1])
    is_sure = len(run) > 1 or is_far
    finding = bad if is_sure else note
    return Judged(
        finding(
            "standing still",
            got=f"its picture has moved {words}; its pose has not",
            expected="what never moves at the same place in the picture",
            where=f"view {view.view}, {which}",
            fix="The camera was bumped, or pictures are of another one, and its pose is still the "
            "old one: calibrate it anew and give the pose of those episodes "
            "(docs/calibrated-datasets.md), or leave them out.",
        ),
        tuple(odd),
        view.view,
    )


def _places(view: _View, group: Sequence[int]) -> dict[int, int]:
    """Numbers of the places where the camera stood, by the episode; left out where not known."""
    first_there: list[int] = []
    places: dict[int, int] = {}
    for episode in group:
        if view.background(episode) is None:
            continue
        answers = [view.same(e, episode) for e in first_there]
        before = [e for e in places if places[e] == len(first_there) - 1]
        if True in answers:
            places[episode] = answers.index(True)
        elif before and _stands(view, before, episode):
            places[episode] = places[before[-1]]
        elif False in answers or (not first_there and view.same(episode, episode) is not None):
            places[episode] = len(first_there)
            first_there.append(episode)
    return places


def _stands(view: _View, before: Sequence[int], episode: int) -> bool:
    """Whether the camera stood where it stood last, as far as can be told."""
    answers = (view.same(e, episode) for e in reversed(before))
    return bool(next((answer for answer in answers if answer is not None), False))


def _first(view: _View, before: int, after: int) -> int:
    """The first episode at a new place, looked for between two that were looked at."""
    old, new = before, after
    while new - old > 1:
        middle = (old + new) // 2
        stands = view.same(before, middle)
        if stands is None:
            moved = view.same(after, middle)
            stands = not moved if moved is not None else None
        if stands is None:
            return new
        old, new = (middle, new) if stands else (old, middle)
    return new


def _said_to_move(view: _View, episodes: Sequence[int]) -> Iterator[Judged]:
    """A note where poses say that a camera was moved, and pictures that it was not."""
    odd = []
    for a, b in itertools.pairwise(episodes):
        one, other = (view.recording.episodes[e].sights[view.view].calibration for e in (a, b))
        if one is None or other is None or same_key(one) == same_key(other):
            continue
        turn = one.base_from_camera[:3, :3].T @ other.base_from_camera[:3, :3]
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        apart, look = view.apart(a, b), view.background(a)
        if apart is None or look is None:
            continue
        scale = max(look.picture.shape) / max(
            view.recording.episodes[a].sights[view.view].height,
            view.recording.episodes[a].sights[view.view].width,
        )
        said = np.tan(min(angle, 1.0)) * np.reshape(one.K, (-1, 3, 3))[0, 1, 1] * scale
        if apart.pixels <= view.limit(a) and said > SAID * view.limit(a):
            odd.append(b)
    if odd:
        words = some([view.recording.episodes[e].name for e in odd])
        yield Judged(
            note(
                "standing still",
                got=f"its pose changes before episodes {words}; its picture does not",
                where=f"view {view.view}",
                fix="Look whether those poses are of another camera or day.",
            ),
            tuple(odd),
        )
