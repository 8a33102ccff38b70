"""Commands, run in this process."""

from importlib import import_module

import pytest


def exit_code(name, *argv):
    """Runs `jaxcam NAME ARGV…` and returns its exit code."""
    with pytest.raises(SystemExit) as ended:
        import_module(f"jaxcam.{name}").COMMAND.run([*map(str, argv)], prog=f"jaxcam {name}")
    return ended.value.code or 0
