"""A command: its settings are parsed first, then what runs it is imported.

So `--help` and bad flags are answered at once, and nothing else has to think of that.
"""

import contextlib
import logging
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rich.console import Console
from rich.logging import RichHandler
from rich.panel import Panel
from rich.text import Text

from jaxcam.config.flags import parse
from jaxcam.errors import JaxcamError


@dataclass(frozen=True)
class Command:
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

        A `JaxcamError` becomes a message and its exit code; other exceptions are bugs and keep
        their traceback.

        Args:
            argv: Flags; those of the process when None.
            prog: The command as it was typed, for `--help`; None is `python -m MODULE`.

        Raises:
            SystemExit: Always; 0, the error's exit code, or 130 after Ctrl-C.
        """
        if prog is None and (spec := sys.modules["__main__"].__spec__):
            prog = f"python -m {spec.name}"
        with reader_may_leave():
            config: Any = parse(self.settings, argv, prog)
        module, _, function = self.main.partition(":")
        console = Console()
        logging.basicConfig(
            level=logging.WARNING, format="%(message)s", handlers=[RichHandler(console=console)]
        )
        try:
            sys.exit(getattr(import_module(module), function)(config, console))
        except JaxcamError as error:
            sys.exit(print_error(error))
        except KeyboardInterrupt:
            sys.exit(130)


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


def print_error(error: JaxcamError) -> int:
    """Print an error for people.

    Args:
        error: What happened.

    Returns:
        The process's exit code.
    """
    # Text, not str: "[0]" in a message is an index, not rich markup.
    panel = Panel(Text(str(error)), title=type(error).__name__, title_align="left",
                  border_style="red")  # fmt: skip
    Console(stderr=True).print(panel)
    return error.exit_code
