"""How a run is stopped: the first Ctrl-C asks, the second ends."""

import contextlib
import os
import signal
from collections.abc import Iterator
from types import FrameType


class Interrupt:
    """Whether the user or the cluster asked the run to stop."""

    def __init__(self) -> None:
        self.signal: signal.Signals | None = None

    def __bool__(self) -> bool:
        return self.signal is not None

    @property
    def exit_code(self) -> int:
        """What a shell expects of a process that stopped for this signal: 130 or 143."""
        return 128 + self.signal if self.signal is not None else 0


@contextlib.contextmanager
def interrupts() -> Iterator[Interrupt]:
    """Turn the first SIGINT or SIGTERM into a flag; the second ends the process at once.

    Yields:
        The flag, false until a signal arrives. The trainer looks at it between updates, saves,
        and says how to go on.
    """
    interrupt = Interrupt()

    def handle(number: int, frame: FrameType | None) -> None:
        if interrupt:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        interrupt.signal = signal.Signals(number)
        # Not print: a signal may arrive inside one, and buffered files refuse to be re-entered.
        os.write(2, b"\nStopping after this update; once more stops now, without saving.\n")

    before = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
