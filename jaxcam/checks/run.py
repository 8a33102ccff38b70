"""Whether a run folder is whole, and what can still be done with it."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from jaxcam.checks.findings import Finding, some
from jaxcam.config.fields import from_json
from jaxcam.config.train import TrainConfig
from jaxcam.console.progress import progress
from jaxcam.data.collection import dataset_path
from jaxcam.data.demos import read_demos
from jaxcam.errors import JaxcamError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.pipeline import collect_config
from jaxcam.results.stats import USUAL, Row, is_finished, latest_rows
from jaxcam.runs.environment import environment
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.digests import DamagedError, read_all
from jaxcam.training.side import CONVENTION

LEAST_GOOD = 0.9
"""Share of updates that must have been finite."""
Sides = dict[int, Mapping[str, Any]]
"""What was saved beside the arrays of each whole checkpoint, by its step."""


def check_run(folder: Path, console: Console | None = None) -> Iterator[Finding]:
    """Looks at everything in a run folder and changes nothing.

    Args:
        folder: of the run.
        console: for progress; silent when None.
    """
    try:
        config = from_json(TrainConfig, (folder / "config.json").read_text("utf-8"))
    except (JaxcamError, OSError, UnicodeDecodeError) as error:
        yield Finding(
            "configuration",
            "bad",
            str(error),
            where="config.json",
            fix="Checkpoints hold a copy: python -m jaxcam.evaluate still works. To go "
            "on training, restore the file.",
        )
        return
    said = f"{config.policy} on {config.task}, {config.scene}; {config.conditioning}, seed "
    yield Finding("configuration", "good", f"{said}{config.seed}")
    whole: Sides = {}
    yield from _checkpoints(folder, whole, console)
    yield _dataset(folder, config, whole)
    yield _metrics(folder)
    yield from _evaluations(folder, config.pairs)
    yield _environment(folder)
    yield _what_next(folder, config, sorted(whole))


def _checkpoints(folder: Path, whole: Sides, console: Console | None) -> Iterator[Finding]:
    """Reads every array of every checkpoint and compares its hash; fills `whole`."""
    steps, what = checkpoint_steps(folder), "checkpoints"
    damaged: dict[int, str] = {}
    with progress(console, "verifying", len(steps)) as advance:
        for step in steps:
            try:
                manifest, _ = read_all(folder / "checkpoints" / str(step))
                whole[step] = manifest["side"]
            except DamagedError as error:
                damaged[step] = str(error)
            advance()
    if not steps:
        yield Finding(what, "note", "none yet")
    elif not damaged:
        yield Finding(what, "good", f"all {len(steps)} are what was written: {some(steps, 10)}")
    for step, why in damaged.items():
        fix = (
            "Training goes on from an older one and sets this one aside."
            if whole
            else ("None is whole: start the run anew in another folder.")
        )
        yield Finding(what, "bad", why, "what was written", f"step {step}", fix)
    others = {step: side["convention"] for step, side in whole.items()}
    if wrong := [step for step, convention in others.items() if convention != CONVENTION]:
        yield Finding(
            what,
            "bad",
            f"conventions {others[wrong[0]]}",
            str(CONVENTION),
            some(wrong),
            "Rays or actions mean something else here: use the version of jaxcam that trained it.",
        )
    if aside := sorted(p.name for p in (folder / "damaged").glob("*")):
        yield Finding(
            "set aside",
            "note",
            f"damaged checkpoints {some(aside)}",
            where="damaged/",
            fix="Delete them when you know why.",
        )


def _dataset(folder: Path, config: TrainConfig, whole: Sides) -> Finding:
    """Whether the demonstrations are where the run found them, and still the same."""
    what = "dataset"
    path = Path(config.dataset) if config.dataset else dataset_path(collect_config(config))
    if not path.exists():
        # Relative to where the run was started, if its folder still is where it was made.
        depth = len(Path(config.run_dir).parts)
        if folder.absolute().parts[-depth:] == Path(config.run_dir).parts:
            path = folder.absolute().parents[depth - 1] / path
    if not path.exists():
        fix = "Resuming needs it: run from the folder the run was started in, or pass --data-dir."
        if not config.dataset:
            fix += " Training collects it anew if it is gone; it is then the same."
        return Finding(what, "note", "not found", where=str(path), fix=fix)
    try:
        demos = read_demos(path, task=config.task, scene=config.scene)
    except JaxcamError as error:
        return Finding(what, "bad", str(error), where=str(path))
    trained = {str(side["data"]).split("-")[0] for side in whole.values()}
    if not trained or trained == {demos.fingerprint}:
        return Finding(what, "good", f"content {demos.fingerprint}", where=str(path))
    return Finding(
        what,
        "bad",
        f"content {demos.fingerprint}",
        some(sorted(trained)),
        str(path),
        "It is not what the run was trained on: restore it, or train anew.",
    )


def _metrics(folder: Path) -> Finding:
    what = "metrics"
    try:
        rows = read_jsonl(folder / "metrics.jsonl")
    except JaxcamError as error:
        return Finding(what, "bad", str(error), fix="Cut the file before that line.")
    if not rows:
        return Finding(what, "note", "none yet")
    bad = [
        f"{key} at step {row.get('step')}"
        for row in rows
        for key, value in row.items()
        if isinstance(value, float) and not math.isfinite(value)
    ]
    skipped = [row["skipped"] for row in rows if "skipped" in row]
    kept = 1 - sum(skipped) / max(len(skipped), 1)
    if bad or kept < LEAST_GOOD:
        got = f"{len(bad)} are no numbers, {1 - kept:.1%} of updates were skipped"
        return Finding(
            what,
            "bad",
            got,
            "finite",
            some(bad),
            "It diverged: lower --lr, or look for odd data with jaxcam.check.",
        )
    losses = [(row["step"], row["loss"]) for row in rows if "loss" in row]
    if not losses:
        return Finding(what, "note", f"{len(rows)} rows without a loss")
    (first, high), (last, low) = losses[0], losses[-1]
    got = f"{len(rows)} rows, all finite; loss {high:.3g} at step {first}, {low:.3g} at {last}"
    return Finding(what, "good", got)


def _evaluations(folder: Path, pairs: int) -> Iterator[Finding]:
    """Whether each evaluated checkpoint has an outcome for each of its pairs, `pairs` or more."""
    try:
        rows = [USUAL | row for row in read_jsonl(folder / "eval" / "rows.jsonl")]
    except JaxcamError as error:
        yield Finding("evaluation", "bad", str(error), fix="Cut the file before that line.")
        return
    if not rows:
        yield Finding("evaluation", "note", "none yet", fix=f"python -m jaxcam.evaluate {folder}")
        return
    twice = [key for key, n in Counter(_key(r) for r in rows if is_finished(r)).items() if n > 1]
    if twice:
        yield Finding(
            "evaluation",
            "bad",
            f"{len(twice)} rollouts have several outcomes",
            "one",
            f"pair {some([key[-1] for key in twice])}",
            "Two processes wrote, or files were joined: keep the first of each.",
        )
    cells: dict[Any, list[Row]] = {}
    for row in latest_rows(rows):
        cells.setdefault((row.get("split", "test"), row.get("step")), []).append(row)
    most = {split: max(len(c) for (s, _), c in cells.items() if s == split) for split, _ in cells}
    for (split, step), cell in sorted(cells.items(), key=str):
        done = sum(map(is_finished, cell))
        lost = len(cell) - done
        asked = max(min(pairs, most[split]), 1 + max(row["pair"] for row in cell))
        got = f"{done} of {asked} pairs have an outcome"
        where = f"{split}, step {step}"
        if done == asked:
            yield Finding("evaluation", "good", got, where=where)
            continue
        why = f"{got}; {lost} ended in an error" if lost else got
        fix = f"python -m jaxcam.evaluate {folder} --split {split} --step {step} --pairs {asked}"
        yield Finding("evaluation", "note", why, f"{asked}", where, f"Run what is missing: {fix}")


def _key(row: Row) -> tuple[Any, ...]:
    names = ("split", "step", "width", "engine", "ensemble", "pair")
    return tuple(row.get(name) for name in names)


def _environment(folder: Path) -> Finding:
    what, file = "environment", folder / "env.txt"
    if not file.is_file():
        return Finding(what, "note", "not written down", where="env.txt")
    then = dict(line.split(" ", 1) for line in file.read_text("utf-8").splitlines() if " " in line)
    now = environment()
    changed = [f"{k} {v} → {now.get(k, 'gone')}" for k, v in then.items() if now.get(k) != v]
    if not changed:
        return Finding(what, "good", "as it was")
    return Finding(
        what, "note", some(changed), "as it was", fix="It goes on, but results are not bit-exact."
    )


def _what_next(folder: Path, config: TrainConfig, steps: list[int]) -> Finding:
    """What the folder is good for."""
    what = "what it can do"
    if not steps:
        return Finding(what, "note", "be trained from the start; nothing to evaluate")
    last = steps[-1]
    evaluate = f"be evaluated at {len(steps)} steps"
    if last >= config.steps:
        return Finding(what, "good", f"is trained to its end, {last:,} updates; can {evaluate}")
    return Finding(what, "good", f"resume at {last:,} of {config.steps:,} updates; {evaluate}")
