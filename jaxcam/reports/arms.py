"""Runs and arms: what a report compares.

A *run* is one seed of one setting with its rollouts; an *arm* is all runs of the same settings.
`jaxcam.reports.reading` reads them.
"""

import functools
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxcam.config.names import TaskName, names_of
from jaxcam.reports.packs.records import NAMED
from jaxcam.results.differences import PairedDifference, paired_difference
from jaxcam.results.protocol import Protocol, counted, is_foreign, lacks, protocol_of
from jaxcam.results.rows import USUAL_WAY, Row
from jaxcam.results.stats import Estimate, success_rate
from jaxcam.runs.identity import OF_CAMERAS, USUAL_SPACE, Settings, changes, plain
from jaxcam.sim import make_task

_SAID = (*NAMED, "preset")
"""What is said elsewhere than among the settings that an arm differs in."""


@dataclass(frozen=True)
class Run:
    """One seed of one setting.

    Attributes:
        name: Its folder's name.
        folder: Where its videos are; None if only its rows are known.
        settings: What makes it comparable to others; seed and file names are not among them.
        seed: Its seed.
        rows: Its evaluation rows, one a rollout.
        seconds: Wall time of its training; 0 if unknown.
        source: Where it was read from, for messages.
    """

    name: str
    folder: Path | None
    settings: Settings
    seed: int | None
    rows: list[Row]
    seconds: float = 0.0
    source: str = ""

    @property
    def protocol(self) -> Protocol:
        """What its evaluation is measured against."""
        return protocol_of(self.settings.get("policy", ""))

    @property
    def counted(self) -> list[Row]:
        """The rows its success rate is taken over."""
        return counted(self.rows, self.protocol)


@dataclass(frozen=True, eq=False)
class Arm:
    """All runs of the same settings: a cell of a table, a bar of a figure."""

    runs: tuple[Run, ...]

    @property
    def settings(self) -> Settings:
        """What its runs share."""
        return self.runs[0].settings

    def setting(self, name: str) -> Any:
        """One of its settings, as usual where it has it not.

        Args:
            name: Of the setting.
        """
        return self.settings.get(name, OF_CAMERAS.get(name))

    @functools.cached_property
    def rows(self) -> list[Row]:
        """The counted rows of all its runs."""
        return [row for run in self.runs for row in run.counted]

    @functools.cached_property
    def estimate(self) -> Estimate:
        """Its success with interval."""
        return success_rate(self.rows)

    def against(self, other: "Arm") -> PairedDifference:
        """Its success minus another arm's on the pairs that both have; computed once."""
        if other not in self._differences:
            self._differences[other] = paired_difference(self.rows, other.rows)
        return self._differences[other]

    @functools.cached_property
    def _differences(self) -> dict["Arm", PairedDifference]:
        return {}

    @functools.cached_property
    def lacks(self) -> list[str]:
        """What it lacks of the protocol."""
        runs = [run.counted for run in self.runs]
        return lacks(runs, self.runs[0].protocol, self.settings.get("steps"))

    @functools.cached_property
    def changes(self) -> Settings:
        """The settings in which it is not what its policy's preset and its task give.

        Without a preset, such as of somebody else's policy, these are all that are known.
        """
        if self.settings.get("preset") is not None:
            return changes(self.settings)
        views = usual_views(self.settings["task"])
        usual = USUAL_WAY | OF_CAMERAS | {"views": views, "action_space": USUAL_SPACE}
        return {
            k: v for k, v in self.settings.items()
            if k not in _SAID and v not in (None, "", [], usual.get(k))
        }  # fmt: skip

    def count(self) -> str:
        """Rollouts, and how many the protocol asks for where it lacks any."""
        asked = self.runs[0].protocol.rollouts
        n = self.estimate.n
        if not self.lacks:
            return f"{n}"
        return f"{n} of {asked}" if n < asked else f"{n}, {', '.join(self.lacks)}"

    def label(self, *without: str) -> str:
        """Preset and changes in words.

        Args:
            *without: Settings that are said elsewhere.
        """
        changes = (f"{k} {plain(v)}" for k, v in self.changes.items() if k not in without)
        preset, foreign = self.settings.get("preset"), is_foreign(self.settings["policy"])
        origin = "settings of its own" if foreign else "settings not recorded"
        return ", ".join([f"{preset} preset" if preset is not None else origin, *changes])


def group(runs: Iterable[Run]) -> list[Arm]:
    """Runs of the same settings as one arm each, in order of first appearance."""
    arms: dict[str, list[Run]] = {}
    for run in runs:
        arms.setdefault(json.dumps(run.settings, sort_keys=True), []).append(run)
    return [Arm(tuple(sorted(some, key=lambda r: r.seed or 0))) for some in arms.values()]


@functools.cache
def usual_views(task: str) -> int | None:
    """The cameras of a task's pairs where nobody says another number; None of unknown tasks.

    Args:
        task: Its name.
    """
    return make_task(task).views if task in names_of(TaskName) else None


def kind_of_pairs(settings: Settings) -> tuple[str, str, int | None]:
    """Task, scene and number of cameras: runs that share these have the same pairs.

    Args:
        settings: Of a run.
    """
    task = settings["task"]
    return task, settings["scene"], settings.get("views") or usual_views(task)
