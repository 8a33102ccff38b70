"""What the doctor says of this machine."""

import time

from running import exit_code

from jaxcam.checks import examine, machine
from jaxcam.checks.findings import bad


def test_folders_that_caches_cannot_be_written_to(monkeypatch, tmp_path):
    assert machine.check_host().mark == "good"
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "file" / "cache"))
    finding = machine.check_host()
    assert finding.mark == "bad"
    assert "WARP_CACHE_PATH" in finding.fix
    monkeypatch.setattr(machine.tempfile, "gettempdir", lambda: str(tmp_path / "file"))
    assert "TMPDIR" in machine.check_host().fix


def test_clock_and_file_names(monkeypatch):
    monkeypatch.setattr(machine.time, "localtime", lambda: time.gmtime(0))
    monkeypatch.setattr(machine.sys, "getfilesystemencoding", lambda: "ascii")
    finding = machine.check_host()
    assert "the clock says 1970" in finding.got
    assert "PYTHONUTF8=1" in finding.fix


def test_a_bad_machine_ends_with_1(monkeypatch, capsys):
    monkeypatch.setattr(examine, "check_env", lambda: iter([bad("host", got="no clock")]))
    assert exit_code("check", "--env") == 1
    assert "no clock" in capsys.readouterr().out
