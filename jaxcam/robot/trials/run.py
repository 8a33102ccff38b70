"""`python -m jaxcam.trial SHEET.yaml`: policies tried on a robot, as the paper did it."""

import contextlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from jaxcam.config.commands import TrialConfig
from jaxcam.errors import ConfigError
from jaxcam.files.json import read_json
from jaxcam.files.locks import InUseError, NamedLock
from jaxcam.files.paths import absolute
from jaxcam.files.whole import write_atomically
from jaxcam.robot.driver import make_robot
from jaxcam.robot.trials.attempts import Driven, Runner
from jaxcam.robot.trials.keyboard import Keyboard
from jaxcam.robot.trials.order import Rollout, rollouts
from jaxcam.robot.trials.policies import Served, ask_policies, check_robot
from jaxcam.robot.trials.relay import Relay
from jaxcam.robot.trials.report import Trial, write_trials
from jaxcam.robot.trials.rows import done, read_trial_rows
from jaxcam.robot.trials.session import TrialSession, check_weights
from jaxcam.robot.trials.sheet import Sheet, read_sheet
from jaxcam.robot.trials.sights import calibrations, read_calibrations

ROWS, SHEET, LOCK = "rows.jsonl", "sheet.json", "lock"


def main(config: TrialConfig, console: Console) -> int:
    """Run what is left of a trial, or report on one or several; the exit code."""
    sheets = [absolute(sheet) for sheet in config.sheet]
    own = config.out if len(sheets) == 1 else ""
    trials = [_trial(path, own) for path in sheets]
    if config.report:
        out = absolute(config.out) if config.out else trials[0].folder
        console.print(f"Wrote {write_trials(trials, out)}.", highlight=False, soft_wrap=True)
        return 0
    (path,), (trial,) = sheets, trials
    if config.list:
        _print_order(trial, console)
        return 0
    with _alone(trial.folder):
        store_sheet(trial.folder / SHEET, trial.sheet)
        is_done = _go(path, _trial(path, own), console)
        if is_done:
            page = write_trials([_trial(path, own)], trial.folder)
            console.print(f"\nAll is done. Wrote {page}.", highlight=False, soft_wrap=True)
        else:
            console.print(
                "\nStopped. What was rated is kept; the same command goes on with it. --report "
                "writes what there is so far, and with it which policy is which.",
                highlight=False, soft_wrap=True,
            )  # fmt: skip
    return 0


def _trial(path: Path, out: str) -> Trial:
    """What there is of a trial so far."""
    sheet = read_sheet(path)
    folder = absolute(out) if out else path.with_name(f"{path.stem}.trial")
    planned = rollouts(sheet)
    if (folder / SHEET).exists():
        check_sheet(folder / SHEET, sheet)
    return Trial(sheet, folder, planned, read_trial_rows(folder / ROWS, planned))


def _go(path: Path, trial: Trial, console: Console) -> bool:
    """Run what is left; whether all is done."""
    sheet, planned = trial.sheet, trial.planned
    rated = len(done(trial.rows))
    if rated == len(planned):
        return True
    served = ask_policies(sheet, path.parent)
    check_weights(planned, trial.rows, served)
    _look_at_cameras(sheet, path.parent, console)
    if unused := len(sheet.starts) - len({rollout.condition.start for rollout in planned}):
        console.print(
            f"Note: {unused} of {len(sheet.starts)} starts are in no rollout: there are fewer "
            "choices of cameras and placements than starts. Raise 'repeats' for all of them.",
            highlight=False, soft_wrap=True,
        )  # fmt: skip
    console.print(
        f"{sheet.task}: {len(planned)} rollouts, {rated} of them done. "
        f"{len(served)} policies, {len(sheet.starts)} starts. Which letter is which policy stands "
        "in the report, at the end.",
        highlight=False, soft_wrap=True,
    )  # fmt: skip
    with _runner(sheet, path.parent, served, console) as runner:
        session = TrialSession(
            sheet, path.parent, trial.folder / ROWS, planned, served, runner,
            Keyboard(console), console, [*trial.rows],
        )  # fmt: skip
        return session.go()


@contextlib.contextmanager
def _runner(
    sheet: Sheet, folder: Path, served: Sequence[Served], console: Console
) -> Iterator[Runner]:
    if sheet.robot != "none":
        robot = make_robot(sheet.robot, sheet.robot_settings or {}, folder)
        check_robot(robot, served)
        yield Driven(robot)
        return
    relay = Relay(sheet.listen)
    try:
        console.print(
            f"Your loop asks at {relay.url}; connect it before each rollout (docs/robot.md).",
            highlight=False, soft_wrap=True,
        )  # fmt: skip
        yield relay
    finally:
        relay.close()


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keeps a second trial out of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = NamedLock(folder / LOCK)
    try:
        lock.take()
    except InUseError as error:
        raise ConfigError(
            f"A trial of this sheet is going on: {error.holder}. End it, or choose another --out."
        ) from error
    try:
        yield
    finally:
        lock.free()


def _look_at_cameras(sheet: Sheet, folder: Path, console: Console) -> None:
    """Refuses cameras that nobody calibrated, and tells placements that are still to come."""
    if sheet.cameras is None or sheet.cameras.file is None:
        return
    file = read_calibrations(folder / sheet.cameras.file, sheet.cameras.names)
    for place in sheet.placements:
        for words in calibrations(file, sheet.cameras.names, place)[1]:
            console.print(f"Note: {words}.", highlight=False, soft_wrap=True)


def store_sheet(file: Path, sheet: Sheet) -> None:
    """Write down what a trial is of, or check that it is what was written down.

    Args:
        file: JSON file beside the rows.
        sheet: What the trial is of now.

    Raises:
        ConfigError: It has changed since.
    """
    if file.exists():
        check_sheet(file, sheet)
    else:
        write_atomically(file, json.dumps(sheet.lasting(), indent=2) + "\n")


def check_sheet(file: Path, sheet: Sheet) -> None:
    """Refuse a sheet that has changed since its trial began.

    Args:
        file: What `store_sheet` wrote.
        sheet: The sheet now.

    Raises:
        ConfigError: It has changed; the message says where.
        DatasetError: The file is damaged.
    """
    before: Any = read_json(file)
    now = json.loads(json.dumps(sheet.lasting()))
    before = before if isinstance(before, dict) else {}
    changed = [
        f"{name}: {json.dumps(before.get(name))} then, {json.dumps(now.get(name))} now"
        for name in sorted(before.keys() | now.keys())
        if before.get(name) != now.get(name)
    ]
    if changed:
        raise ConfigError(
            f"The sheet has changed since this trial began: {'; '.join(changed)}. Rollouts of both "
            "would not be comparable: put it back, or begin anew with another --out. Addresses, "
            "keys, the robot's settings and calibrations may change."
        )


def _print_order(trial: Trial, console: Console) -> None:
    rated = done(trial.rows)
    for rollout in trial.planned:
        console.print(_line(rollout, rated.get(rollout.number) is not None),
                      highlight=False, soft_wrap=True)  # fmt: skip


def _line(rollout: Rollout, is_done: bool) -> str:
    condition = rollout.condition
    parts = [f"{rollout.number:>4}", "done" if is_done else "    ", f"policy {rollout.letter}"]
    parts += [f"placement {condition.placement}"] if condition.placement else []
    parts += [", ".join(condition.cameras)] if condition.cameras else []
    return "  ".join([*parts, f"start {condition.start + 1}"])
