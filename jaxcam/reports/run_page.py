"""One self-contained HTML page about a run, built from the files in its folder.

Videos lie beside the page; pictures are inside it.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

from jaxcam.config.fields import from_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.jsonl import read_jsonl, write_atomically
from jaxcam.reports import html as page
from jaxcam.reports.arms import training_seconds
from jaxcam.reports.html import section
from jaxcam.results.stats import Estimate, Row, by_field, is_finished, latest_rows, success_rate
from jaxcam.runs.identity import differences, plain, resolve

_PLOTS = {
    "success_map": "Each held-out camera by direction; the side panels bin one angle at a time.",
    "loss": "Loss on training batches (thin: logged values, thick: running mean) and on "
    "validation demonstrations.",
    "success": "Success over training; the band is the 95 % interval over pairs.",
    "cameras": "Camera poses of the demonstrations and of the evaluation.",
    "rays": "What the policy is told about its camera: a direction and a moment for each pixel.",
}
_POLICIES = {"act": "ACT", "diffusion": "Diffusion Policy", "smolvla": "SmolVLA"}
_WIDE = ("success_map", "cameras", "rays")


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
    if not (run / "config.json").is_file():
        raise ConfigError(f"{run} is not the folder of a run: it has no config.json.")
    config = from_json(TrainConfig, (run / "config.json").read_text("utf-8"))
    metrics = read_jsonl(run / "metrics.jsonl")
    rows = [r for r in latest_rows(read_jsonl(run / "eval" / "rows.jsonl")) if _is_held_out(r)]
    newest = max((row.get("step") or 0 for row in rows), default=0)
    shown = [row for row in rows if (row.get("step") or 0) == newest]
    sections = (
        _summary(config, metrics, shown, newest),
        section("Results", _figures(run / "plots")),
        section("Rollouts", _videos(run)),
        section("What the policy sees", _figures(run / "pictures")),
        section("Each rollout", _rollouts(shown)),
        section("Success of each checkpoint", _checkpoints(rows)),
        section("Run it again", _commands(run_dir, config)),
        section("Configuration", _settings(asdict(config))),
        section("Environment", _environment(run / "env.txt")),
    )
    title = f"{_POLICIES.get(config.policy, config.policy)} on {config.task}, {config.scene} scene"
    subtitle = f"Conditioning: {config.conditioning}. Preset: {config.preset}. Seed: {config.seed}."
    write_atomically(run / "report.html", page.page(title, subtitle, sections))
    return run / "report.html"


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


def _summary(config: TrainConfig, metrics: Sequence[Row], rows: Sequence[Row], step: int) -> str:
    """The success rate, large, beside the facts of the run."""
    estimate = success_rate(rows)
    trained = int(max((row.get("step", 0) for row in metrics), default=0))
    lengths = [row["steps"] for row in rows if is_finished(row) and row["success"]]
    facts = {
        "Task": config.task,
        "Scene": config.scene,
        "Policy": config.policy,
        "Conditioning": config.conditioning,
        "Views": config.views,
        "Action space": config.action_space,
        "Demonstrations": config.demos,
        "Training steps": f"{trained:,} of {config.steps:,}",
    }
    if seconds := training_seconds(metrics):
        facts["Wall time"] = _duration(seconds)
    if rows:
        facts["Evaluated checkpoint"] = f"step {step:,}"
    if lengths:
        facts["Steps to success"] = f"{sum(lengths) / len(lengths):.0f} on average"
    listed = "".join(f"<div><dt>{k}</dt><dd>{escape(str(v))}</dd></div>" for k, v in facts.items())
    notice = ""
    if estimate.excluded:
        what = "rollout" if estimate.excluded == 1 else "rollouts"
        notice = page.notice(
            f"{estimate.excluded} {what} did not finish and count in no rate on this page."
        )
    return (
        f'<div class="summary">{page.card(_headline(estimate))}'
        f"{page.card(f'<dl>{listed}</dl>')}</div>{notice}"
    )


def _headline(estimate: Estimate) -> str:
    """A rate with its interval, in words and as a bar."""
    if not estimate.n:
        return '<div class="rate">–</div><p class="small">Not evaluated yet.</p>'
    value, low, high = (100 * x for x in (estimate.value, estimate.low, estimate.high))
    repeats = "" if estimate.n == estimate.clusters else f"{estimate.n} rollouts on "
    return (
        f'<div class="rate">{value:.1f} %</div>'
        f'<div class="scale"><i style="left:{low:.1f}%;width:{high - low:.1f}%"></i>'
        f'<b style="left:{value:.1f}%"></b></div>'
        '<div class="ends"><span>0 %</span><span>success</span><span>100 %</span></div>'
        f'<p class="small">95 % interval {low:.1f} to {high:.1f} %, {repeats}n = '
        f"{estimate.clusters} pairs of an initial state and a camera pose that training never "
        "saw.</p>"
    )


def _figures(folder: Path) -> str:
    """All PNG files of a folder, those we know first."""
    known = list(_PLOTS)
    files = sorted(
        folder.glob("*.png"),
        key=lambda f: (known.index(f.stem) if f.stem in _PLOTS else len(known), f.name),
    )
    return page.pictures(
        page.picture(
            file,
            _PLOTS.get(file.stem, file.stem.replace("_", " ").capitalize()),
            wide=file.stem in _WIDE or len(files) == 1,
        )
        for file in files
    )


def _videos(run: Path) -> str:
    """Players for the videos, which stay files of their own."""
    files = sorted(file for name in ("videos", "eval") for file in (run / name).glob("*.mp4"))
    names = (file.relative_to(run).as_posix() for file in files)
    hint = "a tile’s border turns blue when the rollout succeeds, vermilion when it fails."
    return "\n".join(page.video(name, f"{name}: {hint}") for name in names)


def _rollouts(rows: Sequence[Row]) -> str:
    """Each rollout in a table that is folded away."""
    if not rows:
        return ""
    outcome = {True: "success", False: "failure"}
    body = [
        (
            row["pair"], row.get("seed", ""),
            outcome[bool(row["success"])] if is_finished(row) else "did not finish",
            row.get("steps", ""), _degrees(row.get("azimuth_deg")),
            _degrees(row.get("elevation_deg")),
            "" if row.get("distance") is None else f"{row['distance']:.2f} m",
        )
        for row in sorted(rows, key=lambda row: (row["pair"], row.get("seed") or 0))
    ]  # fmt: skip
    head = ("pair", "seed", "outcome", "steps", "azimuth", "elevation", "distance")
    return page.folded(f"{len(body)} rollouts", page.table(head, body))


def _checkpoints(rows: Sequence[Row]) -> str:
    """Success by checkpoint, where more than one was evaluated."""
    by_step = by_field(rows, "step")
    if len(by_step) < 2:
        return ""
    body = [(f"{step or 0:,}", success_rate(by_step[step])) for step in sorted(by_step)]
    return page.card(page.table(("step", "success"), body))


def _commands(run_dir: str | Path, config: TrainConfig) -> str:
    """How to train and evaluate again; evaluating writes this page anew."""
    folder = shlex.quote(str(run_dir))
    lines = (
        reproduce_command(config),
        f"python -m jaxcam.evaluate {folder} --pairs 200",
    )
    # Whole words, so that a browser does not break a line inside a flag.
    shown = [
        " ".join(f"<span>{escape(shlex.quote(word))}</span>" for word in shlex.split(line))
        for line in lines
    ]
    return page.card("".join(f"<pre>{line}</pre>" for line in shown))


def _settings(values: Mapping[str, Any]) -> str:
    """All settings, in two columns where there is room."""
    pairs = "".join(
        f"<div><span>{escape(name)}</span><code>{escape(plain(value))}</code></div>"
        for name, value in values.items()
    )
    return f'<div class="card settings">{pairs}</div>'


def _environment(file: Path) -> str:
    """Versions and devices, folded away."""
    if not file.is_file():
        return ""
    text = escape(file.read_text("utf-8").strip())
    return page.folded("Versions and devices", f"<pre>{text}</pre>")


def _is_held_out(row: Row) -> bool:
    """Rows of validation pairs serve to choose settings; they are no result."""
    return row.get("split", "test") == "test"


def _degrees(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}°"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s"
