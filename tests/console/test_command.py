"""How a command ends: exit codes, messages, signals."""

import contextlib
import errno
import gc
import signal
import sys

import pytest

from jaxcam import errors
from jaxcam.config.commands import SweepConfig
from jaxcam.console.command import CommandLine
from jaxcam.console.progress import progress


@pytest.fixture
def run(monkeypatch):
    """Runs a command whose main is the given function."""

    def run(main):
        monkeypatch.setattr(sys.modules[__name__], "main", main, raising=False)
        monkeypatch.setitem(sys.modules, "ends", sys.modules[__name__])
        CommandLine(SweepConfig, "ends:main").run(["grid.yaml"], prog="jaxcam sweep")

    return run


@pytest.mark.parametrize(
    ("kind", "code"),
    [
        ("ConfigError", 2),
        ("CameraError", 3),
        ("DatasetError", 3),
        ("CheckpointError", 4),
        ("SimError", 5),
        ("DivergedError", 6),
        ("MachineError", 7),
        ("JaxcamError", 1),
    ],
)
def test_exit_codes_and_clean_messages(kind, code, run, capsys):
    def main(config, console):
        raise getattr(errors, kind)("camera[0]: what is [bold]wrong[/bold]")

    with pytest.raises(SystemExit) as stopped:
        run(main)
    assert stopped.value.code == code
    shown = capsys.readouterr().err
    assert kind in shown
    assert "camera[0]: what is [bold]wrong[/bold]" in shown
    assert "Traceback" not in shown


def test_the_garbage_collector_looks_rarely(run):
    before = gc.get_threshold()
    try:
        with pytest.raises(SystemExit) as stopped:
            run(lambda config, console: gc.get_threshold()[0] // 1000)
    finally:
        gc.set_threshold(*before)
    assert stopped.value.code >= 50


@pytest.mark.parametrize(("answer", "code"), [(None, None), (0, 0), (1, 1)])
def test_a_main_gives_the_exit_code(answer, code, run):
    with pytest.raises(SystemExit) as stopped:
        run(lambda config, console: answer)
    assert stopped.value.code == code


def test_bugs_keep_their_traceback_and_ctrl_c_is_130(run):
    with pytest.raises(ZeroDivisionError):
        run(lambda config, console: 1 // 0)

    def interrupted(config, console):
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as stopped:
        run(interrupted)
    assert stopped.value.code == 130


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(errno.EACCES, "Permission denied", "/x/[y]"), "Get permission"),
        (OSError(errno.ENAMETOOLONG, "File name too long", "n" * 300), "shorter name"),
        (OSError("Unable to synchronously open file"), "Unable to synchronously open file"),
        (MemoryError("9 GiB"), "9 GiB"),
        (ImportError("No module named mujoco"), "mujoco"),
        (RuntimeError("Unable to initialize backend 'nonsense'"), "'nonsense'"),
    ],
)
def test_what_the_machine_refuses_is_an_error(error, words, run, capsys):
    def main(config, console):
        raise error

    with pytest.raises(SystemExit) as stopped:
        run(main)
    assert stopped.value.code == 7
    shown = capsys.readouterr().err
    assert words in shown
    assert "Traceback" not in shown


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("loses", [False, True])
def test_a_signal_is_heeded_between_steps(number, code, loses, run, capfd):
    """Also one that arrives where exceptions are lost, as in a callback of a garbage collector."""
    steps = []

    def main(config, console):
        with progress(None, "collecting", 9) as advance:
            for step in range(9):
                steps.append(step)
                if step == 3 and loses:
                    with contextlib.suppress(BaseException):
                        signal.raise_signal(number)
                elif step == 3:
                    signal.raise_signal(number)
                steps.append("whole")
                advance()

    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as stopped:
        run(main)
    assert stopped.value.code == code
    assert steps[-2:] == [3, "whole"]
    assert "What is done is kept" in capfd.readouterr().err
    assert signal.getsignal(number) is before


def test_what_breaks_since_a_signal_stopped_it_is_no_error(run, capfd):
    def main(config, console):
        signal.raise_signal(signal.SIGINT)
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    with pytest.raises(SystemExit) as stopped:
        run(main)
    assert stopped.value.code == 130
