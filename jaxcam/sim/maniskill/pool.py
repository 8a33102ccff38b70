"""Child processes that hold a world's simulator, seen from the parent.

A child is a `jaxcam.sim.maniskill.worker`. It may die or hang: one that has died, or has not
counted on in its shared memory for a while, is started anew once and asked again; requests carry
all that is needed to answer them. After that the error shows the child's last words.
"""

import atexit
import contextlib
import functools
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from socket import socketpair
from typing import Any

from jaxcam.errors import SimError
from jaxcam.sim.maniskill.machine import child_environment, device, require, require_cuda
from jaxcam.sim.maniskill.memory import Memory, Sizes, open_memory
from jaxcam.sim.maniskill.scene import SapienWorld
from jaxcam.sim.maniskill.worlds import Assignment

STALL = 180.0
"""Time (s) without a sign of work after which a child counts as hung; importing PyTorch and
ManiSkill and compiling shaders for the first time takes up to a minute."""
POLL = 0.5
"""Time (s) between looks at a silent child."""
MOST = 8
"""Children at most; each takes about 1 GB."""
SHARE = 4
"""Worlds or views that a child is started for; fewer are left to those that run."""
LAST_LINES, LINE_LENGTH = 15, 200
_LOG = logging.getLogger(__name__)


class Child:
    """One child process, started when it is first asked.

    Args:
        world: The world it simulates.
        on_gpu: Whether it simulates on a card.
    """

    def __init__(self, world: SapienWorld, *, on_gpu: bool = False) -> None:
        self._on_gpu = on_gpu
        self._sizes = Sizes(world.nq, world.nv, 2 + len(world.markers))
        self._world = world
        self._file = os.memfd_create("jaxcam")
        self.memory: Memory = open_memory(self._file, self._sizes)
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection
        self._words = tempfile.TemporaryFile()  # noqa: SIM115  (open as long as the child)
        self._restarts = 1
        self._asked: tuple[Any, ...] = ()

    @property
    def pid(self) -> int | None:
        """The process's number; None before it is first asked."""
        return self._process.pid if self._process else None

    def ask(self, *request: Any) -> None:
        """Sends a request, a method of `Worker` and its arguments; `answer` waits for the end."""
        if self._process is None:
            self._start()
        self._asked = request
        with contextlib.suppress(OSError):  # it has died; `answer` finds out
            self._pipe.send(request)

    def answer(self) -> Any:
        """What the last request returned.

        Raises:
            SimError: If the child died or hung twice, or could not do what was asked.
        """
        while True:
            try:
                done, value = self._wait()
            except _LostError as lost:
                if not self._restarts:
                    raise SimError(self._account(str(lost))) from lost
                self._restarts -= 1
                _LOG.warning("%s It is started anew.", self._account(str(lost)))
                self._kill()
                self.ask(*self._asked)
                continue
            if not done:
                raise SimError(f"{self._name} could not {self._asked[0]}:\n{value}")
            return value

    def close(self) -> None:
        """Ends the process for good."""
        if self._process is not None:
            self._pipe.close()
            try:
                self._process.wait(2)
            except subprocess.TimeoutExpired:
                self._kill()
            self._process = None
        self._words.close()
        os.close(self._file)

    @property
    def _name(self) -> str:
        return f"ManiSkill's process {self.pid} ({self._world.env})"

    def _start(self) -> None:
        to = Assignment(self._world.env, self._world.name, self._on_gpu, device().kind, self._sizes)
        assignment = json.dumps({**asdict(to), "sizes": self._sizes._asdict()})
        ours, theirs = socketpair()
        ends = (theirs.fileno(), self._file)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "jaxcam.sim.maniskill.worker", *map(str, ends), assignment],
            pass_fds=ends, env=child_environment(),
            stdin=subprocess.DEVNULL, stdout=self._words, stderr=self._words,
        )  # fmt: skip
        theirs.close()
        self._pipe = Connection(ours.detach())

    def _wait(self) -> tuple[bool, Any]:
        assert self._process is not None
        beat, since = self.memory.beat[0], time.monotonic()
        while not self._pipe.poll(POLL):
            if self._process.poll() is not None:
                raise _LostError(_ending(self._process.returncode))
            if self.memory.beat[0] != beat:
                beat, since = self.memory.beat[0], time.monotonic()
            if time.monotonic() - since > STALL:
                raise _LostError(f"has hung: no sign of work for {STALL:g} s")
        try:
            return self._pipe.recv()
        except (EOFError, OSError) as error:
            raise _LostError(_ending(self._process.wait())) from error

    def _kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self._pipe.close()
        self._process = None

    def _account(self, what: str) -> str:
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()[-LAST_LINES:]
        words = "\n".join(line[:LINE_LENGTH] for line in lines) or "(nothing)"
        return f"{self._name} {what}, asked to {self._asked[0]}. Its last words:\n{words}\n"


class _LostError(Exception):
    """A child that will not answer any more, and why."""


def _ending(code: int) -> str:
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


class Pool:
    """The children of one world.

    Args:
        world: The world.
        on_gpu: Whether one child has all its worlds, and simulates and draws them on a card.
        most: Children at most, on the CPU; the machine's cores, up to `MOST`, when None.
    """

    def __init__(
        self, world: SapienWorld, *, on_gpu: bool = False, most: int | None = None
    ) -> None:
        self.world, self._on_gpu = world, on_gpu
        self._most = 1 if on_gpu else most or min(os.cpu_count() or 1, MOST)
        self._children: list[Child] = []
        self._hello: dict[str, float] = {}
        atexit.register(self.close)

    @property
    def about(self) -> dict[str, float]:
        """A child's description of its world: see `Worker.hello`."""
        if not self._hello:
            self._hello = self.each([(self.children(1)[0], ("hello",))])[0]
        return self._hello

    def children(self, count: int) -> list[Child]:
        """The children that share `count` worlds or views."""
        wanted = min(self._most, max(1, count // SHARE))
        while len(self._children) < wanted:
            self._children.append(Child(self.world, on_gpu=self._on_gpu))
        return self._children[:wanted]

    def each(self, requests: Sequence[tuple[Child, tuple[Any, ...]]]) -> list[Any]:
        """Asks children, all at once, and waits for their answers.

        Raises:
            SimError: See `Child.answer`.
        """
        for child, request in requests:
            child.ask(*request)
        answers, failed = [], None
        for child, _ in requests:  # all of them: none may be left for the next request to find
            try:
                answers.append(child.answer())
            except SimError as error:
                failed = failed or error
        if failed:
            raise failed
        return answers

    def close(self) -> None:
        """Ends all children; the next request starts them anew."""
        for child in self._children:
            child.close()
        self._children.clear()


def pool_of(world: SapienWorld, *, on_gpu: bool = False) -> Pool:
    """The children of a world, shared by all that step and draw it.

    Raises:
        SimError: If this machine cannot run them; the message says what is missing.
    """
    require_cuda() if on_gpu else require()
    return _shared(world, on_gpu)


@functools.cache
def _shared(world: SapienWorld, on_gpu: bool) -> Pool:
    return Pool(world, on_gpu=on_gpu)
