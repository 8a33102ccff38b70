"""The trial itself: rollout after rollout, each rated, each kept before the next one begins."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from jaxcam.errors import ConfigError
from jaxcam.interrupts import Stopped
from jaxcam.robot.driver import Setup
from jaxcam.robot.trials.attempts import Attempt, Ran, Runner
from jaxcam.robot.trials.keyboard import Keyboard, QuitError
from jaxcam.robot.trials.order import Rollout
from jaxcam.robot.trials.policies import Served
from jaxcam.robot.trials.rows import Outcome, TrialRow, append_row, done
from jaxcam.robot.trials.sheet import Sheet
from jaxcam.robot.trials.sights import (
    Calibrated,
    PolicySight,
    calibrations,
    read_calibrations,
    views_for,
)

OUTCOMES: dict[str, Outcome] = {"s": "success", "h": "half", "f": "failure", "r": "redo"}
"""What the operator types, with or without the rest of the word."""


@dataclass
class TrialSession:
    """A trial that goes on.

    Attributes:
        sheet: What is tried.
        folder: Of the sheet, where relative paths begin.
        file: Of the rows.
        planned: The rollouts, in order.
        served: The policies' servers, in the sheet's order.
        runner: Runs rollouts.
        keyboard: The operator's.
        console: Where the operator is talked to.
        rows: What has been rated so far.
    """

    sheet: Sheet
    folder: Path
    file: Path
    planned: Sequence[Rollout]
    served: Sequence[Served]
    runner: Runner
    keyboard: Keyboard
    console: Console
    rows: list[TrialRow] = field(default_factory=list)

    def go(self) -> bool:
        """Run what is left, until the operator stops; whether all is done.

        Raises:
            Stopped: Ctrl-C; all that was rated is kept.
            JaxcamError: A policy's server or the cameras file is no longer what it was.
        """
        before: Rollout | None = None
        while (rollout := self._next()) is not None:
            self._announce(rollout, before)
            try:
                attempt = self._ready(rollout)
                if attempt is None:
                    before = None
                    continue
                self._run(attempt)
            except QuitError:
                return False
            before = rollout
        return True

    def _next(self) -> Rollout | None:
        rated = done(self.rows)
        return next((r for r in self.planned if r.number not in rated), None)

    def _say(self, words: str) -> None:
        self.console.print(words, highlight=False, soft_wrap=True)

    def _announce(self, rollout: Rollout, before: Rollout | None) -> None:
        """What the operator has to put where."""
        condition = rollout.condition
        self._say(f"\nRollout {rollout.number} of {len(self.planned)}: policy {rollout.letter}.")
        if self.sheet.placed:
            moved = before is None or before.condition.placement != condition.placement
            what = "Put the cameras as in placement" if moved else "Cameras stay: placement"
            self._say(f"  {what} {condition.placement}.")
        if condition.cameras:
            self._say(f"  Used: {', '.join(condition.cameras)}.")
        start = self.sheet.starts[condition.start]
        self._say(f"  Start {condition.start + 1}: {start}")

    def _ready(self, rollout: Rollout) -> Attempt | None:
        """The rollout with what it needs, when the operator is ready; None if he goes back."""
        while True:
            answer = self.keyboard.ask("  Enter: begin.  b: run the last one again.  q: stop.")
            if answer.lower() in ("b", "back"):
                return self._back()
            if answer:  # the robot does not begin to move by a slip of a finger
                self._say(f"  {answer!r:.80} is neither Enter, b nor q.")
                continue
            attempt, lacking = self._attempt(rollout)
            if not lacking:
                return attempt
            for words in lacking:
                self._say(f"  {words}.")
            self._say("  Calibrate the cameras, write it there, and press Enter.")

    def _back(self) -> None:
        """Have the rollout that was rated last run again."""
        rated = [row for row in self.rows if done(self.rows).get(row.number) is row]
        if not rated:
            self._say("  Nothing has been rated yet.")
            return
        self._keep(self.planned[rated[-1].number - 1], Ran(0.0), "redo", "rated by mistake")
        self._say(f"  Rollout {rated[-1].number} is run again.")

    def _attempt(self, rollout: Rollout) -> tuple[Attempt, list[str]]:
        """A rollout with what it needs, and what of that is missing."""
        sheet, condition = self.sheet, rollout.condition
        served = self.served[rollout.policy]
        known: dict[str, Calibrated] = {}
        lacking: list[str] = []
        names = sheet.cameras.names if sheet.cameras else ()
        if sheet.cameras and sheet.cameras.file is not None:
            file = read_calibrations(self.folder / sheet.cameras.file, names)
            known, missing = calibrations(file, names, condition.placement)
            used = [f"camera {name!r}" for name in condition.cameras]
            lacking = [m for m in missing if not known or any(name in m for name in used)]
        views = views_for(condition.cameras, served.views)
        sight = PolicySight(names, views, known, sheet.prompt)
        cameras = {
            name: (c.optics.K, (c.optics.height, c.optics.width), c.base_from_camera)
            for name, c in known.items()
        }
        start = condition.start
        lenses = {n: c.optics.distortion for n, c in known.items() if c.optics.distortion.any()}
        setup = Setup(start, sheet.starts[start], condition.placement, cameras, lenses)
        return Attempt(rollout, served, sight, setup, sheet.seconds), lacking

    def _run(self, attempt: Attempt) -> None:
        """Run a rollout, have it rated, and keep it."""
        self._say("  Running. Enter: end it.")
        rollout, calibration = attempt.rollout, _calibration(attempt)
        self._tell_changed(rollout, calibration)
        try:
            ran = self.runner.run(attempt, self.keyboard.pressed)
        except Stopped:
            self._keep(rollout, Ran(0.0), "redo", "stopped while it ran")
            raise
        words = f"  It took {ran.seconds:.1f} s"
        self._say(f"{words}; {ran.lateness}." if ran.lateness else f"{words}.")
        if ran.fault:
            self._say(f"  What ended it: {ran.fault}")
        try:
            outcome, comment = self._rated(ran)
        except (Stopped, QuitError):
            self._keep(rollout, ran, "redo", "stopped before it was rated", calibration)
            raise
        self._keep(rollout, ran, outcome, comment, calibration)

    def _rated(self, ran: Ran) -> tuple[Outcome, str]:
        """How it ended, and what the operator says of it."""
        self._say(f"  Success: {self.sheet.success}\n  Half: {self.sheet.half}")
        proposed = f"  Enter: {ran.outcome}, as the robot says." if ran.outcome else ""
        question = (
            "  s: success.  h: half.  f: failure.  r: run it again.  q: stop here. "
            f"A comment may follow.{proposed}"
        )
        while True:
            word, _, comment = self.keyboard.ask(question).partition(" ")
            if not word and ran.outcome:
                return ran.outcome, comment
            for key, outcome in OUTCOMES.items():
                if word.lower() in (key, outcome):
                    return outcome, comment.strip()
            self._say(f"  {word!r} is none of s, h, f, r and q.")

    def _keep(
        self,
        rollout: Rollout,
        ran: Ran,
        outcome: Outcome,
        comment: str,
        calibration: dict[str, Any] | None = None,
    ) -> None:
        """Write a row, and wait until it is on the disk."""
        condition = rollout.condition
        row = TrialRow(
            number=rollout.number,
            policy=rollout.letter,
            placement=condition.placement,
            cameras=condition.cameras,
            start=condition.start,
            outcome=outcome,
            comment=comment,
            seconds=round(ran.seconds, 3),
            time=datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
            fault=ran.fault,
            lateness=ran.lateness,
            weights_sha=self.served[rollout.policy].weights_sha,
            calibration=calibration,
        )
        append_row(self.file, row)
        self.rows.append(row)

    def _tell_changed(self, rollout: Rollout, calibration: dict[str, Any] | None) -> None:
        """Tell where a camera is no longer calibrated as it was in the same placement before."""
        for row in self.rows:
            if row.placement != rollout.condition.placement or not (
                row.calibration and calibration
            ):
                continue
            for name in calibration.keys() & row.calibration.keys():
                if row.calibration[name] != calibration[name]:
                    self._say(
                        f"  Camera {name!r} was calibrated otherwise in rollout {row.number}, in "
                        "the same placement. If it was not moved back, compare with care."
                    )
                    return


def check_weights(
    planned: Sequence[Rollout], rows: Sequence[TrialRow], served: Sequence[Served]
) -> None:
    """Refuse servers that serve other weights than earlier in the trial.

    Args:
        planned: The rollouts.
        rows: What has been rated so far.
        served: The policies' servers.

    Raises:
        ConfigError: One does.
    """
    for row in rows:
        one = served[planned[row.number - 1].policy]
        if row.weights_sha and one.weights_sha and row.weights_sha != one.weights_sha:
            raise ConfigError(
                f"Policy {one.entry.name!r}: {one.entry.url} serves the weights "
                f"{one.weights_sha[:12]}, and earlier rollouts were of {row.weights_sha[:12]}. "
                "Serve what was served then, or begin anew with another --out."
            )


def _calibration(attempt: Attempt) -> dict[str, Any] | None:
    """What the policy is told of the cameras that are used, for the row."""
    calibration = {
        name: {
            "K": camera.optics.K.tolist(),
            "size": [camera.optics.width, camera.optics.height],
            "base_from_camera": camera.base_from_camera.tolist(),
        }
        for name, camera in attempt.sight.known.items()
        if name in attempt.sight.views
    }
    return calibration or None
