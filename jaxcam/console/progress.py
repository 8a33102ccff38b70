"""Progress bars with time left, for people; lines now and then in a file; else nothing."""

import contextlib
import time
from collections.abc import Callable, Iterator
from datetime import timedelta

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from jaxcam.console.paces import expected_seconds, in_words, keep_pace
from jaxcam.interrupts import check_stop

LINE_SECONDS = 60.0
"""Between the lines in a file, such as the log of a job on a cluster."""


@contextlib.contextmanager
def progress(
    console: Console | None, what: str, total: int, *, done: int = 0, job: str = ""
) -> Iterator[Callable[..., None]]:
    """Shows how far a long job is.

    Args:
        console: Where; None shows nothing.
        what: The job, a word or two.
        total: Number of steps.
        done: Steps that are done already.
        job: Its kind in words: how long it takes is then told at its start, by the last one of the
            same kind on this machine (`jaxcam.console.paces`). Empty tells nothing.

    Yields:
        `advance(steps=1, note="")`, to be called as steps are done, when nothing is half-way: it
        raises `jaxcam.interrupts.Stopped` if a signal asked to stop and nobody else looks for it.
    """
    if console is None:
        yield lambda steps=1, note="": check_stop()
        return
    if job and total > done:
        words = in_words(expected_seconds(job, total - done))
        console.print(f"{what} ({total - done} steps): {words}", highlight=False, soft_wrap=True)
    started, made = time.monotonic(), [0]

    def counted(advance: Callable[..., None]) -> Callable[..., None]:
        def count(steps: int = 1, note: str = "") -> None:
            made[0] += steps
            advance(steps, note)

        return count

    with _shown(console, what, total, done) as advance:
        yield counted(advance)
    keep_pace(job, made[0], time.monotonic() - started)


@contextlib.contextmanager
def _shown(console: Console, what: str, total: int, done: int) -> Iterator[Callable[..., None]]:
    """The bar, or the lines."""
    if not console.is_terminal:
        lines = _Lines(console, what, total, done)
        yield lines.advance
        lines.end()
        return
    columns = (
        TextColumn("{task.description:>12}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, total=total, completed=done, note="")

        def advance(steps: int = 1, note: str = "") -> None:
            bar.update(task, advance=steps)
            if note:
                bar.update(task, note=note)
            check_stop()

        yield advance


class _Lines:
    """Progress where lines stay once they are written."""

    def __init__(self, console: Console, what: str, total: int, done: int) -> None:
        self._console, self._what, self._total = console, what, total
        self._first = self._done = done
        self._note = ""
        self._started = self._shown = time.monotonic()

    def advance(self, steps: int = 1, note: str = "") -> None:
        self._done += steps
        self._note = note or self._note
        check_stop()
        now = time.monotonic()
        if now - self._shown < LINE_SECONDS or self._done == self._first:
            return
        self._shown, gone = now, now - self._started
        to_come = gone / (self._done - self._first) * (self._total - self._done)
        self._show(f"{_clock(gone)} gone, {_clock(to_come)} left")

    def end(self) -> None:
        self._show(f"{_clock(time.monotonic() - self._started)} in all")

    def _show(self, clock: str) -> None:
        line = f"{self._what} {self._done} of {self._total}, {clock}  {self._note}"
        self._console.print(line.rstrip(), highlight=False, soft_wrap=True)


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
