"""A run as a job: its commands one after another, here or where submitit sends them."""

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

from jaxcam.errors import ConfigError

PREEMPTED = (130, 143)
"""Exit codes of commands that were asked to stop; they go on when they are run again."""


class Job:
    """Runs commands in order until one fails. Called in this process or, pickled, in another.

    Args:
        commands: Their words.
        log: File that what they print is appended to.
    """

    def __init__(self, commands: Sequence[Sequence[str]], log: Path) -> None:
        self.commands, self.log = commands, log
        self._child: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def __call__(self) -> int:
        """Run them.

        Returns:
            0, or the exit code of the command that failed; negative if a signal killed it.
        """
        self.log.parent.mkdir(parents=True, exist_ok=True)
        for command in self.commands:
            with open(self.log, "ab") as log:
                # A session of its own: Ctrl-C reaches it once, through `stop`.
                self._child = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                    start_new_session=True,
                )  # fmt: skip
            if self._stopped:
                self._child.terminate()
            if code := self._child.wait():
                return code
        return 0

    def stop(self) -> None:
        """Ask the command that runs to save and end; no other is started."""
        self._stopped = True
        if self._child is not None and self._child.poll() is None:
            self._child.send_signal(signal.SIGTERM)

    def checkpoint(self) -> Any:
        """What submitit calls when a cluster takes the machine: save, and queue the rest again."""
        from submitit.helpers import DelayedSubmission  # of an optional extra

        self.stop()
        if self._child is not None:
            # This runs in a signal handler, which may have interrupted a `wait` that holds the
            # lock of another: ask the kernel, and leave the exit code where it is.
            with contextlib.suppress(ChildProcessError):
                os.waitid(os.P_PID, self._child.pid, os.WEXITED | os.WNOWAIT)
        return DelayedSubmission(Job(self.commands, self.log))


class Started(Protocol):
    """A job that has been started."""

    def done(self) -> bool:
        """Whether it has ended."""
        ...

    def result(self) -> Any:
        """Its exit code, or the error that ended it."""
        ...


class Executor(Protocol):
    """Where jobs run."""

    keeps_running: bool
    """Whether jobs go on when this process ends."""

    def start(self, name: str, job: Job) -> Started:
        """Start a job, or queue it; one that an earlier process started is found again."""
        ...

    def stop(self) -> None:
        """Ask all jobs to end, and wait for them."""
        ...


class Here:
    """Child processes of this one, so many at once."""

    keeps_running = False

    def __init__(self, jobs: int) -> None:
        self._pool = ThreadPoolExecutor(jobs)
        self._jobs: list[Job] = []
        self._stopping = threading.Event()

    def start(self, name: str, job: Job) -> Future[int]:
        """Start a job, or queue it."""
        self._jobs.append(job)
        return self._pool.submit(lambda: PREEMPTED[0] if self._stopping.is_set() else job())

    def stop(self) -> None:
        """Ask all jobs to end, and wait for them."""
        self._stopping.set()
        for job in self._jobs:
            job.stop()
        self._pool.shutdown()


class Submitit:
    """Jobs of a cluster through submitit. Slurm's numbers are kept, to find them again.

    Args:
        cluster: "slurm", or "local" for processes on this machine, which are not found again.
        folder: For submitit's files.
        parameters: Of submitit, such as timeout_min, gpus_per_node or slurm_partition.
    """

    keeps_running = True

    def __init__(self, cluster: str, folder: Path, parameters: Mapping[str, Any]) -> None:
        try:
            import submitit  # an optional extra
        except ModuleNotFoundError as error:
            raise ConfigError(
                "Clusters need submitit: pip install 'jaxcam[sweep]', or leave out --cluster."
            ) from error
        self._folder = folder
        self._executor = submitit.AutoExecutor(folder, cluster=cluster)
        try:
            self._executor.update_parameters(**{"timeout_min": 1440, **parameters})
        except NameError as error:  # submitit's error for a parameter it does not know
            raise ConfigError(f"slurm: {error}") from error
        self._kind: Callable[..., Any] = {
            "slurm": submitit.SlurmJob, "local": submitit.LocalJob
        }[cluster]  # fmt: skip

    def start(self, name: str, job: Job) -> Started:
        """Queue a job, or find the one of that name that has not ended."""
        number = self._folder / f"{name}.job"
        if number.is_file():
            known = self._kind(self._folder, number.read_text())
            if not known.done():
                return known
        started = self._executor.submit(job)
        number.write_text(started.job_id)
        return started

    def stop(self) -> None:
        """Nothing: a cluster's jobs do not end with the process that queued them."""
