"""`python -m jaxcam.report RUNS…`: many runs beside the paper, as Markdown, LaTeX, CSV and HTML.

Success rates come with intervals and the number of rollouts; comparisons are paired. The folder
that is written holds the rows too, so it can be read, copied and reported on again.
"""

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from jaxcam.config.commands import ReportConfig
from jaxcam.console.words import plain_line
from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.files.whole import check_free, write_atomically
from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, Run, context, group
from jaxcam.reports.axes.fovy import fovy_blocks
from jaxcam.reports.axes.pose_errors import pose_error_blocks
from jaxcam.reports.axes.scaling import scaling_blocks
from jaxcam.reports.camera_figures import rate_by_camera
from jaxcam.reports.document import (
    Block,
    Document,
    Heading,
    Link,
    Picture,
    Table,
    Text,
    to_html,
    to_latex,
    to_markdown,
)
from jaxcam.reports.html import own_files
from jaxcam.reports.names import file_name
from jaxcam.reports.packs.folder import check_replaces, write_results
from jaxcam.reports.packs.manifest import PackLabel
from jaxcam.reports.packs.pack import is_pack, write_pack
from jaxcam.reports.packs.page import write_leaderboard
from jaxcam.reports.reading import read_packs, read_runs
from jaxcam.reports.run_page import error_lines
from jaxcam.reports.studies import STUDIES, arm_names, arms_of, panels, place
from jaxcam.reports.study_figures import bars, curves, maps, rates_and_gains
from jaxcam.reports.style import save
from jaxcam.reports.tables import (
    by_task,
    cells,
    foreign_table,
    gains_table,
    is_of_table,
    runs_table,
    seen_table,
    table_one,
    to_csv,
    twins_of,
    without_twins,
)
from jaxcam.results.protocol import protocol_of
from jaxcam.results.rows import SEEN
from jaxcam.runs.action_errors import read_errors
from jaxcam.runs.identity import RECORDED

WRITTEN = ("report.md", "report.tex", "report.csv", "rows.jsonl", "runs.json", "figures")
"""What is written beside the page."""


def write_comparison(
    runs: Sequence[Run], out: Path, split: str = "test", memory: Sequence[Run] = ()
) -> Path:
    """Write a report of many runs.

    Args:
        runs: From `read_runs`.
        out: Folder for report.html, report.md, report.tex, report.csv, figures/*.png, and the rows.
        split: Which pairs the rows are of.
        memory: The same runs with their rows on cameras that training saw, which have a table of
            their own.

    Returns:
        Path of the page.

    Raises:
        ConfigError: The folder has rows that would be lost.
    """
    both = [*runs, *memory]
    check_replaces(out, both)
    title = "Camera-conditioned policies: this code beside the paper"
    page = out / "report.html"
    if not page.exists():  # so that the folder is known as ours, whatever ends this
        begun = "The command that writes this report has not finished. Run it again."
        write_atomically(page, to_html(Document(title, begun, []), out))
    arms = [arm for arm in group(runs) if arm.estimate.n or arm.estimate.excluded]
    blocks = [
        *_about(arms),
        *_main(arms, out),
        *_memory(arms, group(memory)),
        *_studies(arms, out),
        *pose_error_blocks(arms, out),
        *fovy_blocks(arms, out),
        *scaling_blocks(arms, out),
        *_maps(arms, out),
    ]
    blocks += [*_recorded(runs), Heading("Runs"), runs_table(runs, _videos(runs, out))]
    pairs = "held-out pairs" if split == "test" else f"{split} pairs"
    subtitle = f"Success on {pairs} of an initial state and a camera pose."
    document = Document(title, subtitle, blocks)
    write_atomically(out / "report.md", to_markdown(document))
    write_atomically(out / "report.tex", to_latex(document))
    write_atomically(out / "report.csv", to_csv(arms))
    write_results(out, both)
    write_atomically(page, to_html(document, out))
    return page


def _about(arms: Sequence[Arm]) -> list[Block]:
    """What the numbers are, and which of them are not whole."""
    asked = protocol_of("act")
    blocks: list[Block] = [
        Text(
            "The paper's protocol is seeds × last checkpoints × held-out pairs: "
            f"{asked} rollouts for each setting ({protocol_of('smolvla').rollouts} for SmolVLA). "
            "Its figures give no numbers, so only Table I can stand beside ours."
        )
    ]
    lacking = [arm for arm in arms if arm.lacks]
    if lacking:
        kinds = sorted({what for arm in lacking for what in arm.lacks})
        blocks.append(
            Text(
                f"{len(lacking)} of {len(arms)} settings have fewer rollouts than the protocol asks"
                f" for ({'; '.join(kinds)}). Each number stands with its own rollouts.",
                warns=True,
            )
        )
    if excluded := sum(arm.estimate.excluded for arm in arms):
        blocks.append(
            Text(
                f"Rollouts that did not finish and count in no rate: {excluded}.",
                warns=True,
            )
        )
    if broken := sum(arm.estimate.broken for arm in arms):
        words = f"Rollouts in which the policy gave no actions, which count as failures: {broken}."
        blocks.append(Text(words, warns=True))
    return blocks


def _main(arms: Sequence[Arm], out: Path) -> list[Block]:
    """Table I and the paired differences, with a picture for each task."""
    blocks: list[Block] = [Heading("With and without the camera pose"), table_one(arms)]
    if table := gains_table(arms):
        blocks += [Heading("Paired differences"), table]
    blocks += [Text(sentence, warns=True) for sentence in without_twins(arms)]
    if table := foreign_table(arms):
        blocks += [Heading("Policies of others"), table]
    twins = [(a, b.arm) for a, b in twins_of(arms) if b.is_twin and is_of_table(a)]
    if twins:
        path = save(rates_and_gains(twins), out / "figures" / "gains.png")
        caption = (
            "Grey: the twin, image only. Hollow points: fewer rollouts than the protocol asks for. "
            "Diamonds: the paper. n: rollouts with and without the camera pose."
        )
        blocks.append(Picture(_relative(path, out), caption))
    return blocks


def _memory(arms: Sequence[Arm], memory: Sequence[Arm]) -> list[Block]:
    """Success on cameras that training saw, beside that on held-out ones."""
    table = seen_table(arms, memory)
    return [Heading("Memory and generalisation"), table] if table else []


def _studies(arms: Sequence[Arm], out: Path) -> list[Block]:
    """The paper's figures for which there are rows."""
    blocks: list[Block] = []
    for study in STUDIES:
        shown = panels(study, arms)
        if not shown:
            continue
        of_study = arms_of(shown)
        named = arm_names(study, of_study)
        figure = curves(shown, "cameras") if study.field == "n" else bars(shown, named)
        path = save(figure, out / "figures" / f"{study.file}.png")
        finding = paper.SAYS.get(study.field)
        caption = f"{study.title}. The paper's finding: {finding}" if finding else study.title
        blocks += [Heading(study.title), Picture(_relative(path, out), caption),
                   cells(of_study, study.field, named)]  # fmt: skip
    return blocks


def _maps(arms: Sequence[Arm], out: Path) -> list[Block]:
    """Where on the sphere of cameras each policy works."""
    blocks: list[Block] = []
    mapped = [a for a in arms if len(rate_by_camera(a.rows))]
    for name, some in _by_conditioning(mapped).items():
        path = save(maps(some), out / "figures" / f"map-{name}.png")
        blocks.append(Picture(_relative(path, out), f"Success by camera: {_caption(some[0])}"))
    return [Heading("Success by camera direction"), *blocks] if blocks else []


def _recorded(runs: Sequence[Run]) -> list[Block]:
    """Errors of actions of the runs that learned from recorded data, which nobody can roll out."""
    rows = [
        [run.name, group, poses, error, str(count)]
        for run in runs
        if run.folder and run.settings["task"] == RECORDED
        for group, poses, error, count in error_lines(read_errors(run.folder))
    ]
    if not rows:
        return []
    caption = "Errors of actions on what training did not see, in deviations of the actions"
    head = ("Run", "On", "Told poses", "Error", "Episodes")
    return [Heading("Recorded data"), Table(caption, head, rows)]


def _by_conditioning(arms: Sequence[Arm]) -> dict[str, list[Arm]]:
    """The arms of Table I that differ in their conditioning only, by a name for files."""
    groups: dict[str, list[Arm]] = defaultdict(list)
    for some in by_task(a for a in arms if paper.is_table_setting(a.settings)).values():
        for arm in some:
            groups[context(arm, "conditioning")].append(arm)
    named: dict[str, list[Arm]] = {}
    for some in groups.values():
        some = sorted(some, key=lambda a: -place(a))
        s = some[0].settings
        name = file_name(f"{s['task']}-{s['policy']}")
        count = sum(known.startswith(name) for known in named)
        named[f"{name}-{count + 1}" if count else name] = some
    return named


def _caption(arm: Arm) -> str:
    s = arm.settings
    policy, task = paper.policy_title(s["policy"]), paper.task_title(s["task"])
    return f"{policy} on {task}, {s['scene']} scene, {arm.label('conditioning')}."


def _videos(runs: Sequence[Run], out: Path) -> Mapping[str, list[Link]]:
    """Links to the videos of failures, which stay in the runs' folders, by where a run is from."""
    links: dict[str, list[Link]] = {}
    for run in runs:
        files = own_files(run.folder / "videos", "failures-*.mp4")[::-1] if run.folder else []
        links[run.source] = [Link(file.name, _relative(file, out)) for file in files]
    return links


def _relative(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file, folder)).as_posix()


def _check_out(out: Path) -> None:
    """Refuses a folder that has files of ours' names which we did not write."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out} is there, and is no folder. Choose another --out.")
    if is_pack(out):
        raise ConfigError(f"{out} is a result pack, which would be spoilt. Choose another --out.")
    page = out / "report.html"
    check_free(page)
    rows = all((out / name).exists() for name in ("runs.json", "rows.jsonl"))
    ours = page.exists() or rows  # whose rows these are is looked at before they are replaced
    if ours and not (out / "config.json").exists():
        return  # a report of ours, with all that is beside it
    if there := [name for name in (*WRITTEN, "config.json") if (out / name).exists()]:
        raise ConfigError(
            f"{out} has {', '.join(there)}, but is no report of ours. Choose another --out."
        )


def main(config: ReportConfig, console: Console) -> None:
    """Runs the command."""
    if not config.runs:
        raise ConfigError("No runs are named. Give the folders of runs, or of reports.")
    if config.leaderboard:
        return _leaderboard(config, console)
    out = absolute(config.pack or config.out)
    if not config.pack:
        _check_out(out)
    runs = read_runs(config.runs, config.split)
    if config.pack:
        about = PackLabel(config.pack_name or out.name, config.authors, config.link)
        pack = write_pack(out, runs, config.split, about)
        written = f"Pack: {out} ({pack.manifest.digest[:8]})"
    else:
        memory = read_runs(config.runs, SEEN) if config.split == "test" else []
        memory = [run for run in memory if run.rows]
        written = f"Report: {write_comparison(runs, out, config.split, memory)}"
    for arm in group(run for run in runs if run.rows or not config.pack):
        console.print(plain_line(_in_words(arm)), soft_wrap=True)
    console.print(written, soft_wrap=True)


def _in_words(arm: Arm) -> str:
    """An arm and its success; runs on recorded data have none."""
    settings = arm.settings
    is_recorded = settings["task"] == RECORDED
    words = ("policy", "task", *(() if is_recorded else ("scene",)), "conditioning")
    name = " ".join(str(settings[k]) for k in words)
    if is_recorded:
        return f"{name}, {arm.label()}: errors of its actions are in the report"
    whole = f" [{', '.join(arm.lacks)}]" if arm.lacks else ""
    return f"{name}, {arm.label()}: {arm.estimate}{whole}"


def _leaderboard(config: ReportConfig, console: Console) -> None:
    page = absolute(config.leaderboard)
    packs = read_packs(config.runs)
    count = write_leaderboard(page, packs, config.split)
    console.print(f"Leaderboard: {page} ({count} settings of {len(packs)} packs)", soft_wrap=True)
