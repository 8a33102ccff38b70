"""Runs and arms: what a report compares.

A *run* is one seed of one setting with its rollouts; an *arm* is all runs of the same settings.
`jaxcam.reports.reading` reads them.
"""

import functools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jaxcam.config.names import TaskName, names_of
from jaxcam.reports.packs.records import NAMED
from jaxcam.results.differences import PairedDifference, paired_difference
from jaxcam.results.protocol import Protocol, counted, is_foreign, lacks, protocol_of
from jaxcam.results.rows import Row
from jaxcam.results.stats import Estimate, success_rate
from jaxcam.runs.foreign import NOT_SAID
from jaxcam.runs.identity import (
    UNSAID,
    USUAL_SPACE,
    Settings,
    changes,
    network_of,
    plain,
    usual_way,
    without_twin,
)
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
        return self.settings.get(name, UNSAID.get(name))

    @functools.cached_property
    def rows(self) -> list[Row]:
        """The counted rows of all its runs."""
        return [row for run in self.runs for row in run.counted]

    @functools.cached_property
    def estimate(self) -> Estimate:
        """Its success with interval."""
        return success_rate(self.rows)

    @functools.cached_property
    def network(self) -> str | None:
        """The conditioning whose network it has, see `jaxcam.runs.identity.network_of`."""
        return network_of(self.settings)

    @property
    def way(self) -> str:
        """How it is told its cameras; "none", or whose twin it is, where it is not."""
        way = self.settings["conditioning"]
        has_rays = way == "none" and self.network not in ("none", None)
        return f"twin of {self.network}" if has_rays else way

    @property
    def is_told_wrong(self) -> bool:
        """Whether its policy was told poses with errors when it was evaluated."""
        return any(map(self.settings.get, ("eval_pose_noise", "eval_pose_drift")))

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
        usual = usual_way(self.settings["task"]) | UNSAID
        usual |= {"views": views, "action_space": USUAL_SPACE}
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
        """Preset and changes in words, and of an image-only arm whose twin it is.

        Args:
            *without: Settings that are said elsewhere.
        """
        shown = {k: v for k, v in self.changes.items() if k not in without}
        if model := without_twin(shown.pop("model", ())):
            shown["model"] = model
        changes = [f"{k} {plain(v)}" for k, v in shown.items()]
        if self.way != self.settings["conditioning"] and "conditioning" not in without:
            changes.insert(0, self.way)
        preset, foreign = self.settings.get("preset"), is_foreign(self.settings["policy"])
        origin = "settings of its own" if foreign else "settings not recorded"
        return ", ".join([f"{preset} preset" if preset is not None else origin, *changes])


def context(arm: Arm, *without: str, network: bool = False) -> str:
    """The settings of an arm but some, to find the arms that differ in these alone.

    Args:
        arm: The arm.
        *without: Names of settings. Without `conditioning` it does not matter whose network it is.
        network: Whether it matters nevertheless, as between an arm and its twin.
    """
    kept = dict(arm.settings)
    if "conditioning" in without:
        kept["model"] = without_twin(kept.get("model") or ())
        if not network:
            without = (*without, "stem")  # says how one way of conditioning is built
    if "action_space" in without:
        without = (*without, "rotations")  # says how one action space writes them
    kept = {k: v for k, v in kept.items() if k not in without}
    return json.dumps([kept, arm.network if network else None], sort_keys=True)


class ImageOnly(NamedTuple):
    """The image-only arm that a conditioned one is compared with."""

    arm: Arm
    is_twin: bool
    """Whether it is known to have the same network, which is fed with one fixed pose."""

    @property
    def words(self) -> str:
        """What it is."""
        return "its twin" if self.is_twin else "image only, not known to be its twin"


OF_WHAT_IS_TOLD = ("pose_noise", "pose_noise_per", "ray_frame", "rays_from",
                   "eval_pose_noise", "eval_pose_drift")  # fmt: skip
"""Settings that an image-only policy does not notice."""


def _told_apart(arm: Arm, *, network: bool = False) -> str:
    """What an arm shares with the image-only arms that it is compared with."""
    return context(arm, "conditioning", *OF_WHAT_IS_TOLD, network=network)


class ImageOnlyArms:
    """All image-only arms, by what they are compared with.

    A gain of the camera is one over the twin. Where nothing is known of an image-only network, as
    of somebody else's or in rows alone, it is compared with what has the same settings, and that is
    said; where it is known to be another network, nothing is.

    Args:
        arms: All there are.
    """

    def __init__(self, arms: Sequence[Arm]) -> None:
        plain_arms = [arm for arm in arms if arm.settings["conditioning"] == "none"]
        self._twins = {self._key(arm): arm for arm in plain_arms if arm.network}
        self._unknown = {_told_apart(a): a for a in plain_arms if not a.network}
        self._others: dict[str, list[Arm]] = {}
        for arm in plain_arms:
            self._others.setdefault(_told_apart(arm), []).append(arm)

    def of(self, arm: Arm) -> ImageOnly | None:
        """What an arm is compared with; None without any, and of an arm that is image-only."""
        if arm.settings["conditioning"] == "none":
            return None
        if twin := self._twins.get(self._key(arm)):
            return ImageOnly(twin, True)
        other = self._unknown.get(_told_apart(arm))
        return other and ImageOnly(other, False)

    def others(self, arm: Arm) -> list[Arm]:
        """Image-only arms that differ from an arm in the network, too, where it has no twin."""
        lacks = self.of(arm) is None and arm.settings["conditioning"] not in ("none", NOT_SAID)
        return self._others.get(_told_apart(arm), []) if lacks else []

    @staticmethod
    def _key(arm: Arm) -> Any:
        return _told_apart(arm, network=True)


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
