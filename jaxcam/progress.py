"""Progress bars with time left, for people; nothing when there is no console."""

import contextlib
from collections.abc import Callable, Iterator

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


@contextlib.contextmanager
def progress(
    console: Console | None, what: str, total: int, *, done: int = 0
) -> Iterator[Callable[..., None]]:
    """Shows how far a long job is.

    Args:
        console: where; None shows nothing.
        what: the job, a word or two.
        total: number of steps.
        done: steps that are done already.

    Yields:
        `advance(steps=1, note="")`, to be called as steps are done.
    """
    if console is None:
        yield lambda steps=1, note="": None
        return
    columns = (
        TextColumn("{task.description:>12}"),
        BarColumn(),
        TaskProgressColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, total=total, completed=done, note="")

        def advance(steps: int = 1, note: str = "") -> None:
            bar.update(task, advance=steps)
            if note:
                bar.update(task, note=note)

        yield advance
