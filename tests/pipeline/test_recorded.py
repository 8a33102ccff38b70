"""Policies that learn from recorded datasets: trained, resumed, judged and reported."""

import dataclasses

import numpy as np
import pytest
import robots

from jaxcam.checks.run import check_run
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.models import PolicySpec
from jaxcam.pipeline.sources import source_of
from jaxcam.pipeline.train import policy_of, train
from jaxcam.runs.action_errors import read_errors
from jaxcam.runs.identity import default_folder, differences, read_config, resolve
from jaxcam.runs.interface import Interface, read_interface
from jaxcam.runs.metrics import read_metrics

SMALL = {
    "steps": 4, "batch": 4, "warmup": 1, "resolution": 24, "preset": "laptop", "validation": 1,
    "model": ("width=16", "hidden=16", "chunk=4", "encoder_width=8", "keypoints=4"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder that is read as a robot's: the readers of formats have tests of their own."""
    place = tmp_path / "cups"
    place.mkdir()
    made = {
        "recording": robots.recording(place, views=("front", "side", "wrist"), moving=("wrist",))
    }
    monkeypatch.setattr("jaxcam.pipeline.recorded.read_recording", lambda *_: made["recording"])
    return place, made


def settings(folder, **changes):
    place, _ = folder
    own = {"dataset": str(place), "data_dir": str(place.parent / "data"),
           "run_dir": str(place.parent / "run")}  # fmt: skip
    return TrainConfig(**{**SMALL, **own, **changes})


def test_a_run_is_trained_resumed_and_reported(folder, monkeypatch):
    spaces = {"action_is": "joint_abs", "action_space": "joint_delta"}
    config = settings(folder, hold_out_view=("wrist",), save_every=2, eval_every=2, **spaces)
    assert train(config) == 0
    run = folder[0].parent / "run"
    stored = read_config(run)
    assert (stored.task, stored.action_space) == ("recorded", "joint_delta")
    assert (stored.demos, stored.validation, stored.views) == (3, 1, 2)
    assert stored.resolution == "24x32"
    recording = folder[1]["recording"]
    assert read_interface(run, stored, PolicySpec(5, 5, 2, 24, 32, 4)) == Interface(
        ("front", "side"), recording.state_names, recording.action_names, 10.0, "Stack the cups."
    )
    rows = read_errors(run)
    assert [(row.group, row.rotation_deg) for row in rows] == [
        ("new episodes", 0), ("new episodes", 5), ("new cameras", 0), ("new cameras", 5),
    ]  # fmt: skip
    assert rows[0].errors.shape == (1, 4, 5)
    assert not np.array_equal(rows[0].errors, rows[1].errors)
    page = (run / "report.html").read_text()
    assert "recorded dataset cups" in page
    assert "new cameras" in page
    losses = [row.get("val_loss") for row in read_metrics(run)]
    assert all(np.isfinite(x) for x in losses if x is not None)
    monkeypatch.setattr("jaxcam.checks.run.read_recording", lambda *_: folder[1]["recording"])
    judged = {finding.what: (finding.mark, finding.got) for finding in check_run(run)}
    assert {mark for mark, _ in judged.values()} == {"good"}
    assert judged["evaluation"][1] == "errors of actions at step 4"
    assert train(config) == 0  # nothing is left to be done
    assert len(read_errors(run)) == len(rows)


def test_what_does_not_go_with_recorded_data_is_refused(folder):
    source = source_of(settings(folder))
    for changes, words in [
        ({"scene": "fixed"}, "--scene is for tasks that are simulated"),
        ({"ensemble": 0.01}, "--ensemble is for tasks that are simulated"),
        ({"engine": "native"}, "--engine is for tasks that are simulated"),
        ({"n": 4}, "--n is for cameras that are simulated"),
        ({"hold_out_view": ("wirst",)}, "did you mean 'wrist'"),
        ({"views": 4}, "Give --views 3"),
        ({"grip": "state[0:2]"}, "three columns"),
        ({"grip": "observation.state[3:6]"}, "three columns"),
    ]:
        with pytest.raises(ConfigError, match=words):
            source.complete(settings(folder, **changes))
    with pytest.raises(ConfigError, match="say it with --action-is"):
        source_of(settings(folder, action_space="eef_abs"))
    with pytest.raises(ConfigError, match="leave --task push out"):
        source_of(settings(folder, task="push"))
    with pytest.raises(ConfigError, match="needs the folder of a recorded dataset"):
        source_of(TrainConfig(task="recorded"))
    for changes, flag in [
        ({"cameras": "cameras.json"}, "--cameras"),
        ({"grip": "state[0:3]"}, "--grip"),
        ({"action_is": "eef_abs"}, "--action-is"),
        ({"hold_out_view": ("front",)}, "--hold-out-view"),
        ({"hold_out_episodes": (3,)}, "--hold-out-episodes"),
    ]:
        with pytest.raises(ConfigError, match=f"{flag} is for recorded datasets"):
            train(TrainConfig(**changes))


def test_actions_become_what_is_asked_for(folder):
    config = settings(folder, action_is="joint_abs", action_space="joint_delta")
    source = source_of(config)
    completed = resolve(source.complete(config), accelerator=False)
    assert (completed.action_space, completed.action_is) == ("joint_delta", "joint_abs")
    recorded = folder[1]["recording"].episodes[0].action
    moves = source.recording.episodes[0].action
    np.testing.assert_allclose(moves[1:, :4], np.diff(recorded[:, :4], axis=0), atol=1e-6)
    assert source_of(completed).recording.fingerprint == source.recording.fingerprint
    assert "-joint_delta-3views-" in default_folder(completed)
    other = dataclasses.replace(completed, action_is="eef_abs")
    (change,) = differences(completed, other)
    assert (str(change), change.changes_program) == ("action_is: 'joint_abs' -> 'eef_abs'", True)
    native = dataclasses.replace(completed, action_space="native")
    (change,) = differences(native, dataclasses.replace(other, action_space="native"))
    assert not change.changes_program


def test_each_episode_keeps_its_instruction(folder):
    recording = folder[1]["recording"]
    other = dataclasses.replace(recording.episodes[1], instruction="Unstack them.")
    recording.episodes[1] = other
    config = settings(folder, policy="smolvla", preset="tiny", model=(), hold_out_episodes=(0,))
    source = source_of(config)
    assert source.prompts == ("Stack the cups.", "Unstack them.")
    completed = resolve(source.complete(config), accelerator=False)
    with pytest.raises(ConfigError, match="has 2 instructions"):
        policy_of(source, completed)  # whose preset has the tokens of one
    reads_none = settings(folder, hold_out_episodes=(0,))
    completed = resolve(source.complete(reads_none), accelerator=False)
    data = source.dataset([completed], None)
    asked = data.batch(np.arange(4), np.zeros(4, int), np.zeros((4, 1), int), 2)["instruction"]
    names = [recording.episodes[part.episode].instruction for part in source.parts(completed).all]
    assert [source.prompts[i] for i in asked] == names
    assert names.count("Unstack them.") == 1


def test_cameras_that_nobody_calibrated(folder):
    _, made = folder
    episode = made["recording"].episodes[2]
    episode.sights["side"] = dataclasses.replace(episode.sights["side"], calibration=None)
    with pytest.raises(DatasetError, match=r"side \(in 1 of 4 episodes\): K and its pose"):
        source_of(settings(folder)).complete(settings(folder))
    hidden = settings(folder, conditioning="none")
    assert source_of(hidden).complete(hidden).views == 3


def test_the_grip_is_known_by_its_names_or_by_a_flag(folder):
    config = settings(folder)
    source = source_of(config)
    assert source.meaning(config).grip == (0, 1, 2)
    assert source.meaning(settings(folder, grip="observation.state[1:4]")).grip == (1, 2, 3)
    assert source.meaning(config).gripper == 4
    assert "keyframe_weight=0" not in source.complete(config).model
    object.__setattr__(folder[1]["recording"], "action_names", ("a", "b", "c", "d", "e"))
    assert "keyframe_weight=0" in source_of(config).complete(config).model
    off = settings(folder, model=("keyframe_weight=0",))
    assert source_of(off).complete(off).model == off.model
    on = settings(folder, model=("keyframe_weight=0.1",))
    with pytest.raises(ConfigError, match="needs to know where the grip is"):
        source_of(on).complete(on)
    taught = settings(folder, model=("heatmap_weight=1",))
    with pytest.raises(ConfigError, match="heatmap_weight is for tasks that are simulated"):
        source_of(taught).complete(taught)


def test_smolvla_takes_squares(folder):
    config = settings(folder, policy="smolvla", preset="tiny", model=())
    assert resolve(source_of(config).complete(config), accelerator=False).resolution == 24
