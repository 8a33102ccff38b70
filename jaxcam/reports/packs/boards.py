"""What a leaderboard shows: for each task and scene the settings of all packs, side by side."""

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from jaxcam.console.words import plain_line
from jaxcam.errors import ConfigError
from jaxcam.interrupts import check_stop
from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, group, kind_of_pairs, usual_views
from jaxcam.reports.packs.directions import DirectionMap, direction_maps
from jaxcam.reports.packs.pack import Pack
from jaxcam.reports.tables import NONE
from jaxcam.results.differences import PairedDifference
from jaxcam.results.rows import CONDITIONS
from jaxcam.results.stats import Estimate, p_text
from jaxcam.runs.foreign import NOT_SAID
from jaxcam.runs.identity import plain

MOST = 200
"""Settings of one task on a page: each is compared with each other one."""
_POSES = {
    "none": "image only",
    "given": "told the camera",
    NOT_SAID: "sent the camera, use not said",
}


@dataclass(frozen=True)
class Against:
    """A paired difference, as a page shows it.

    Attributes:
        points: The difference with its interval.
        basis: Its p-value and pairs.
        value: For sorting, in points; None without shared pairs.
        verdict: "more" or "less" where the interval has no zero in it, else empty.
    """

    points: str
    basis: str
    value: float | None
    verdict: str


@dataclass(frozen=True)
class Line:
    """One setting of one pack.

    Attributes:
        policy: Its name.
        pose: What it is told of the camera.
        details: Its other settings.
        pack: Name of the pack.
        estimate: Its success.
        rollouts: How many, and how many are asked for where that is more.
        map: Success by direction; None where no angles are known.
        against: The difference to each line of the board, by its number.
        entry: What it is called whatever the task.
    """

    policy: str
    pose: str
    details: str
    pack: str
    estimate: Estimate
    rollouts: str
    map: DirectionMap | None
    against: tuple[Against, ...]
    entry: tuple[str, str, str, str]

    @property
    def name(self) -> str:
        """What tells it from other lines."""
        return f"{self.policy}, {self.pose} ({self.pack}; {self.details})"

    @property
    def percents(self) -> tuple[float, float, float]:
        """Success and the ends of its interval."""
        e = self.estimate
        return 100 * e.value, 100 * e.low, 100 * e.high

    def differences(self) -> str:
        """All of `against` as JSON, for the page's script."""
        return json.dumps([[a.points, a.basis, a.value, a.verdict] for a in self.against])


@dataclass(frozen=True)
class OverTasks:
    """A policy that was evaluated on several boards.

    Attributes:
        entry: Its name, what it is told of the camera, its other settings, and its pack.
        lines: Its line of each board; None where it has none, or several.
    """

    entry: tuple[str, str, str, str]
    lines: tuple[Line | None, ...]


@dataclass(frozen=True)
class BoardOfRuns:
    """All settings of one task, scene, number of cameras and conditions, the best one first.

    Attributes:
        task: Its title.
        title: What it is of.
        lines: At least one.
    """

    task: str
    title: str
    lines: tuple[Line, ...]


def boards_of(packs: Sequence[Pack], split: str) -> list[BoardOfRuns]:
    """The boards of packs, the paper's tasks first.

    Args:
        packs: From `read_packs`.
        split: Which pairs; packs of others are left out.

    Raises:
        ConfigError: No pack has rollouts of such pairs, or there are too many settings.
    """
    names = pack_names(packs)
    kinds: dict[tuple[str, str, int | None, tuple[str, ...]], list[tuple[Arm, str]]] = {}
    for pack, name in zip(packs, names, strict=True):
        if pack.manifest.split == split:
            for arm in group(run for run in pack.runs if run.rows):
                kind = *kind_of_pairs(arm.settings), _conditions(arm)
                kinds.setdefault(kind, []).append((arm, name))
    if not kinds:
        raise ConfigError(f"None of the packs has rollouts of {split} pairs. Give another --split.")
    tasks = [*paper.TASKS, *sorted({task for task, *_ in kinds} - paper.TASKS.keys())]
    order = sorted(
        kinds, key=lambda k: (tasks.index(k[0]), k[1] == "fixed", str(k[2]), len(k[3]), k[3])
    )
    return [_board(*kind, kinds[kind]) for kind in order]


def over_tasks(boards: Sequence[BoardOfRuns]) -> list[OverTasks]:
    """The policies that stand on several boards, in order of first appearance.

    Args:
        boards: From `boards_of`.
    """
    columns = []
    for board in boards:
        count = Counter(line.entry for line in board.lines)
        columns.append({line.entry: line for line in board.lines if count[line.entry] == 1})
    entries = dict.fromkeys(entry for column in columns for entry in column)
    rows = [OverTasks(e, tuple(column.get(e) for column in columns)) for e in entries]
    return [row for row in rows if len(row.lines) - row.lines.count(None) > 1]


def pack_names(packs: Sequence[Pack]) -> list[str]:
    """The packs' names; those that several have with the start of their digests.

    Args:
        packs: All that are shown.
    """
    count = Counter(pack.manifest.name for pack in packs)
    manifests = [pack.manifest for pack in packs]
    return [m.name if count[m.name] == 1 else f"{m.name} [{m.digest[:8]}]" for m in manifests]


def _conditions(arm: Arm) -> tuple[str, ...]:
    """What was varied in an arm's evaluation, in words: what is seen otherwise is no other rank."""
    said = ((name, arm.settings.get(name)) for name in CONDITIONS)
    words = (f"{name.removeprefix('eval_')} {plain(value)}" for name, value in said if value)
    return tuple(map(plain_line, words))


def _board(
    task: str,
    scene: str,
    views: int | None,
    conditions: tuple[str, ...],
    arms: Sequence[tuple[Arm, str]],
) -> BoardOfRuns:
    if len(arms) > MOST:
        raise ConfigError(
            f"There are {len(arms)} settings of {task}, {scene}, but a page has {MOST} at most. "
            "Leave some packs out."
        )
    arms = sorted(arms, key=lambda a: (-(a[0].estimate.value if a[0].estimate.n else -1), a[1]))
    maps = direction_maps([arm.rows for arm, _ in arms])
    lines = list[Line]()
    for i, (arm, name) in enumerate(arms):
        check_stop()
        # Letters that turn a line round, or hide, would make one entry look like another.
        title = plain_line(paper.policy_title(arm.settings["policy"], short=False))
        pose = plain_line(pose_words(arm))
        lines.append(
            Line(
                policy=title,
                pose=pose,
                details=plain_line(arm.label(*CONDITIONS)),
                pack=name,
                estimate=arm.estimate,
                rollouts=arm.count(),
                map=maps[i],
                against=tuple(_against(arms, i, k) for k in range(len(arms))),
                entry=(
                    title,
                    pose,
                    plain_line(arm.label("engine", *CONDITIONS)),
                    name,
                ),  # a task brings its own
            )
        )
    cameras = [] if views == usual_views(task) else [f"{views} cameras"]
    title = ", ".join([paper.task_title(task), f"{scene} scene", *cameras, *conditions])
    return BoardOfRuns(paper.task_title(task), title, tuple(lines))


def pose_words(arm: Arm) -> str:
    """What an arm's policy is told of the camera.

    Args:
        arm: Of any policy.
    """
    way = arm.settings["conditioning"]
    return _POSES.get(way) or f"told the camera ({way})"


def _against(arms: Sequence[tuple[Arm, str]], i: int, k: int) -> Against:
    """The difference of a line to a reference; that of the reference to it is its mirror image."""
    if i == k:
        return Against("reference", "", 0.0, "")
    (arm, _), (other, _) = arms[i], arms[k]
    d = arm.against(other) if i < k else _mirrored(other.against(arm))
    if not d.pairs:
        return Against(NONE, "no shared pairs", None, "")
    value, low, high = (100 * x for x in (d.value, d.low, d.high))
    basis = f"p {p_text(d.p_value)}, {d.pairs} pairs"
    basis += f", {d.unpaired} unpaired" if d.unpaired else ""
    verdict = "more" if low > 0 else "less" if high < 0 else ""
    value = round(value, 6) + 0.0
    return Against(f"{value:+.1f} [{low:+.1f}, {high:+.1f}]", basis, value, verdict)


def _mirrored(d: PairedDifference) -> PairedDifference:
    """The difference the other way round."""
    value = d.value if math.isnan(d.value) else -d.value
    return PairedDifference(value, -d.high, -d.low, d.p_value, d.pairs, d.unpaired, d.excluded)
