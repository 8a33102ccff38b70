"""`jaxcam COMMAND …`, or `python -m jaxcam COMMAND …`: all commands in one table."""

import sys
from importlib import import_module

from rich.table import Table
from rich.text import Text

from jaxcam.console.command import CommandLine, print_error, reader_may_leave
from jaxcam.console.terminal import Terminal
from jaxcam.errors import ConfigError, closest

NAMES = (
    "train",
    "evaluate",
    "serve",
    "collect",
    "replay",
    "report",
    "sweep",
    "check",
    "view",
    "calibrate",
    "trial",
    "weights",
    "robomimic",
    "maniskill",
    "lerobot",
)


def command(name: str) -> tuple[CommandLine, str]:
    """The command of that name, `jaxcam/<name>.py`, and a line on what it does.

    Raises:
        ConfigError: There is none; the message names the closest.
    """
    if name not in NAMES:
        raise ConfigError(f"Unknown command {name!r}{closest(name, NAMES)}")
    module = import_module(f"jaxcam.{name}")
    return module.COMMAND, (module.__doc__ or "").partition(": ")[2].strip()


def print_commands() -> None:
    """Print all commands, a line each."""
    table = Table(box=None, show_header=False, padding=(0, 2))
    for name in NAMES:
        table.add_row(Text(name, "bold"), Text(command(name)[1]))
    console = Terminal()
    console.print("jaxcam COMMAND …: robot policies that know where the camera is.\n")
    console.print(table)
    console.print("\njaxcam COMMAND --help lists its flags; python -m jaxcam.COMMAND is the same.")


def main() -> None:
    """The command line."""
    name, *rest = sys.argv[1:] or ["--help"]
    if name in ("-h", "--help"):
        with reader_may_leave():
            print_commands()
        return
    try:
        chosen, _ = command(name)
    except ConfigError as error:
        sys.exit(print_error(error))
    chosen.run(rest, prog=f"jaxcam {name}")


if __name__ == "__main__":
    main()
