"""The report of trials: rates with intervals, paired differences, stacked bars; and who was who."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxcam.files.whole import check_free, write_atomically
from jaxcam.reports.document import Block, Document, Heading, Picture, Table, Text, to_html
from jaxcam.reports.style import save
from jaxcam.results.differences import paired_difference
from jaxcam.results.stats import Estimate, p_text, success_rate
from jaxcam.robot.trials.figures import Bar, stacked_bars
from jaxcam.robot.trials.order import Rollout, letters
from jaxcam.robot.trials.rows import Threshold, TrialRow, as_rows, done, shared
from jaxcam.robot.trials.sheet import Sheet

PAGE, FIGURE = "report.html", "figures/outcomes.png"
_THRESHOLDS: tuple[tuple[Threshold, str], ...] = (("whole", "success"), ("half", "at least half"))


@dataclass(frozen=True)
class Trial:
    """What there is of a trial.

    Attributes:
        sheet: What is tried.
        folder: Of its rows.
        planned: Its rollouts, in order.
        rows: Those that were rated, as they were written.
    """

    sheet: Sheet
    folder: Path
    planned: Sequence[Rollout]
    rows: Sequence[TrialRow]


def write_trials(trials: Sequence[Trial], out: Path) -> Path:
    """Write one page on one trial or several.

    Args:
        trials: What there is of them.
        out: Folder for the page and its figure.

    Returns:
        Path of the page.

    Raises:
        ConfigError: Something else has its place.
    """
    page = out / PAGE
    check_free(page)
    out.mkdir(parents=True, exist_ok=True)
    save(stacked_bars([(trial.sheet.task, _bars(trial)) for trial in trials]), out / FIGURE)
    blocks: list[Block] = [
        Picture(FIGURE, "Success and half-success. Whiskers are 95 % intervals, of success at the "
                "left, of at least half a success at the right; numbers are rollouts."),
        *itertools.chain.from_iterable(map(_about, trials)),
    ]  # fmt: skip
    tasks = ", ".join(trial.sheet.task for trial in trials)
    document = Document(f"Trials on a robot: {tasks}", _subtitle(trials), blocks)
    write_atomically(page, to_html(document, out))
    return page


def _subtitle(trials: Sequence[Trial]) -> str:
    rated = sum(len(done(trial.rows)) for trial in trials)
    return f"{rated} rollouts, rated by an operator who did not know which policy ran."


def _estimates(trial: Trial, policy: int) -> list[Estimate]:
    rated = done(trial.rows)
    return [
        success_rate(as_rows(trial.sheet, trial.planned, rated, policy, threshold))
        for threshold, _ in _THRESHOLDS
    ]


def _bars(trial: Trial) -> list[Bar]:
    return [
        Bar(entry.name, *_estimates(trial, policy))
        for policy, entry in enumerate(trial.sheet.policies)
    ]


def _about(trial: Trial) -> Iterator[Block]:
    """All that is said of one trial."""
    sheet, rated = trial.sheet, done(trial.rows)
    yield Heading(sheet.task)
    yield Text(f"Success: {sheet.success} Half: {sheet.half}")
    if missing := len(trial.planned) - len(rated):
        yield Text(
            f"{missing} of {len(trial.planned)} rollouts are missing. Who has read this page knows "
            "which letter is which policy: have somebody else rate the rest.",
            warns=True,
        )
    yield _rates(trial)
    if len(sheet.policies) > 1:
        yield _differences(trial)
    yield Text(_clusters(sheet))
    yield _each_condition(trial)
    yield _each_rollout(trial)


def _rates(trial: Trial) -> Table:
    names = letters(trial.sheet)
    lines = []
    for policy, entry in enumerate(trial.sheet.policies):
        whole, half = _estimates(trial, policy)
        lines.append([entry.name, names[policy], str(whole.n), _rate(whole), _rate(half)])
    head = ("policy", "was called", "rollouts", "success", "at least half")
    return Table("Rates with 95 % intervals.", head, lines)


def _rate(estimate: Estimate) -> str:
    if not estimate.n:
        return "–"
    value, low, high = (100 * x for x in (estimate.value, estimate.low, estimate.high))
    return f"{value:.0f} % [{low:.0f}, {high:.0f}]"


def _differences(trial: Trial) -> Table:
    """Each policy minus each that comes after it in the sheet."""
    sheet, planned = trial.sheet, trial.planned
    both = shared(planned, done(trial.rows))
    lines = []
    for first, second in itertools.combinations(range(len(sheet.policies)), 2):
        for threshold, words in _THRESHOLDS:
            a, b = (as_rows(sheet, planned, both, i, threshold) for i in (first, second))
            difference = paired_difference(a, b)
            value, low, high = (
                100 * x for x in (difference.value, difference.low, difference.high)
            )
            names = f"{sheet.policies[first].name} − {sheet.policies[second].name}"
            points = f"{value:+.0f} [{low:+.0f}, {high:+.0f}]" if a else "–"
            p_value = p_text(difference.p_value).removeprefix("= ") if a else "–"
            lines.append([names, words, points, p_value, str(len(a))])
    caption = "Paired differences in points, on the conditions that every policy has met."
    return Table(caption, ("policies", "of", "difference", "p", "conditions"), lines)


def _clusters(sheet: Sheet) -> str:
    if len(sheet.placements) > 1:
        what = "placements of the cameras: those of one placement share its poses"
    else:
        what = "starts"
    return (
        f"Rollouts are clustered by {what}. Intervals of rates resample clusters (and allow for "
        "kinds that so few can have missed); those of differences are Student's over clusters. "
        "They speak of new clusters of the same kind, not of new trainings of the policies."
    )


def _each_condition(trial: Trial) -> Table:
    """What became of each condition, policy by policy."""
    sheet, rated = trial.sheet, done(trial.rows)
    lines = []
    for _, group in itertools.groupby(trial.planned, lambda r: r.condition.number):
        some = list(group)
        condition = some[0].condition
        outcomes = {r.policy: rated[r.number].outcome for r in some if r.number in rated}
        lines.append([
            condition.placement or "–",
            ", ".join(condition.cameras) or "–",
            f"{condition.start + 1}: {sheet.starts[condition.start]}",
            *(outcomes.get(policy, "–") for policy in range(len(sheet.policies))),
        ])  # fmt: skip
    head = ("placement", "cameras", "start", *(policy.name for policy in sheet.policies))
    return Table("Each condition", head, lines, folded=True)


def _each_rollout(trial: Trial) -> Table:
    """All that was written down, in the order in which it was, what does not count as well."""
    lines = []
    for row in trial.rows:
        name = trial.sheet.policies[trial.planned[row.number - 1].policy].name
        remarks = "\n".join(filter(None, (row.comment, row.fault, row.lateness)))
        lines.append([str(row.number), name, row.outcome, f"{row.seconds:.1f}", row.time, remarks])
    head = ("rollout", "policy", "outcome", "seconds", "rated", "remarks")
    return Table("Each rollout, with comments", head, lines, folded=True)
