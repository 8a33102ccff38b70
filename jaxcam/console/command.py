"""A command: its settings are parsed first, then what runs it is imported.

So `--help` and bad flags are answered at once, and nothing else has to think of that.
"""

import contextlib
import errno
import gc
import io
import logging
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rich.logging import RichHandler
from rich.panel import Panel

from jaxcam.config.flags import parse
from jaxcam.console.terminal import PlainFormatter, Terminal
from jaxcam.errors import ConfigError, JaxcamError, MachineError
from jaxcam.interrupts import Interrupt, Stopped, ends_at_once, interrupts

_ADVICE = {
    errno.EACCES: "Get permission, or choose another place",
    errno.EPERM: "Get permission, or choose another place",
    errno.EROFS: "Choose a place that can be written",
    errno.ENOSPC: "Make room, and run the same command again",
    errno.EDQUOT: "Make room, and run the same command again",
    errno.EFBIG: "Raise the limit on the size of files, and run the same command again",
    errno.ENAMETOOLONG: "Choose a shorter name",
    errno.ENOENT: "It was moved or deleted, or never was: check the path",
    errno.ELOOP: "It is a link that leads to itself",
    errno.EMFILE: "Raise the limit on open files (ulimit -n)",
}
"""What may help, by the kind of error."""
_RARELY = (100_000, 20, 20)
"""When the garbage collector looks through young and older objects. What is imported and traced is
hundreds of thousands of objects that stay; by its own thresholds it takes a fifth of the start."""


@dataclass(frozen=True)
class CommandLine:
    """One command of jaxcam.

    Attributes:
        settings: Record of settings that its flags are made of.
        main: What runs it, "module:function", which takes the settings and a console and returns
            an exit code or None. The module is imported when the flags are known to be good.
    """

    settings: type
    main: str

    def run(self, argv: Sequence[str] | None = None, prog: str | None = None) -> None:
        """Run the command and end the process with its exit code.

        A `JaxcamError` becomes a message and its exit code, and so does what the machine refuses:
        a file, room, rights, memory, a device. Other exceptions are bugs and keep their traceback.
        The first Ctrl-C or SIGTERM asks the command to stop, see `jaxcam.interrupts`; before it
        has begun, it ends at once.

        Args:
            argv: Flags; those of the process when None.
            prog: The command as it was typed, for `--help`; None is `python -m MODULE`.

        Raises:
            SystemExit: Always; 0, the error's exit code, or 130 or 143 after a signal.
        """
        gc.set_threshold(*_RARELY)
        if prog is None and (spec := sys.modules["__main__"].__spec__):
            prog = f"python -m {spec.name}"
        for stream in (sys.stdout, sys.stderr):  # names of files may be no text
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        try:
            with ends_at_once(), reader_may_leave():
                config: Any = parse(self.settings, argv, prog)
        except ConfigError as error:
            sys.exit(print_error(error))
        console = Terminal()
        handler = RichHandler(console=console)
        handler.setFormatter(PlainFormatter("%(message)s"))
        logging.basicConfig(level=logging.WARNING, handlers=[handler])
        sys.exit(self._main(config, console))

    def _main(self, config: Any, console: Terminal) -> int | None:
        """Runs what the settings ask for; the process's exit code."""
        module, _, function = self.main.partition(":")
        stop = Interrupt()
        try:
            with ends_at_once():
                main = getattr(import_module(module), function)
            with interrupts() as stop:
                return main(config, console)
        except KeyboardInterrupt as error:
            return _stopped(error.exit_code if isinstance(error, Stopped) else 130)
        except Exception as error:
            if stop:  # what it asked for has been stopped too, or cannot be had any more
                return _stopped(stop.exit_code)
            if isinstance(error, JaxcamError):
                return print_error(error)
            if (refused := _refused(error)) is None:
                raise
            return print_error(refused)


@contextlib.contextmanager
def reader_may_leave() -> Iterator[None]:
    """Ends the process quietly when who reads what it prints has gone, as `| head` does.

    What rich prints needs no such care.

    Raises:
        SystemExit: The reader has gone; 141, as for a process that SIGPIPE ended.
    """
    try:
        try:
            yield
        finally:
            sys.stdout.flush()  # here, and not when the interpreter ends
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(128 + signal.SIGPIPE) from None


def _stopped(exit_code: int) -> int:
    sys.stderr.write(
        "Stopped. What is done is kept; the same command goes on with it, or begins anew where it "
        "writes a file in one go.\n"
    )
    return exit_code


def _refused(error: Exception) -> MachineError | None:
    """What the machine refused, in words; None for other errors, which are bugs."""
    if isinstance(error, OSError):
        where = "".join(f" {name}:" for name in (error.filename, error.filename2) if name)
        advice = _ADVICE.get(error.errno or 0, "Look whether it is there and may be used")
        return MachineError(f"{where} {error.strerror or error}. {advice}.".strip())
    if isinstance(error, MemoryError):
        return MachineError(f"The memory does not suffice ({error}). Ask for less at once.")
    if isinstance(error, ImportError):
        return MachineError(f"A package cannot be loaded: {error}. Install jaxcam anew.")
    if isinstance(error, RuntimeError) and "nable to initialize backend" in str(error):
        brief = str(error).splitlines()[0][:300]
        platforms = os.environ.get("JAX_PLATFORMS", "")
        return MachineError(
            f"JAX has no device: {brief} JAX_PLATFORMS is {platforms!r}; unset it, or see "
            "python -m jaxcam.check --env."
        )
    return None


def print_error(error: JaxcamError) -> int:
    """Print an error for people.

    Args:
        error: What happened.

    Returns:
        The process's exit code.
    """
    panel = Panel(str(error), title=type(error).__name__, title_align="left", border_style="red")
    Terminal(stderr=True).print(panel)
    return error.exit_code
