"""Whether a run folder is whole, and what can still be done with it."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from jaxcam.checks.evaluations import check_evaluations
from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.train import TrainConfig
from jaxcam.console.progress import progress
from jaxcam.console.words import some
from jaxcam.data.collection import dataset_path
from jaxcam.data.demos import read_demos
from jaxcam.data.recorded.spaces import as_learned
from jaxcam.errors import JaxcamError
from jaxcam.files.paths import absolute, home, read_text
from jaxcam.interop.recordings import read_recording
from jaxcam.runs.action_errors import read_errors
from jaxcam.runs.environment import environment
from jaxcam.runs.identity import RECORDED, stored_config, unlike
from jaxcam.runs.manifests import DamagedError, record_of_weights
from jaxcam.runs.metrics import read_metrics
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.digests import read_all
from jaxcam.training.side import CONVENTION

LEAST_GOOD = 0.9
"""Share of updates that must have been finite."""


@dataclass(frozen=True)
class Verified:
    """A run's checkpoints after every array of them was compared with its hash, by their step."""

    sides: dict[int, Mapping[str, Any]]
    """What was saved beside the arrays of each whole one."""
    damaged: dict[int, str]
    """What is wrong with each of the others."""


def check_run(folder: Path, console: Console | None = None) -> Iterator[Finding]:
    """Looks at everything in a run folder and changes nothing.

    Args:
        folder: Of the run.
        console: For progress; silent when None.
    """
    try:
        config = stored_config(folder)
    except JaxcamError as error:
        yield bad(
            "configuration",
            got=str(error),
            where="config.json",
            fix=(
                "Checkpoints hold a copy of the settings, in manifest/metadata: restore the "
                "file from there."
            ),
        )
        return
    task = config.task if config.task == RECORDED else f"{config.task}, {config.scene}"
    what = f"{config.policy} on {task}; {config.conditioning}"
    yield good("configuration", got=f"{what}, seed {config.seed}")
    checkpoints = Verified({}, {})
    try:
        checkpoints = _verify(folder, console)
    except OSError as error:
        yield bad("checkpoints", got=f"cannot be read: {error}")
    parts = {
        "configuration": lambda: _misfits(config, checkpoints),
        "checkpoints": lambda: _checkpoints(checkpoints),
        "set aside": lambda: _set_aside(folder),
        "weights": lambda: _weights(folder),
        "dataset": lambda: [_dataset(folder, config, checkpoints)],
        "metrics": lambda: [_metrics(folder)],
        "evaluation": lambda: (
            [_errors(folder)]
            if config.task == RECORDED
            else check_evaluations(folder, config.pairs)
        ),
        "environment": lambda: [_environment(folder)],
        "what it can do": lambda: [_what_next(config, sorted(checkpoints.sides))],
    }
    for what, part in parts.items():
        yield from _readable(what, part)


def _readable(what: str, part: Callable[[], Iterable[Finding]]) -> Iterator[Finding]:
    """A part's findings, or that its files cannot be read."""
    try:
        yield from part()
    except (JaxcamError, OSError, UnicodeError) as error:
        yield bad(what, got=f"cannot be read: {error}")


def _verify(folder: Path, console: Console | None) -> Verified:
    """Reads every array of every checkpoint."""
    steps, verified = checkpoint_steps(folder), Verified({}, {})
    with progress(console, "verifying", len(steps)) as advance:
        for step in steps:
            try:
                manifest, _ = read_all(folder / "checkpoints" / str(step))
                verified.sides[step] = manifest["side"]
            except (DamagedError, OSError) as error:
                verified.damaged[step] = str(error)
            advance()
    return verified


def _misfits(config: TrainConfig, verified: Verified) -> Iterator[Finding]:
    """Whether config.json is what the checkpoints were trained with."""
    for step, side in verified.sides.items():
        if misfits := unlike(config, side):
            yield bad(
                "configuration",
                got="; ".join(misfits),
                expected="what the checkpoint was trained with",
                where=f"config.json and step {step}",
                fix="One of them is of another run, or was edited: restore it.",
            )


def _checkpoints(verified: Verified) -> Iterator[Finding]:
    """Whether all checkpoints are what was written, with the conventions of this version."""
    what, sides = "checkpoints", verified.sides
    if not sides and not verified.damaged:
        yield note(what, got="none yet")
    elif not verified.damaged:
        yield good(what, got=f"all {len(sides)} are what was written: {some([*sides], 10)}")
    fix = "None is whole: start the run anew in another folder."
    if sides:
        fix = "Training goes on from an older one and sets this one aside."
    for step, why in verified.damaged.items():
        yield bad(what, got=why, expected="what was written", where=f"step {step}", fix=fix)
    others = {
        s: side["convention"] for s, side in sides.items() if side["convention"] != CONVENTION
    }
    if others:
        yield bad(
            what,
            got=f"conventions {next(iter(others.values()))}",
            expected=str(CONVENTION),
            where=some([*others]),
            fix="Rays or actions mean something else here: "
            "use the version of jaxcam that trained it.",
        )


def _set_aside(folder: Path) -> Iterator[Finding]:
    """A finding where training has set damaged checkpoints aside."""
    if names := sorted(path.name for path in (folder / "damaged").glob("*")):
        yield note(
            "set aside",
            got=f"damaged checkpoints {some(names)}",
            where="damaged/",
            fix="Delete them when you know why.",
        )


def _weights(folder: Path) -> Iterator[Finding]:
    """A finding where the run started from weights."""
    if record := record_of_weights(folder):
        kind = record.kind or "of an unknown kind"
        yield good("weights", got=f"started from {kind}, {record.sha256[:8]}", where="weights.json")


def _dataset(folder: Path, config: TrainConfig, checkpoints: Verified) -> Finding:
    """Whether the demonstrations are where the run found them, and still the same."""
    what = "dataset"
    path = home(config.dataset) if config.dataset else dataset_path(CollectConfig.of(config))
    path = _from_start(path, folder, config)
    if not path.exists():
        fix = "Resuming needs it: run from the folder the run was started in, or pass --data-dir."
        if not config.dataset:
            fix += " Training collects it anew if it is gone; it is then the same."
        return note(what, got="not found", where=str(path), fix=fix)
    try:
        fingerprint = _fingerprint(path, folder, config)
    except JaxcamError as error:
        return bad(what, got=str(error), where=str(path))
    # Behind a dataset's own fingerprint stands what it was turned into; that may have dashes, too.
    parts = 2 if config.task == RECORDED else -1
    trained = {str(side["data"]).rsplit("-", parts)[0] for side in checkpoints.sides.values()}
    if not trained or trained == {fingerprint}:
        return good(what, got=f"content {fingerprint}", where=str(path))
    return bad(
        what,
        got=f"content {fingerprint}",
        expected=some(sorted(trained)),
        where=str(path),
        fix="It is not what the run was trained on: restore it, or train anew.",
    )


def _from_start(path: Path, folder: Path, config: TrainConfig) -> Path:
    """A path that a run was given, relative to where it was started if its folder still tells."""
    made, folder = Path(config.run_dir).parts, absolute(folder)
    if not path.exists() and folder.parts[-len(made) :] == made:
        return folder.parents[len(made) - 1] / path
    return path


def _fingerprint(path: Path, folder: Path, config: TrainConfig) -> str:
    """Of the content of a dataset of either kind."""
    if config.task == RECORDED:
        cameras = _from_start(home(config.cameras), folder, config) if config.cameras else None
        return as_learned(read_recording(path, cameras), config).fingerprint
    return read_demos(path, task=config.task, scene=config.scene).fingerprint


def _errors(folder: Path) -> Finding:
    """The errors of actions that a run on a recorded dataset has."""
    steps = sorted({row.step for row in read_errors(folder)})
    if not steps:
        return note("evaluation", got="none yet", fix="Training measures errors at its end.")
    return good("evaluation", got=f"errors of actions at step {some(steps)}")


def _metrics(folder: Path) -> Finding:
    what = "metrics"
    try:
        rows = read_metrics(folder)
    except JaxcamError as error:
        return bad(what, got=str(error), fix="Cut the file before that line.")
    if not rows:
        return note(what, got="none yet")
    odd = [
        f"{key} at step {row.get('step')}"
        for row in rows
        for key, value in row.items()
        if isinstance(value, float) and not math.isfinite(value)
    ]
    skipped = [row["skipped"] for row in rows if "skipped" in row]
    kept = 1 - sum(skipped) / max(len(skipped), 1)
    if odd or kept < LEAST_GOOD:
        got = f"{len(odd)} are no numbers, {1 - kept:.1%} of updates were skipped"
        return bad(
            what,
            got=got,
            expected="finite",
            where=some(odd),
            fix="It diverged: lower --lr, or look for odd data with jaxcam.check.",
        )
    losses = [(row["step"], row["loss"]) for row in rows if "loss" in row]
    if not losses:
        return note(what, got=f"{len(rows)} rows without a loss")
    (first, high), (last, low) = losses[0], losses[-1]
    got = f"{len(rows)} rows, all finite; loss {high:.3g} at step {first}, {low:.3g} at {last}"
    return good(what, got=got)


def _environment(folder: Path) -> Finding:
    what, file = "environment", folder / "env.txt"
    if not file.is_file():
        return note(what, got="not written down", where="env.txt")
    then = dict(
        line.split(" ", 1) for line in read_text(file, "replace").splitlines() if " " in line
    )
    now = environment()
    changed = [f"{k} {v} → {now.get(k, 'gone')}" for k, v in then.items() if now.get(k) != v]
    if not changed:
        return good(what, got="as it was")
    return note(
        what,
        got=some(changed),
        expected="as it was",
        fix="It goes on, but results are not bit-exact.",
    )


def _what_next(config: TrainConfig, steps: list[int]) -> Finding:
    """What can be done with the folder: go on training, evaluate, or nothing."""
    what = "what it can do"
    if not steps:
        return note(what, got="be trained from the start; nothing to evaluate")
    last = steps[-1]
    evaluate = f"be evaluated at {len(steps)} steps"
    if config.task == RECORDED:
        evaluate = "be judged by its report"
    if last >= config.steps:
        return good(what, got=f"is trained to its end, {last:,} updates; can {evaluate}")
    return good(what, got=f"resume at {last:,} of {config.steps:,} updates; {evaluate}")
