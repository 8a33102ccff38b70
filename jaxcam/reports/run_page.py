"""One self-contained HTML page about a run, built from the files in its folder.

Videos lie beside the page; pictures are inside it.
"""

import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from jaxcam.config.sizes import rows_and_columns
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.paths import read_text
from jaxcam.files.whole import write_atomically
from jaxcam.reports import paper
from jaxcam.reports.html import Embedded, embedded, own_files, render
from jaxcam.reports.reading import training_seconds
from jaxcam.results.actions import ActionErrors
from jaxcam.results.rows import SEEN, Row
from jaxcam.results.stats import Estimate, by_field, causes, latest_rows, success_rate
from jaxcam.runs.action_errors import read_errors
from jaxcam.runs.foreign import has_foreign, read_foreign_record
from jaxcam.runs.identity import RECORDED, differences, plain, read_config, resolve
from jaxcam.runs.metrics import MetricsRow, read_metrics
from jaxcam.runs.rollouts import as_usual, read_run_rows

_PLOTS = {
    "success_map": "Each held-out camera by direction; the side panels bin one angle at a time.",
    "loss": "Loss on training batches (thin: logged values, thick: running mean) and on "
    "validation demonstrations.",
    "success": "Success over training; the band is the 95 % interval over pairs.",
    "cameras": "Camera poses of the demonstrations and of the evaluation.",
    "errors_by_horizon": "Errors of actions on what training did not see, by step of a chunk. The "
    "grey line is that of always giving the mean action, where actions are spread normally.",
    "errors_by_number": "The same by what is commanded, each in its own deviation.",
    "grip_ways": "Where the grip went in the steps of a chunk, and where the policy would have "
    "sent it, if --action-is says what actions mean.",
    "rays": "What the policy is told about its camera: a direction and a moment for each pixel.",
}
_WIDE = ("success_map", "cameras", "rays", "grip_ways")


def write_report(run_dir: str | Path) -> Path:
    """Write `report.html` into a run folder; parts whose files are missing are left out.

    Reads config.json, metrics.jsonl, eval/rows.jsonl, env.txt, plots/*.png, pictures/*.png,
    videos/*.mp4 and eval/*.mp4.

    Args:
        run_dir: Folder of the run.

    Returns:
        Path of the page.

    Raises:
        ConfigError: The folder is not of a run.
    """
    run = Path(run_dir)
    if not ((run / "config.json").is_file() or has_foreign(run)):
        raise ConfigError(f"{run} is not the folder of a run: it has no config.json.")
    # Rows of validation pairs serve to choose settings; they are no result.
    own = read_foreign_record(run) if has_foreign(run) else read_config(run)
    # Rows of other conditions are for reports, which set them side by side.
    of_all = as_usual(latest_rows(read_run_rows(run)), own)
    rows = [row for row in of_all if row.split == "test"]
    newest = max((row.step for row in rows), default=0)
    shown = [row for row in rows if row.step == newest]
    about = _about_foreign(run, shown) if has_foreign(run) else _about(run_dir, shown, newest)
    content = render(
        "run.html",
        estimate=success_rate(shown) if about.evaluated else None,
        errors=error_lines(read_errors(run)),
        causes=causes(shown),
        plots=_figures(run / "plots"),
        videos=_videos(run),
        pictures=_figures(run / "pictures"),
        rollouts=_rollouts(shown),
        checkpoints=_checkpoints(rows),
        environment=_environment(run / "env.txt"),
        title=about.title,
        subtitle=about.subtitle,
        facts=about.facts | _memory([row for row in of_all if row.split == SEEN]),
        commands=[[shlex.quote(word) for word in line] for line in about.commands],
        settings=about.settings,
    )
    write_atomically(run / "report.html", content)
    return run / "report.html"


@dataclass(frozen=True)
class _About:
    """What a page says of whom it is about."""

    title: str
    subtitle: str
    facts: dict[str, Any]
    commands: list[list[str]]
    settings: dict[str, str]
    evaluated: bool = True


def _about(run_dir: str | Path, shown: Sequence[Row], newest: int) -> _About:
    """Of a run."""
    config, metrics = read_config(Path(run_dir)), read_metrics(Path(run_dir))
    return _About(
        f"{paper.policy_title(config.policy, short=False)} on {_subject(config)}",
        f"Conditioning: {config.conditioning}. Preset: {config.preset}. Seed: {config.seed}.",
        _facts(config, metrics, shown, newest),
        _commands(run_dir, config),
        {name: plain(value) for name, value in asdict(config).items()},
        evaluated=config.task != RECORDED,
    )


def _about_foreign(run: Path, shown: Sequence[Row]) -> _About:
    """Of somebody else's policy."""
    record = read_foreign_record(run)
    known = (("Policy", record.name), ("At", record.address), ("Conditioning", record.conditioning))
    facts = {
        **dict(known),
        "Views": record.views,
        "Action space": record.action_space,
        "Pictures": _pixels(record.resolution),
        "Steps executed": record.execute or "all of a chunk",
        **_lengths(shown),
    }
    again = [
        "python", "-m", "jaxcam.evaluate", "--policy", record.address, "--task", record.task,
        "--scene", record.scene, "--views", str(record.views), "--name", record.name,
        "--obs", str(run / "obs.yaml"), "--run-dir", str(run),
    ]  # fmt: skip
    return _About(
        f"{record.name} on {record.task}, {record.scene} scene",
        "A policy that was not trained here, on the pairs that ours are evaluated on.",
        facts,
        [again],
        {name: plain(value) for name, value in asdict(record).items()},
    )


def reproduce_command(config: TrainConfig) -> str:
    """The shortest command line that trains with these settings on any machine.

    Args:
        config: Resolved settings of a run.

    Returns:
        The command, as a shell reads it.
    """
    named = ("task", "scene", "policy", "preset", "conditioning", "seed")
    identity = {name: getattr(config, name) for name in named}
    # The preset's calls are longer where there is an accelerator; the run says where it was.
    usual = resolve(TrainConfig(**identity), accelerator=config.steps_per_call > 1)
    changed = {d.field: d.new for d in differences(usual, config) if d.field not in identity}
    words = ["python", "-m", "jaxcam.train"]
    for name, value in (identity | changed).items():
        values = value if isinstance(value, tuple) else (value,)
        words += ["--" + name.replace("_", "-"), *map(str, values)]
    return shlex.join(words)


def _facts(
    config: TrainConfig, metrics: Sequence[MetricsRow], rows: Sequence[Row], step: int
) -> dict[str, Any]:
    """What stands beside the success rate."""
    trained = int(max((row.get("step", 0) for row in metrics), default=0))
    facts = {
        "Learned from": _subject(config),
        "Policy": config.policy,
        "Conditioning": config.conditioning,
        "Views": config.views,
        "Action space": config.action_space,
        "Pictures": _pixels(config.resolution),
        "Demonstrations": config.demos,
        "Training steps": f"{trained:,} of {config.steps:,}",
    }
    if seconds := training_seconds(metrics):
        facts["Wall time"] = _duration(seconds)
    if rows:
        facts["Evaluated checkpoint"] = f"step {step:,}"
    return facts | _lengths(rows)


def _memory(rows: Sequence[Row]) -> dict[str, str]:
    """Success on cameras that training saw, apart from that on held-out ones."""
    newest = max((row.step for row in rows), default=0)
    if not rows:
        return {}
    rate = success_rate([row for row in rows if row.step == newest])
    return {"On cameras that training saw": f"{rate} at step {newest:,}: memory, no result"}


def _pixels(resolution: int | str) -> str:
    return f"{' × '.join(map(str, rows_and_columns(resolution)))} pixels"


def _lengths(rows: Sequence[Row]) -> dict[str, str]:
    """How long successes took, if there are any."""
    lengths = [row.steps or 0 for row in rows if row.finished and row.success]
    if not lengths:
        return {}
    return {"Steps to success": f"{sum(lengths) / len(lengths):.0f} on average"}


def _subject(config: TrainConfig) -> str:
    """What a run learned, in words."""
    if config.task == RECORDED:
        return f"the recorded dataset {Path(config.dataset).name}"
    return f"{config.task}, {config.scene} scene"


def error_lines(rows: Sequence[ActionErrors]) -> list[tuple[str, str, str, int]]:
    """Errors of actions in words, a line for each group of the newest checkpoint.

    Args:
        rows: Of a run.

    Returns:
        On which episodes, told which poses, the error in deviations with its interval, and how many
        episodes.
    """
    newest = max((row.step for row in rows), default=0)
    lines = []
    for row in rows:
        if row.step == newest:
            value, low, high = row.mean()
            span = f" [{low:.2f}, {high:.2f}]" if low == low else ""
            off = f"{row.rotation_deg:g}°, {100 * row.translation:g} cm off"
            poses = off if row.rotation_deg or row.translation else "as calibrated"
            lines.append((row.group, poses, f"{value:.2f}{span}", len(row.errors)))
    return lines


def _figures(folder: Path) -> list[Embedded]:
    """All PNG files of a folder of a run, those we know first, without links out of the run."""
    known = list(_PLOTS)
    files = sorted(
        own_files(folder, "*.png"),
        key=lambda f: (known.index(f.stem) if f.stem in _PLOTS else len(known), f.name),
    )
    return [
        embedded(
            file,
            _PLOTS.get(file.stem, file.stem.replace("_", " ").capitalize()),
            wide=file.stem in _WIDE or len(files) == 1,
        )
        for file in files
    ]


def _videos(run: Path) -> list[str]:
    """Videos, which stay files of their own, relative to the page."""
    files = sorted(file for name in ("videos", "eval") for file in own_files(run / name, "*.mp4"))
    return [file.relative_to(run).as_posix() for file in files]


def _rollouts(rows: Sequence[Row]) -> list[tuple[str | int, ...]]:
    """A line for each rollout."""
    return [
        (
            row.pair, "" if row.seed is None else row.seed, _outcome(row),
            "" if row.steps is None else row.steps, _degrees(row.azimuth_deg),
            _degrees(row.elevation_deg),
            "" if row.distance is None else f"{row.distance:.2f} m",
        )
        for row in sorted(rows, key=lambda row: (row.pair, row.seed or 0))
    ]  # fmt: skip


def _outcome(row: Row) -> str:
    """How a rollout ended, in words."""
    if not row.finished:
        return "did not finish"
    if row.status == "policy":
        return f"failure: {row.cause or 'no actions'}"
    return "success" if row.success else "failure"


def _checkpoints(rows: Sequence[Row]) -> list[tuple[str, Estimate]]:
    """Success by checkpoint, where more than one was evaluated."""
    by_step = by_field(rows, "step")
    if len(by_step) < 2:
        return []
    return [(f"{step:,}", success_rate(by_step[step])) for step in sorted(by_step)]


def _commands(run_dir: str | Path, config: TrainConfig) -> list[list[str]]:
    """How to train and evaluate again, word by word; evaluating writes this page anew."""
    evaluate = ["python", "-m", "jaxcam.evaluate", str(run_dir), "--pairs", "200"]
    train = shlex.split(reproduce_command(config))
    return [train] if config.task == RECORDED else [train, evaluate]


def _environment(file: Path) -> str:
    """Versions and devices."""
    own = own_files(file.parent, file.name)
    return read_text(own[0], "replace").strip() if own else ""


def _degrees(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}°"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s"
