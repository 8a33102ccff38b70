"""What a check says of a recorded dataset, and which of its episodes that makes suspicious."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxcam.checks.findings import Finding, Mark, note
from jaxcam.console.words import some
from jaxcam.data.recorded.recording import Episode, Recording

WEIGHTS: dict[Mark, float] = {"good": 0.0, "note": 0.25, "bad": 1.0}
"""What a finding of each mark adds to the suspicion of an episode that it names."""


@dataclass(frozen=True)
class Judged:
    """A finding, and what it is about."""

    finding: Finding
    episodes: tuple[int, ...] = ()
    """Numbers of the episodes; none if it is about all."""
    view: str = ""
    """Name of the camera; empty if it is about none."""
    explained: bool = False
    """Whether it says what is wrong with the calibration: what follows from it need not be said."""


def suspicion(judged: Sequence[Judged], episodes: int) -> np.ndarray:
    """How suspicious each episode is: the weights of the findings that name it [episodes].

    Those that name all tell none from the others, and do not count.
    """
    total = np.zeros(episodes)
    for one in judged:
        if len(named := list(set(one.episodes))) < episodes:
            total[named] += WEIGHTS[one.finding.mark]
    return total


def ranking(recording: Recording, total: np.ndarray) -> Judged | None:
    """The most suspicious episodes, worst first; None where all are alike.

    Args:
        recording: The dataset.
        total: Suspicion of its episodes.
    """
    if not len(total) or np.ptp(total) == 0:
        return None
    order = [int(i) for i in np.argsort(-total, kind="stable") if total[i] > total.min()]
    words = [f"{recording.episodes[i].name} ({total[i]:.3g})" for i in order]
    return Judged(
        note(
            "suspicious episodes",
            got=f"worst first: {some(words, 10)}",
            fix="Look at those first: each counts the findings that name it, 1 for what must be "
            "mended and 0.25 for what is to know.",
        )
    )


def names(recording: Recording, episodes: Sequence[int]) -> str:
    """Episodes as a finding names the place."""
    each = [called(recording.episodes[i]).removeprefix("episode ") for i in episodes]
    return f"episode{'' if len(each) == 1 else 's'} {some(each)}" if each else ""


def called(episode: Episode) -> str:
    """An episode as a finding names it; LeRobot's are called "episode 3" already."""
    return episode.name if episode.name.startswith("episode") else f"episode {episode.name}"
