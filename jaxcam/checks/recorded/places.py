"""Whose poses put the grip where pictures move: a view's own, another view's, or another base's."""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxcam.checks.findings import bad, good, note
from jaxcam.checks.recorded.bases import OtherBase, other_base
from jaxcam.checks.recorded.judged import Judged, names
from jaxcam.checks.recorded.motion import FITS, LEAST, MISFITS, Filmed
from jaxcam.data.cameras import Reading
from jaxcam.data.recorded.recording import Calibration, Recording, Sight

BETTER = 0.08
"""By how much another camera's pose must fit better to be the right one."""
MOST = 0.5
"""Share of the episodes from which on all may be meant."""
FitTable = Mapping[tuple[str, str], Mapping[int, np.ndarray]]
"""How well the calibration of the second view fits the first, by the episode."""


@dataclass(frozen=True)
class Evidence:
    """How well calibrations fit what moves."""

    recording: Recording
    films: Sequence[Filmed] = field(repr=False)
    fits: FitTable = field(repr=False)

    @classmethod
    def of(cls, recording: Recording, films: Sequence[Filmed]) -> "Evidence":
        """FitTable of each view's own calibration, and of those of the other views."""
        fits: dict[tuple[str, str], dict[int, np.ndarray]] = {}
        sights = {(film.episode, film.view): film.sight for film in films}
        for film in films:
            for other in recording.views:
                if theirs := sights.get((film.episode, other)):
                    calibration = _borrowed(film.sight, theirs)
                    fit = film.motion.fit(calibration)
                    fits.setdefault((film.view, other), {})[film.episode] = fit
        return cls(recording, films, fits)

    def without(self, films: Collection[tuple[int, str]]) -> "Evidence":
        """The same but for some films, each an episode and a view."""
        kept = [film for film in self.films if (film.episode, film.view) not in films]
        return Evidence.of(self.recording, kept) if len(kept) < len(self.films) else self

    @property
    def views(self) -> list[str]:
        """Those that can be judged."""
        return [view for view in self.recording.views if (view, view) in self.fits]

    def of_reading(self, reading: Reading, views: Sequence[str]) -> float | None:
        """How well poses fit in some views if they mean something else; None if nobody knows."""
        fits = []
        for film in self.films:
            if film.view in views:
                pose = reading.convert(film.calibration.base_from_camera[None], np.eye(4))[0]
                fits.append(film.motion.fit(replace(film.calibration, base_from_camera=pose)))
        total = np.concatenate(fits) if fits else np.empty(0)
        return float(total.mean()) if len(total) >= LEAST else None

    def mean(self, view: str, calibration: str, episodes: Sequence[int]) -> float:
        """How well a view's calibration fits another in some episodes."""
        each = [self.fits[view, calibration][e] for e in episodes]
        return float(np.concatenate(each).mean())


def _borrowed(own: Sight, other: Sight) -> Calibration:
    """The calibration that a view would have if it were another one."""
    assert own.calibration is not None
    assert other.calibration is not None
    if (own.height, own.width) == (other.height, other.width):
        return other.calibration
    return replace(own.calibration, base_from_camera=other.calibration.base_from_camera)


def check_places(evidence: Evidence) -> Iterator[Judged]:
    """Whether each view's pictures move where its calibration has the grip."""
    recording = evidence.recording
    for view in recording.views:
        if view not in evidence.views:
            got = "not looked at: the camera moves, or its calibration cannot be used"
            yield Judged(note("motion", got=got, where=f"view {view}"))
    swapped = _swapped(evidence)
    exchanged = {(view, e) for pair, odd in swapped.items() for view in pair for e in odd}
    own = {
        view: {e: x for e, x in evidence.fits[view, view].items() if (view, e) not in exchanged}
        for view in evidence.views
    }
    for (one, other), episodes in swapped.items():
        yield _about_swapped(evidence, one, other, episodes)
    means = {v: np.concatenate([*x.values()]) for v, x in own.items() if x}
    wrong = [v for v, x in means.items() if len(x) >= LEAST and x.mean() < FITS]
    base = other_base(evidence.films) if wrong and not swapped else None
    for view in means:
        yield _about_view(recording, view, own[view], base if view in wrong else None)


def _swapped(evidence: Evidence) -> dict[tuple[str, str], list[int]]:
    """Episodes in which two views fit much better with each other's calibration, by the pair.

    Where several pairs would, the one that gains most is taken.
    """
    gains = {}
    for pair in itertools.combinations(evidence.views, 2):
        if odd := _exchanged(evidence, *pair):
            gains[pair] = sum(float(_gains(evidence, *pair, e).sum()) for e in odd), odd
    pairs: dict[tuple[str, str], list[int]] = {}
    taken: set[tuple[str, int]] = set()
    for pair, (_, odd) in sorted(gains.items(), key=lambda item: -item[1][0]):
        films = {(view, e) for view in pair for e in odd}
        if not films & taken:
            pairs[pair], taken = odd, taken | films
    return pairs


def _exchanged(evidence: Evidence, one: str, other: str) -> list[int]:
    """Episodes in which two views fit much better with each other's calibration."""
    both = [e for e in evidence.fits[one, one] if e in evidence.fits.get((one, other), {})]
    odd = _run(evidence, one, other, both)
    rest = [e for e in both if e not in odd]
    if odd and len(odd) >= MOST * len(both) and _gain(evidence, one, other, rest) >= 0:
        odd = both
    return odd if odd and _sure(evidence, one, other, odd) else []


def _gains(evidence: Evidence, one: str, other: str, episode: int) -> np.ndarray:
    """By how much each pair of pictures of two views fits better if they are exchanged."""
    fits = evidence.fits
    return np.concatenate(
        [fits[a, b][episode] - fits[a, a][episode] for a, b in ((one, other), (other, one))]
    )


def _gain(evidence: Evidence, one: str, other: str, episodes: Sequence[int]) -> float:
    gains = [_gains(evidence, one, other, e) for e in episodes]
    total = np.concatenate(gains) if gains else np.empty(0)
    return float(total.mean()) if len(total) else 0.0


def _run(evidence: Evidence, one: str, other: str, episodes: Sequence[int]) -> list[int]:
    """The episodes in a row in which exchanging two views gains most beyond `BETTER`."""
    best, most, start, total = (0, 0), 0.0, 0, 0.0
    for i, e in enumerate(episodes):
        if total <= 0:
            start, total = i, 0.0
        total += float((_gains(evidence, one, other, e) - BETTER).sum())
        if total > most:
            best, most = (start, i + 1), total
    return list(episodes[slice(*best)])


def _sure(evidence: Evidence, one: str, other: str, episodes: Sequence[int]) -> bool:
    """Whether both views fit with each other's calibration, and each better than with its own."""
    for a, b in ((one, other), (other, one)):
        if sum(len(evidence.fits[a, b][e]) for e in episodes) < LEAST // 2:
            return False
        crossed = evidence.mean(a, b, episodes)
        if crossed < FITS or crossed - evidence.mean(a, a, episodes) < BETTER / 2:
            return False
    return True


def _about_swapped(evidence: Evidence, one: str, other: str, episodes: Sequence[int]) -> Judged:
    own, crossed = (
        np.mean([evidence.mean(a, b, episodes) for a, b in pairs])
        for pairs in (((one, one), (other, other)), ((one, other), (other, one)))
    )
    where = f"views {one} and {other}"
    if len(episodes) < len(evidence.fits[one, one]):
        where += f", {names(evidence.recording, episodes)}"
    return Judged(
        bad(
            "motion",
            got=f"{one} and {other} are swapped: by each other's calibration the grip moves more "
            f"than {crossed:.0%} of the picture, by their own more than {own:.0%}",
            expected="most by their own",
            where=where,
            fix="Exchange their calibrations, or their pictures.",
        ),
        tuple(episodes),
    )


def _about_view(
    recording: Recording, view: str, each: Mapping[int, np.ndarray], base: OtherBase | None
) -> Judged:
    """What a view's own calibration says of its motion."""
    where, total = f"view {view}", np.concatenate(list(each.values()))
    if len(total) < LEAST:
        got = f"not known: where the grip moves, pictures change in places in {len(total)} pairs"
        return Judged(note("motion", got=got, where=where))
    mean = float(total.mean())
    got, expected = f"the grip moves more than {mean:.0%} of the picture", f"at least {FITS:.0%}"
    if mean < FITS:
        finding = bad if mean < MISFITS or base else note
        fix = (
            "Poses are of another base or camera, K is of another picture, or --grip names other "
            "numbers than the grip's position in the robot's base frame (m)."
        )
        if base:
            fix = f"Likely cause: {base.words}."
        got = f"{got}: it moves elsewhere"
        return Judged(
            finding("motion", got=got, expected=expected, where=where, fix=fix), tuple(each)
        )
    odd = [e for e, x in each.items() if len(x) >= LEAST // 2 and x.mean() < MISFITS]
    if not odd:
        return Judged(good("motion", got=got, where=where))
    return Judged(
        note(
            "motion",
            got="the grip is not where the picture moves",
            expected=expected,
            where=f"{where}, {names(recording, odd)}",
            fix="Look whether its pictures are of another episode or time, or somebody walked by.",
        ),
        tuple(odd),
    )
