"""`python -m jaxcam.sweep GRID.yaml`: trains and evaluates all runs of a grid.

What is done is skipped; what was stopped, killed or preempted goes on. A table shows how far all
are.
"""

import contextlib
import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table

from jaxcam.config.commands import SweepConfig
from jaxcam.errors import JaxcamError
from jaxcam.interrupts import Stopped, check_stop, interrupts
from jaxcam.results.stats import success_rate
from jaxcam.runs.folder import holder
from jaxcam.runs.grid import Grid, Planned, Standing, progress_of, read_grid
from jaxcam.runs.jobs import PREEMPTED, Executor, Here, Job, Started, Submitit

SECONDS = 1.0
"""Between looks at the jobs."""
LAST_BYTES = 1 << 16
"""Of a log, in which a run's last words are looked for."""
_ORDER = ("running", "failed", "waiting", "done")


@dataclass
class SweepEntry:
    """A run of the grid and where it stands."""

    run: Planned
    progress: Standing
    state: str
    job: Started | None = None
    starts: int = 0
    reason: str = ""

    @property
    def log(self) -> Path:
        """What its commands print."""
        return self.run.folder.parent / "logs" / f"{self.run.name}.log"


def sweep(
    grid: Grid, executor: Executor, console: Console, *, jobs: int, retries: int
) -> list[SweepEntry]:
    """Runs what is left to do of a grid.

    Args:
        grid: The runs.
        executor: Where they run.
        console: For the table.
        jobs: How many run at once.
        retries: Times that a run is started again that was killed or preempted.

    Returns:
        All runs, each with the state "done" or "failed".

    Raises:
        Stopped: After a signal; what runs here was asked to save, and has.
    """
    entries = [_entry(run) for run in grid.runs]
    with (
        interrupts("Stopping; what runs here saves first."),
        _shown(console, grid, entries) as show,
    ):
        try:
            while any(e.state in ("waiting", "running") for e in entries):
                for entry in entries:
                    _look_after(entry, retries)
                free = jobs - sum(e.state == "running" for e in entries)
                waiting = [e for e in entries if e.state == "waiting" and _is_free(e)]
                for entry in waiting[: max(free, 0)]:
                    entry.job = executor.start(entry.run.name, Job(entry.run.commands(), entry.log))
                    entry.state, entry.starts = "running", entry.starts + 1
                show()
                time.sleep(SECONDS)
                check_stop()
        except Stopped:
            executor.stop()
            raise
    return entries


def _entry(run: Planned) -> SweepEntry:
    """A run as its folder has it; one that cannot be read has failed, and the others go on."""
    try:
        progress = progress_of(run)
    except (JaxcamError, OSError) as error:
        asked = len(run.steps) * run.pairs
        return SweepEntry(run, Standing(0, 0, asked, success_rate([])), "failed", reason=str(error))
    return SweepEntry(run, progress, "done" if progress.done else "waiting")


def _is_free(entry: SweepEntry) -> bool:
    """Whether nobody trains a run, such as a child of a sweep that was killed; notes who does."""
    if not (who := holder(entry.run.folder)):
        return True
    entry.reason = f"is in use by {who}"
    with contextlib.suppress(JaxcamError, OSError):
        entry.progress = progress_of(entry.run)
    return False


def _look_after(entry: SweepEntry, retries: int) -> None:
    """Bring a running entry up to date; decide what becomes of one that has ended."""
    if entry.state != "running" or entry.job is None:
        return
    ended = entry.job.done()
    now = _entry(entry.run)
    entry.progress, entry.reason = now.progress, now.reason or entry.reason
    if not ended:
        return
    if now.state == "failed":
        entry.state = "failed"
        return
    code, lost = _outcome(entry.job)
    if entry.progress.done:  # a report that failed after the last row is no reason to run again
        entry.state, entry.reason = "done", ""
    elif (lost or code < 0 or code in PREEMPTED) and entry.starts <= retries:
        entry.state, entry.reason = "waiting", f"stopped ({code}), starting again"
    else:
        entry.state = "failed"
        entry.reason = f"exit code {code}: {_last_words(entry.log)}"


def _outcome(job: Started) -> tuple[int, bool]:
    """Exit code, and whether the job was lost with its machine."""
    try:
        return job.result(), False
    except Exception:  # submitit raises what the scheduler did to a job, of many types
        return -1, True


def _last_words(log: Path) -> str:
    if not log.is_file():
        return "it said nothing"
    with open(log, "rb") as file:
        file.seek(max(0, log.stat().st_size - LAST_BYTES))
        lines = file.read(LAST_BYTES).decode(errors="replace").splitlines()
    words = [line.strip(" │╭╮╰╯─") for line in lines[-12:]]
    return next((line for line in reversed(words) if line), "it said nothing")[:200]


@contextlib.contextmanager
def _shown(
    console: Console, grid: Grid, entries: Sequence[SweepEntry]
) -> Iterator[Callable[[], None]]:
    """A live table on a terminal; elsewhere a line for each change."""
    if not console.is_terminal:
        shown: dict[str, tuple[str, int]] = {}

        def say() -> None:
            for e in entries:
                if shown.get(e.run.name) != (e.state, e.starts):
                    shown[e.run.name] = e.state, e.starts
                    console.print(f"{e.state:>8}  {e.run.name}  {_result(e)} {e.reason}".rstrip(),
                                  soft_wrap=True, highlight=False)  # fmt: skip

        yield say
        say()
        return
    with Live(table(grid, entries, console.height), console=console, auto_refresh=False) as live:

        def show() -> None:
            live.update(table(grid, entries, console.height), refresh=True)

        yield show
        show()


def table(grid: Grid, entries: Sequence[SweepEntry], height: int) -> Group:
    """The runs and how far they are: what runs and what failed first, as many as there is room for.

    Args:
        grid: For its title.
        entries: The runs.
        height: Lines of the terminal.
    """
    shown = Table("run", "state", "updates", "rollouts", "success", title=grid.title, expand=True)
    room = max(height - 8, 5)
    ordered = sorted(entries, key=lambda e: _ORDER.index(e.state))
    for e in ordered[:room]:
        p = e.progress
        shown.add_row(
            e.run.name, e.state + (f" ({e.reason})" if e.reason else ""),
            f"{p.step:,} / {e.run.config.steps:,}", f"{p.rollouts} / {p.asked}", _rate(p),
        )  # fmt: skip
    counts = Counter(e.state for e in entries)
    words = [f"{counts[state]} {state}" for state in _ORDER if counts[state]]
    words += [f"{len(ordered) - room} not shown"] if len(ordered) > room else []
    return Group(shown, ", ".join(words))


def _rate(progress: Standing) -> str:
    e = progress.estimate
    return f"{100 * e.value:.1f} % [{100 * e.low:.1f}, {100 * e.high:.1f}]" if e.n else "–"


def _result(entry: SweepEntry) -> str:
    p = entry.progress
    return f"{p.rollouts} of {p.asked} rollouts, success {_rate(p)}" if p.rollouts else ""


def main(config: SweepConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    grid = read_grid(config.grid)
    if config.list:
        for entry in map(_entry, grid.runs):
            words = f"# {entry.run.name}: {entry.state} {_result(entry)} {entry.reason}"
            console.print(words.rstrip(), soft_wrap=True, highlight=False)
            for command in entry.run.commands():
                words = shlex.join(["python", *command[1:]])
                console.print(words, soft_wrap=True, highlight=False)
        return 0
    executor = (
        Here(config.jobs)
        if config.cluster == "none"
        else Submitit(config.cluster, grid.runs_dir / "submitit", grid.slurm)
    )
    try:
        entries = sweep(grid, executor, console, jobs=config.jobs, retries=config.retries)
    except Stopped as stopped:
        what = "Jobs that were queued go on" if executor.keeps_running else "What is done is kept"
        console.print(f"{what}; run the same command again to continue.")
        return stopped.exit_code
    failed = [e for e in entries if e.state == "failed"]
    for e in failed:
        console.print(f"{e.run.name} failed, {e.reason} ({e.log})", style="red", soft_wrap=True)
    console.print(f"Compare: python -m jaxcam.report {shlex.quote(str(grid.runs_dir))}")
    return 1 if failed else 0
