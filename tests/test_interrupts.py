"""How a run is stopped: once asks, twice ends it."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from places import REPO

from jaxcam.interrupts import Stopped, check_stop, interrupts


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_first_signal_is_a_flag(number, code, capfd):
    before = signal.getsignal(number)
    with interrupts() as interrupt:
        assert not interrupt
        assert interrupt.exit_code == 0
        signal.raise_signal(number)
        assert interrupt
        assert interrupt.exit_code == code
    assert signal.getsignal(number) is before
    assert "Stopping; once more stops now." in capfd.readouterr().err


def test_loops_are_stopped_by_the_innermost_block_that_does_not_look_itself():
    check_stop()
    with interrupts() as outer:
        with interrupts(raises=False) as inner:
            signal.raise_signal(signal.SIGTERM)
            check_stop()
            assert inner
        assert not outer
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(Stopped) as stopped:
            check_stop()
        assert stopped.value.exit_code == 143
    check_stop()


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
def test_second_signal_stops_at_once(second):
    script = textwrap.dedent("""
        import time
        from jaxcam.interrupts import interrupts
        with interrupts() as interrupt:
            print("ready", flush=True)
            while not interrupt: time.sleep(0.01)
            print("saving", flush=True)
            time.sleep(60)
    """)
    command = [sys.executable, "-c", script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == b"saving\n"
        process.send_signal(second)
        assert process.wait(10) == -second


STARTS = ["-m jaxcam.weights", "-m jaxcam.lerobot", "-m jaxcam"]


@pytest.fixture
def heeded():
    """Ctrl-C reaches new processes even if the tests run in the background, where it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("command", STARTS)
@pytest.mark.usefixtures("heeded")
def test_ctrl_c_while_a_command_starts_is_one_line(command, tmp_path):
    """Whatever is imported then: here a module that is slow and gives signals away."""
    (tmp_path / "tyro.py").write_text(SLOW)
    (tmp_path / "rich.py").write_text(SLOW)
    where = {**os.environ, "PYTHONPATH": f"{tmp_path}:{REPO}"}
    process = subprocess.Popen([sys.executable, *command.split()], env=where,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                               )  # fmt: skip
    with process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130
        assert process.stderr.read().strip() == b"Stopped; nothing was begun."


SLOW = """
import time
print("ready", flush=True)
try:
    time.sleep(60)
except BaseException:
    pass
"""


@pytest.mark.usefixtures("heeded")
def test_a_program_that_imports_jaxcam_keeps_its_signals():
    script = "import signal, jaxcam; print(signal.getsignal(2) is signal.default_int_handler)"
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.stdout == "True\n"


def test_signal_handlers_need_the_main_thread():
    caught = []

    def enter():
        try:
            with interrupts():
                pass
        except ValueError as error:
            caught.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert caught


POOL = """
import multiprocessing, os, time
from concurrent.futures import ProcessPoolExecutor
from jaxcam.interrupts import serve_parent

if __name__ == "__main__":
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), serve_parent) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60)
"""


def test_a_worker_does_not_outlive_a_parent_that_is_killed(tmp_path):
    (script := tmp_path / "pool.py").write_text(POOL)
    command = [sys.executable, script]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        os.kill(worker, signal.SIGINT)
        parent.kill()
    until = time.monotonic() + 20
    while os.path.exists(f"/proc/{worker}/stat") and time.monotonic() < until:
        time.sleep(0.05)
    assert not os.path.exists(f"/proc/{worker}/stat")
