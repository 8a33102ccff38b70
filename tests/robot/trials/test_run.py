"""A whole trial on the simulated robot, over the socket; what ends it, and what goes on with it."""

import contextlib
import io
import json
import os
from pathlib import Path

import pytest
import yaml
from policy_servers import answering, socket_server
from rehearsal import METADATA, lifter, rester, small_cameras
from rich.console import Console
from served_runs import opened, serving, untrained_run
from web_page import Page

from jaxcam.config.commands import TrialConfig
from jaxcam.errors import ConfigError, DatasetError, PortError
from jaxcam.files.locks import NamedLock
from jaxcam.robot.trials.order import letters, rollouts
from jaxcam.robot.trials.rows import done, read_trial_rows
from jaxcam.robot.trials.run import main
from jaxcam.robot.trials.sheet import read_sheet

LIFTS, RESTS = "Knows where the cube is", "Rests"


def sheet_for(folder, urls, **changes):
    content = {
        "task": "Lift",
        "success": "It is lifted.",
        "half": "It was raised.",
        "policies": [{"name": LIFTS, "url": urls[0]}, {"name": RESTS, "url": urls[1]}],
        "robot": "jaxcam.robot.simulated:SimulatedLift",
        "robot_settings": {"speed": 0},
        "cameras": {
            "names": ["first", "second", "third"],
            "use": 2,
            "file": "cameras.json",
            "placements": ["1", "2"],
        },
        "starts": ["Where it is put."],
        "prompt": "Lift the cube",
        "seconds": 3.2,
    } | changes
    path = Path(folder) / "sheet.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@contextlib.contextmanager
def typed(text, monkeypatch):
    """A program at the operator's keyboard; gives what was printed."""
    reader, writer = os.pipe()
    os.write(writer, text.encode())
    os.close(writer)
    printed = io.StringIO()
    with os.fdopen(reader) as stream:
        monkeypatch.setattr("sys.stdin", stream)
        yield Console(file=printed, width=200), printed


def run(path, text, monkeypatch, **flags):
    with typed(text, monkeypatch) as (console, printed):
        code = main(TrialConfig((str(path),), **flags), console)
    return code, printed.getvalue()


@pytest.fixture
def servers(lift):
    """Two servers, and the requests that came."""
    requests = []
    lifting = lifter(lift, lift.scene("randomized"))

    def seen_by(act):
        def kept(observation):
            requests.append(observation)
            return act(observation)

        return answering(METADATA, kept)

    with socket_server(seen_by(lifting)) as one, socket_server(seen_by(rester)) as two:
        yield (one, two), requests


def test_a_whole_sheet_without_a_robot(tmp_path, servers, monkeypatch):
    """12 rollouts: two placements, two of three cameras, two policies. It is stopped and goes on;
    the operator agrees with the simulator, but for one rollout that is run again."""
    small_cameras(tmp_path)
    urls, requests = servers
    path = sheet_for(tmp_path, urls)
    enter = "\n\n"
    code, first = run(path, enter + "\nr cup fell\n" + enter + "q\n", monkeypatch)
    assert (code, "Stopped. What was rated is kept" in first) == (0, True)
    folder = tmp_path / "sheet.trial"
    assert not (folder / "report.html").exists()
    code, second = run(path, enter * 10, monkeypatch)
    assert "All is done" in second
    for name in (LIFTS, RESTS, *urls):
        assert name not in first + second  # blinded
    planned = rollouts(read_sheet(path))
    rows = read_trial_rows(folder / "rows.jsonl", planned)
    assert [row.outcome for row in rows].count("redo") == 1
    assert [row.number for row in rows] == [1, 2, 2, *range(3, 13)]
    of_lifter = letters(read_sheet(path))[0]
    for row in done(rows).values():
        assert row.outcome == ("success" if row.policy == of_lifter else "failure")
        assert "actions" in row.lateness
        assert row.calibration.keys() == set(row.cameras)
    page = Page(folder / "report.html")
    assert LIFTS in page.text
    assert "100 % [" in page.text
    assert "+100 [" in page.text
    assert "cup fell" in page.text
    names = {name for request in requests for name in request}
    assert names == {
        "observation.images.view_0", "observation.images.view_1", "observation.state", "prompt",
        *(f"camera.view_{i}.{part}" for i in (0, 1) for part in ("intrinsics", "base_from_camera")),
    }  # fmt: skip


def test_policies_of_ours_are_tried_over_their_own_server(tmp_path, monkeypatch):
    """Never trained, so what they do is nothing; but all that is sent and answered is real."""
    small_cameras(tmp_path)
    run_folder = untrained_run(
        tmp_path / "run", views=2, conditioning="late", action_space="eef_delta"
    )
    service = opened(run_folder)
    with serving(service) as one, serving(service) as two:
        cameras = yaml.safe_load(sheet_for(tmp_path, (one, two)).read_text())["cameras"]
        cameras["placements"] = ["5"]
        path = sheet_for(tmp_path, (one, two), cameras=cameras, seconds=0.5)
        _, printed = run(path, "\nf\n" * 6, monkeypatch)
    assert "All is done" in printed
    rows = read_trial_rows(tmp_path / "sheet.trial" / "rows.jsonl", rollouts(read_sheet(path)))
    assert len(rows) == 6
    for row in rows:
        assert row.fault == ""
        assert row.lateness.startswith("10 actions, 0 steps held, 0 late")
        assert row.weights_sha == service.candidate.weights_sha


def test_the_order_is_printed_without_names(tmp_path, monkeypatch):
    path = sheet_for(tmp_path, ("ws://x:1", "ws://x:2"))
    _, printed = run(path, "", monkeypatch, list=True)
    assert len(printed.splitlines()) == 12
    assert LIFTS not in printed
    assert not (tmp_path / "sheet.trial").exists()


def test_a_report_on_what_there_is(tmp_path, monkeypatch):
    path = sheet_for(tmp_path, ("ws://x:1", "ws://x:2"))
    run(path, "", monkeypatch, report=True)
    assert "12 of 12 rollouts are missing" in Page(tmp_path / "sheet.trial" / "report.html").text
    other = tmp_path / "other"
    other.mkdir()
    second = sheet_for(other, ("ws://x:1", "ws://x:2"), task="Hang Mug")
    with typed("", monkeypatch) as (console, _):
        config = TrialConfig((str(path), str(second)), report=True, out=str(tmp_path / "both"))
        assert main(config, console) == 0
    assert "Lift, Hang Mug" in Page(tmp_path / "both" / "report.html").text


def test_a_sheet_that_changed_is_refused_but_for_what_may(tmp_path, servers, monkeypatch):
    small_cameras(tmp_path)
    urls, _ = servers
    run(sheet_for(tmp_path, urls), "q\n", monkeypatch)
    with pytest.raises(ConfigError, match=r'half: "It was raised." then, "Moved." now'):
        run(sheet_for(tmp_path, urls, half="Moved."), "q\n", monkeypatch)
    code, _ = run(sheet_for(tmp_path, urls, robot_settings={"speed": 3}), "q\n", monkeypatch)
    assert code == 0


def test_two_trials_of_one_sheet(tmp_path, servers, monkeypatch):
    small_cameras(tmp_path)
    folder = tmp_path / "sheet.trial"
    folder.mkdir()
    lock = NamedLock(folder / "lock")
    lock.take()
    with pytest.raises(ConfigError, match=f"going on: pid {os.getpid()} on"):
        run(sheet_for(tmp_path, servers[0]), "q\n", monkeypatch)
    lock.free()


def test_rows_that_are_damaged_or_of_another_trial(tmp_path, servers, monkeypatch):
    small_cameras(tmp_path)
    path = sheet_for(tmp_path, servers[0])
    rows = tmp_path / "sheet.trial" / "rows.jsonl"
    rows.parent.mkdir()
    rows.write_text("{}\n")
    with pytest.raises(DatasetError, match=r"rows\.jsonl, line 1 has no 'number'"):
        run(path, "", monkeypatch)
    row = {"number": 1, "policy": "Z", "placement": "1", "cameras": [], "start": 0}
    rows.write_text(json.dumps(row | {"outcome": "half"}) + "\n")
    with pytest.raises(DatasetError, match="rollout 1 is policy"):
        run(path, "", monkeypatch)
    rows.write_text(json.dumps(row | {"outcome": "hlaf"}) + "\n")
    with pytest.raises(DatasetError, match="did you mean 'half'"):
        run(path, "", monkeypatch)


@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        ({"names": ["first", "secnd"]}, "no view 'secnd', did you mean 'second'"),
        ({"file": "none.json"}, r"none\.json: no such file"),
    ],
)
def test_cameras_that_nobody_calibrated(tmp_path, servers, monkeypatch, cameras, words):
    small_cameras(tmp_path)
    content = yaml.safe_load(sheet_for(tmp_path, servers[0]).read_text())
    path = sheet_for(tmp_path, servers[0], cameras=content["cameras"] | cameras)
    with pytest.raises((ConfigError, DatasetError), match=words):
        run(path, "", monkeypatch)


def test_a_placement_that_is_not_calibrated_yet_is_waited_for(tmp_path, servers, monkeypatch):
    small_cameras(tmp_path)
    content = yaml.safe_load(sheet_for(tmp_path, servers[0]).read_text())
    cameras = content["cameras"] | {"placements": ["8"]}
    path = sheet_for(tmp_path, servers[0], cameras=cameras)
    _, printed = run(path, "\n\nq\n", monkeypatch)
    assert printed.count("no placement '8' among its episodes") == 3
    assert "Calibrate the cameras, write it there" in printed


def test_starts_that_no_rollout_has_are_told(tmp_path, servers, monkeypatch):
    small_cameras(tmp_path)
    starts = [f"On mark {i}." for i in range(9)]  # and three choices in each of two placements
    path = sheet_for(tmp_path, servers[0], starts=starts)
    assert "Note: 3 of 9 starts are in no rollout" in run(path, "q\n", monkeypatch)[1]


def test_a_server_that_is_not_there(tmp_path, monkeypatch):
    small_cameras(tmp_path)
    monkeypatch.setattr("jaxcam.robot.trials.policies.PATIENCE", 0.0)
    with socket_server(answering(METADATA, rester)) as url:
        path = sheet_for(tmp_path, (url, "ws://127.0.0.1:1"))
        with pytest.raises(PortError, match=f"Policy '{RESTS}' of the sheet: No policy server"):
            run(path, "", monkeypatch)
