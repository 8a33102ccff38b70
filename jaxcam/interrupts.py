"""How a command is stopped: the first Ctrl-C or SIGTERM asks, the second ends.

A signal sets a flag, wherever it arrives: an exception raised inside a callback of somebody else's
can be lost. Loops look at the flag between their steps.
"""

import contextlib
import os
import signal
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
