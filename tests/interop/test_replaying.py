"""The command that replays, and its exit code."""

from running import exit_code

from jaxcam.data.demos import read_demos
from jaxcam.data.writer import DemoWriter


def test_the_command_tells_and_fails_below_the_gate(tmp_path, demos, spoilt, capsys):
    path = tmp_path / "spoilt.hdf5"
    with DemoWriter(path, demos.header) as writer:
        for i, demo in enumerate(spoilt):
            writer.append(i, demo)
        writer.finish()
    assert len(read_demos(path).train) == len(demos.train)
    assert exit_code("replay", path, "--action-space", "joint_abs") == 1
    printed = capsys.readouterr().out
    assert "joint_abs" in printed
    assert "eef_delta" not in printed
    assert "demo_1" in printed
    assert f"{len(spoilt) - 1} of {len(spoilt)}" in printed
    assert exit_code("replay", demos.path) == 0
    assert "100.0%" in capsys.readouterr().out
    assert exit_code("replay", path, "--action-space", "joint_bas") == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert "mean 'joint_abs'" in printed
