"""The tables of a report: the paper's Table I beside ours, and paired differences."""

import csv
import io
import math
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, ImageOnly, ImageOnlyArms, Run, context, kind_of_pairs
from jaxcam.reports.document import Link, Table
from jaxcam.reports.names import csv_cell
from jaxcam.results.differences import PairedDifference
from jaxcam.results.protocol import is_foreign
from jaxcam.results.rows import CONDITIONS
from jaxcam.results.stats import by_field, gap_between, p_text, success_rate
from jaxcam.runs.foreign import NOT_SAID
from jaxcam.runs.identity import plain

NONE = "–"
_NOTHING = (math.nan, math.nan)
_OF_TASK = ("n", "m", "views", "steps")  # which tasks bring, so that Table I's columns differ


def twins_of(arms: Sequence[Arm]) -> list[tuple[Arm, ImageOnly]]:
    """Every conditioned arm that has rollouts, with the image-only arm that it is compared with."""
    image_only = ImageOnlyArms(arms)
    clean = by_task(arm for arm in arms if arm.estimate.n and not arm.is_told_wrong)
    pairs = ((arm, image_only.of(arm)) for some in clean.values() for arm in some)
    return [(a, b) for a, b in pairs if b and b.arm.estimate.n]


def without_twins(arms: Sequence[Arm]) -> list[str]:
    """What is said of arms whose image-only runs are of another network; no gain is shown there."""
    image_only, kinds = ImageOnlyArms(arms), dict[tuple[str, str], set[str]]()
    count = Counter[tuple[str, str]]()
    for arm in (arm for arm in arms if arm.estimate.n):
        if others := {other.way for other in image_only.others(arm) if other.estimate.n}:
            kind = arm.settings["policy"], arm.settings["conditioning"]
            kinds.setdefault(kind, set()).update(others)
            count[kind] += 1
    return [
        f"No gain is shown of {paper.policy_title(policy)}, {way}, in {count[policy, way]} "
        f"{'settings' if count[policy, way] > 1 else 'setting'}: the image-only runs are of "
        f"another network ({', '.join(sorted(others))}). The twin is trained with --conditioning "
        f"none --model twin_of={way}."
        for (policy, way), others in kinds.items()
    ]


def table_one(arms: Sequence[Arm]) -> Table:
    """Table I of the paper, with our lines below the paper's.

    Args:
        arms: Of any settings; those of Table I are shown.
    """
    shown = [arm for arm in arms if is_of_table(arm)]
    others = [t for t in by_task(shown) if t not in paper.TASKS]
    tasks = [*paper.TASKS, *others]
    base = ImageOnlyArms(arms)
    rows: list[list[str]] = []
    rules: list[int] = []
    for policy, name in paper.POLICIES.items():
        for conditioned in (False, True):
            rules += [len(rows)] if not conditioned else []
            title = f"{name}\nw. conditioning" if conditioned else name
            rows.append(
                [title, "paper", *(paper.table_cell(policy, t, conditioned) for t in tasks)]
            )
            for source, line in _lines(shown, policy, conditioned):
                rows.append(["", source, *(_rate_cell(line.get(t), base) for t in tasks)])
    for policy in dict.fromkeys(a.settings["policy"] for a in shown if is_foreign_arm(a)):
        rules.append(len(rows))
        for conditioned in (False, True):
            title = f"{policy}\nw. conditioning" if conditioned else policy
            for source, line in _lines(shown, policy, conditioned):
                rows.append([title, source, *(_rate_cell(line.get(t), base) for t in tasks)])
                title = ""
    titles = [paper.task_title(t) for t in tasks]
    caption = (
        "Success in percent with and without camera conditioning (Table I of the paper). A twin is "
        "the same network, trained alike and fed with the pose of one camera that never changes; "
        "in parentheses the gain over a policy's own twin (the paper's: over its image-only one), "
        "in brackets the 95 % interval from a "
        "bootstrap over pairs, n the rollouts. Where there are several seeds, the rates of the "
        "least and the best of them, and from three on an interval over new pairs and new seeds. "
        "Ours have the conditioning of the paper, and those it does not have."
    )
    return Table(caption, ("Method", "Source", *titles), rows, rules)


def gains_table(arms: Sequence[Arm]) -> Table | None:
    """Paired differences of every conditioned arm to its image-only twin; None without any."""
    rows = []
    for arm, twin in twins_of(arms):
        s = arm.settings
        delta = arm.against(twin.arm)
        rows.append([
            paper.policy_title(s["policy"]), _task(arm), s["conditioning"],
            arm.label(), twin.words, _paper_gain(arm), *_difference(delta),
            f"{arm.estimate.n}, {twin.arm.estimate.n}",
        ])  # fmt: skip
    head = ("Policy", "Task", "Conditioning", "Settings", "Over", "Paper", "Gain", "p", "Pairs",
            "Rollouts")  # fmt: skip
    caption = (
        "Gain of camera conditioning in points over the twin, which is the same network, trained "
        "alike and fed with the pose of one camera that never changes: mean over the pairs that "
        "both policies were evaluated on, with 95 % interval over pairs and the p-value of the "
        "same test (Student's t with two pairs added), and beside it what several seeds give."
    )
    return Table(caption, head, rows) if rows else None


def foreign_table(arms: Sequence[Arm]) -> Table | None:
    """Somebody else's policies, each beside ours on the same pairs; None without any.

    Args:
        arms: Of any settings.
    """
    rows: list[list[str]] = []
    rules: list[int] = []
    for arm in (a for some in by_task(arms).values() for a in some if is_foreign_arm(a)):
        s, e = arm.settings, arm.estimate
        own = [paper.policy_title(s["policy"]), _task(arm), s["conditioning"], arm.label(),
               _rate(e.value, e.low, e.high), arm.count()]  # fmt: skip
        rules.append(len(rows))
        others = [] if any(map(s.get, CONDITIONS)) else [
            a for a in arms
            if not is_foreign_arm(a) and paper.is_table_setting(a.settings)
            and kind_of_pairs(a.settings) == kind_of_pairs(s) and a.estimate.n and e.n
        ]  # fmt: skip
        for other in others:
            o = other.settings
            title = f"{paper.policy_title(o['policy'])}, {o['conditioning']}, {other.label()}"
            rows.append([*own, title, *_difference(arm.against(other))])
            own = [""] * len(own)
        if not others:
            rows.append([*own, *[NONE] * 4])
    head = ("Policy", "Task", "Conditioning", "Settings", "Success", "Rollouts", "Against",
            "Difference", "p", "Pairs")  # fmt: skip
    caption = "Policies not trained here, in percent, and paired differences to ours in points."
    return Table(caption, head, rows, rules, folded=len(rows) > 40) if rows else None


def seen_table(arms: Sequence[Arm], memory: Sequence[Arm]) -> Table | None:
    """Success on cameras that training saw and on held-out ones, in columns of their own.

    Args:
        arms: With their rows on held-out pairs.
        memory: With their rows on new starts and cameras that training saw; of the same checkpoints
            both are shown.
    """
    base, rows = ImageOnlyArms(memory), list[list[str]]()
    held_out = {context(arm): arm for arm in arms}
    for arm in (a for some in by_task(memory).values() for a in some if a.estimate.n):
        steps = {row.step for row in arm.rows}
        others = [r for r in getattr(held_out.get(context(arm)), "rows", []) if r.step in steps]
        known, result = arm.estimate, success_rate(others)
        gap = gap_between(result, known) if result.n else None
        rows.append([
            paper.policy_title(arm.settings["policy"]), _task(arm), arm.way,
            arm.label("conditioning"), _rate(known.value, known.low, known.high),
            f"{known.n}", _rate(result.value, result.low, result.high), f"{result.n}",
            "{:+.1f} [{:+.1f}, {:+.1f}]".format(*(100 * x for x in gap)) if gap else NONE,
            _over(arm, base.of(arm)),
        ])  # fmt: skip
    head = ("Policy", "Task", "Conditioning", "Settings", "Seen cameras", "Rollouts",
            "Held-out cameras", "Rollouts", "Difference", "Seen, over its twin")  # fmt: skip
    caption = (
        "Memory: success on new initial states seen by cameras of the training demonstrations. It "
        "is no result. Beside it the same checkpoints on held-out cameras: other pairs, so that "
        "their difference is not paired (its interval is Newcombe's). That to the twin is."
    )
    return Table(caption, head, rows) if rows else None


def is_foreign_arm(arm: Arm) -> bool:
    """Whether an arm's policy is somebody else's."""
    return is_foreign(arm.settings["policy"])


def cells(arms: Sequence[Arm], field: str, order: Mapping[Any, str]) -> Table:
    """Every arm of a figure, with paired differences.

    Args:
        arms: Of the figure.
        field: Setting that the figure varies.
        order: Its values, with their names; the first is what the others are compared with.
    """
    base = ImageOnlyArms(arms)
    first = next(iter(order))
    firsts = {context(a, field): a for a in arms if a.setting(field) == first}
    rows = []
    for arm in arms:
        s, e = arm.settings, arm.estimate
        if field == "conditioning":
            name, ways, others = arm.way, [], []
        else:
            name, ways = order[arm.setting(field)], [arm.way]
            others = [_against(arm, firsts.get(context(arm, field)))]
        rows.append([
            _task(arm) if field != "scene" else paper.task_title(s["task"]),
            arm.label(field, "conditioning"), name, *ways,
            "\n".join([_rate(e.value, e.low, e.high), *e.of_seeds()]), arm.count(),
            _over(arm, base.of(arm)), *others,
        ])  # fmt: skip
    names = ["Conditioning"] if field != "conditioning" else []
    versus = [f"Against {order[first]}"] if field != "conditioning" else []
    head = ("Task", "Settings", "Value", *names, "Success", "Rollouts", "Over its twin",
            *versus)  # fmt: skip
    return Table("The figure's numbers; differences are paired.", head, rows, folded=True)


def runs_table(runs: Iterable[Run], links: Mapping[str, Sequence[Link]]) -> Table:
    """What was run.

    Args:
        runs: All runs.
        links: Videos by where a run is from.
    """
    rows = []
    for run in runs:
        arm = Arm((run,))
        estimate, shown = arm.estimate, run.counted
        steps = sorted(by_field(shown, "step"))
        hours = f"{run.seconds / 3600:.2f}" if run.seconds else NONE
        films = links.get(run.source, ())
        rows.append([
            run.name, NONE if run.seed is None else str(run.seed), arm.label(), f"{len(steps)}",
            f"{max(steps, default=0):,}", str(estimate.n),
            str(estimate.excluded), _rate(estimate.value, estimate.low, estimate.high), hours,
            films[0] if films else NONE,
        ])  # fmt: skip
    head = ("Run", "Seed", "Settings", "Checkpoints", "Newest", "Rollouts", "Did not finish",
            "Success", "Training hours", "Failures")  # fmt: skip
    return Table(f"Runs: {len(rows)}", head, rows, folded=True)


def to_csv(arms: Sequence[Arm]) -> str:
    """All arms with their settings, success, gain over the image-only twin, and the paper's."""
    base = ImageOnlyArms(arms)
    names = list(dict.fromkeys(name for arm in arms for name in arm.settings))
    out = io.StringIO()
    head = [*names, "seeds", "checkpoints", "rollouts", "asked", "lacks", "pairs", "excluded",
            "success", "low", "high", "paper", "gain_over", "gain", "gain_low", "gain_high", "p",
            "gain_pairs", "without_actions", "least_seed", "most_seed", "low_over_seeds",
            "high_over_seeds", "gain_low_over_seeds", "gain_high_over_seeds"]  # fmt: skip
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(csv_cell, head))
    for arm in arms:
        e, twin = arm.estimate, base.of(arm)
        d = twin and arm.against(twin.arm)
        settings = (arm.settings.get(name) for name in names)
        known = paper_value(arm)
        writer.writerow([
            *("" if v is None else csv_cell(plain(v)) for v in settings), len(arm.runs),
            max((len(by_field(r.counted, "step")) for r in arm.runs), default=0), e.n,
            arm.runs[0].protocol.rollouts, "; ".join(arm.lacks), e.clusters, e.excluded,
            *map(_number, (e.value, e.low, e.high)), "" if known is None else f"{known / 100:.3f}",
            twin.words if twin else "",
            *(map(_number, (d.value, d.low, d.high, d.p_value)) if d else [""] * 4),
            d.pairs if d else "", e.broken,
            *map(_number, (min(e.seeds), max(e.seeds)) if e.seeds else _NOTHING),
            *map(_number, e.over_seeds or _NOTHING),
            *map(_number, (d and d.over_seeds) or _NOTHING),
        ])  # fmt: skip
    return out.getvalue()


def paper_value(arm: Arm) -> float | None:
    """Table I's success in percent where the arm has its settings, else None."""
    s = arm.settings
    conditioned = s["conditioning"] != "none"
    if not paper.is_table_setting(s):
        return None
    if conditioned and s["conditioning"] != paper.CONDITIONING.get(s["policy"]):
        return None
    return paper.success(s["policy"], s["task"], conditioned)


def is_of_table(arm: Arm) -> bool:
    """Whether its settings are Table I's, with the paper's conditioning or one it has nowhere.

    Somebody else's policy belongs there however it acts: the table has no other place for it.
    """
    if is_foreign_arm(arm):
        return arm.settings["scene"] == "randomized" and not arm.is_told_wrong
    network = arm.network  # of an image-only arm, whose twin it is
    known = (
        network == paper.CONDITIONING.get(arm.settings["policy"]) or network not in paper.ENCODINGS
    )
    return known and paper.is_table_setting(arm.settings)


def by_task(arms: Iterable[Arm]) -> dict[str, list[Arm]]:
    """Arms by task, the paper's tasks first and in its order."""
    tasks: dict[str, list[Arm]] = {name: [] for name in paper.TASKS}
    for arm in arms:
        tasks.setdefault(arm.settings["task"], []).append(arm)
    return {name: some for name, some in tasks.items() if some}


def _lines(arms: Sequence[Arm], policy: str, conditioned: bool) -> list[tuple[str, dict[str, Arm]]]:
    """Our lines of Table I: a name, and an arm for each task."""
    lines = []
    groups: dict[str, list[Arm]] = {}
    for arm in arms:
        has_pose = arm.settings["conditioning"] not in ("none", NOT_SAID)
        if arm.settings["policy"] == policy and has_pose == conditioned:
            groups.setdefault(context(arm, "task", *_OF_TASK), []).append(arm)
    for some in groups.values():
        columns = by_task(sorted(some, key=lambda a: -(a.settings.get("steps") or 0)))
        for line in zip_longest(*columns.values()):
            by_name = {a.settings["task"]: a for a in line if a is not None}
            first = next(iter(by_name.values()))
            way = first.settings["conditioning"]
            words = [
                "foreign" if is_foreign_arm(first) else "ours",
                *([f"camera {way}"] if way == NOT_SAID else [way] if conditioned else []),
                first.label(*_OF_TASK),
                *_steps([*by_name.values()]),
            ]
            source = "\n".join(textwrap.fill(line, 30) for line in words)
            lines.append((source, by_name))
    return lines


def _steps(arms: Sequence[Arm]) -> list[str]:
    """The numbers of updates, where one is not the preset's."""
    if not any("steps" in arm.changes for arm in arms):
        return []
    counts = sorted({arm.settings["steps"] for arm in arms})
    return [f"{' or '.join(f'{count:,}' for count in counts)} updates"]


def _task(arm: Arm) -> str:
    """Task and scene; randomised is the usual one."""
    s = arm.settings
    return paper.task_title(s["task"]) + (", fixed" if s["scene"] == "fixed" else "")


def _paper_gain(arm: Arm) -> str:
    s = arm.settings
    if (value := paper_value(arm)) is None:
        return NONE
    return f"{value - (paper.success(s['policy'], s['task'], False) or 0.0):+.1f}"


def _rate_cell(arm: Arm | None, base: ImageOnlyArms) -> str:
    if arm is None or not arm.estimate.n:
        return NONE
    e, twin, gain = arm.estimate, base.of(arm), ""
    if twin and twin.is_twin and twin.arm.rows:
        delta = arm.against(twin.arm)
        gain = f" ({100 * delta.value:+.1f})" if delta.pairs else ""
    interval = f"[{100 * e.low:.1f}, {100 * e.high:.1f}]"
    return "\n".join([f"{100 * e.value:.1f}{gain}", interval, f"n = {arm.count()}", *e.of_seeds()])


def _rate(value: float, low: float, high: float) -> str:
    if math.isnan(value):
        return NONE
    return f"{100 * value:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def _difference(delta: PairedDifference) -> list[str]:
    if not delta.pairs:
        return [NONE, NONE, "0"]
    value, low, high = (100 * x for x in (delta.value, delta.low, delta.high))
    left_out = f" ({delta.unpaired} unpaired)" if delta.unpaired else ""
    lines = [f"{value:+.1f} [{low:+.1f}, {high:+.1f}]", *delta.of_seeds()]
    return ["\n".join(lines), p_text(delta.p_value),
            f"{delta.pairs}{left_out}"]  # fmt: skip


def _over(arm: Arm, other: ImageOnly | None) -> str:
    if other is None:
        return NONE
    words = _against(arm, other.arm)
    return words if other.is_twin or words == NONE else f"{words}\n{other.words}"


def _against(arm: Arm, other: Arm | None) -> str:
    if other is None or other is arm or not arm.rows or not other.rows:
        return NONE
    delta = arm.against(other)
    if not delta.pairs:
        return "no shared pairs"
    gain, p_value, _ = _difference(delta)
    first, *seeds = gain.split("\n")
    return "\n".join([f"{first}, p {p_value}", *seeds])


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4f}"
