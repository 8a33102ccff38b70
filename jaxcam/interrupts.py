"""How a command is stopped: the first Ctrl-C or SIGTERM asks, the second ends.

A signal sets a flag, wherever it arrives: an exception raised inside a callback of somebody else's
can be lost. Loops look at the flag between their steps. Until a command begins its work, while it
reads its flags and imports what runs it, a signal ends it at once.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType


class Stopped(KeyboardInterrupt):
    """A command ends because it was asked to.

    Attributes:
        exit_code: What a shell expects of it: 130 or 143.
    """

    def __init__(self, exit_code: int) -> None:
        super().__init__("stopped by a signal")
        self.exit_code = exit_code


class Interrupt:
    """Whether the user or the cluster asked to stop."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def __bool__(self) -> bool:
        return self.signal is not None

    @property
    def exit_code(self) -> int:
        """What a shell expects of a process that stopped for this signal: 130 or 143."""
        return 128 + self.signal if self.signal is not None else 0


def _end(number: int, frame: FrameType | None) -> None:
    """Ends the process with a line: what an exception would pass through is not ours."""
    with contextlib.suppress(OSError):
        os.write(2, b"\nStopped; nothing was begun.\n")
    os._exit(128 + number)


@contextlib.contextmanager
def ends_at_once() -> Iterator[None]:
    """Has a SIGINT or SIGTERM end the process with a line, where nothing is begun yet."""
    before = {s: signal.signal(s, _end) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def end_commands_at_once() -> None:
    """Does what `ends_at_once` does from now on, if this process is a command of jaxcam.

    It is for `jaxcam/__init__.py`, which is imported before anything that takes time. In a program
    that imports jaxcam nothing happens.
    """
    words = sys.orig_argv
    module = words[words.index("-m") + 1 :][:1] if sys.argv[:1] == ["-m"] else [""]
    script = os.path.basename(sys.argv[0]) if sys.argv else ""  # pathlib would take its time
    is_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_default and (script == "jaxcam" or module[0].partition(".")[0] == "jaxcam"):
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _end)


_innermost: list[Interrupt | None] = []


@contextlib.contextmanager
def interrupts(
    first: str = "Stopping; once more stops now.", *, raises: bool = True
) -> Iterator[Interrupt]:
    """Turn the first SIGINT or SIGTERM into a flag; the second ends the process at once.

    Blocks may be nested; a signal sets the flag of the innermost, and an outer one does not know.

    Args:
        first: What the first signal is answered with.
        raises: Whether `check_stop` heeds the flag; else only who has it looks at it.

    Yields:
        The flag, false until a signal arrives. Whoever begins the block looks at it between steps,
        or has `check_stop` do so.
    """
    interrupt = Interrupt()
    answer = f"\n{first}\n".encode()

    def handle(number: int, stack: FrameType | None) -> None:
        if interrupt:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        interrupt.signal = signal.Signals(number)
        # Not print: a signal may arrive inside one, and buffered files refuse to be re-entered.
        with contextlib.suppress(OSError):
            os.write(2, answer)

    before = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    _innermost.append(interrupt if raises else None)
    try:
        yield interrupt
    finally:
        _innermost.pop()
        for number, handler in before.items():
            signal.signal(number, handler)


def check_stop() -> None:
    """Ends what runs if a signal asked for it, for loops between steps that are whole.

    Raises:
        Stopped: A signal arrived in the innermost block.
    """
    if _innermost and (interrupt := _innermost[-1]):
        raise Stopped(interrupt.exit_code)


def serve_parent() -> None:
    """Has this process, a worker of a pool, leave Ctrl-C to its parent, and end when that ends.

    A pool's workers hold both ends of the queue that they read, so they wait for ever where their
    parent was killed.
    """
    import multiprocessing  # a worker has it already; every command would wait for it

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := multiprocessing.parent_process()) is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()
