"""Robomimic files of robosuite 1.4.1 and 1.5.2 (recorded: tests/golden/make_robomimic_lift.py)."""

import re
import subprocess
import sys
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest
from robomimic_files import EPISODES, VERSIONS, imported, of_many, recorded, write
from running import exit_code

from jaxcam.checks.examine import examine
from jaxcam.config.datasets import RobomimicConfig
from jaxcam.config.train import TrainConfig
from jaxcam.data.demos import starts_of
from jaxcam.data.pictures import Pictures
from jaxcam.data.samples import Layout
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.interop.robomimic import import_demos, success_of
from jaxcam.interop.robosuite_model import read_origin
from jaxcam.pipeline import like_its_dataset, train, training_data
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.runs.identity import resolve
from jaxcam.sim.actions import encode
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.types import Command

CUBE, CUBE_QUATERNION, CUBE_VELOCITY = slice(10, 13), slice(13, 17), slice(26, 29)
"""Columns of the recorded states: time, 7 + 2 joints, cube, then their velocities."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robomimic")
    return {v: write(folder / f"{v}.hdf5", recorded(v)) for v in VERSIONS}


@pytest.mark.parametrize("actions", ["commands", "states"])
@pytest.mark.parametrize("version", VERSIONS)
def test_real_episodes_succeed_as_recorded_and_replayed(files, version, actions):
    demos = imported(files[version], actions=actions, validation=1)
    assert (len(demos.train), len(demos.valid)) == (1, 1)
    recorded_success, replayed = success_of(demos)
    assert recorded_success.all()
    assert replayed.all()


@pytest.mark.parametrize("version", VERSIONS)
def test_replayed_commands_go_the_recorded_way(lift, files, version):
    for demo in imported(files[version], validation=0).train:
        scene = lift.scene("randomized")
        engine = NativeEngine(scene, varied=lift.varied)
        state = engine.reset(starts_of([demo]))
        apart = []
        for action, there in zip(demo.actions, demo.eef_pos[1:], strict=True):
            state = engine.step(state, Command(action[None, :6], action[None, 6]))
            apart.append(np.linalg.norm(state.grip_position[0] - there))
        assert max(apart) < 0.001


@pytest.mark.parametrize("version", VERSIONS)
def test_states_sizes_and_cameras_are_carried_over(lift, files, version):
    parts = recorded(version)
    demos = imported(files[version], n=2, m=1)
    scene = lift.scene("randomized")
    cube = scene.qpos_of("cube")
    for i, demo in enumerate(demos.train):
        states = parts[f"states_{i}"]
        assert demo.length == len(states) - 1
        np.testing.assert_array_equal(demo.states[:, 1:10], states[:, 1:10])  # arm and fingers
        np.testing.assert_allclose(demo.states[:, 1 + cube :][:, :3], states[:, CUBE], atol=1e-12)
        size = re.search(r'name="cube_g0"[^>]* size="([^"]*)"', str(parts[f"model_{i}"]))
        np.testing.assert_allclose(demo.geom_size[0], np.array(size[1].split(), float))
        assert demo.cameras.tolist() == [i, i + 1]
        assert set(demo.actions[:, 6]) == {-1.0, 1.0}
        assert demo.gripper[-1] == 1.0


def test_robosuite_14_keeps_the_orientation_where_no_rotation_is_asked(files):
    for i, demo in enumerate(imported(files["1.4"], validation=0).train):
        still = (recorded("1.4")[f"actions_{i}"][:-1, 3:6] == 0).all(-1)
        last = np.flatnonzero(~still)[-1]
        assert last < len(still) - 10
        kept = np.broadcast_to(demo.actions[last, 3:6], (len(still) - last, 3))
        np.testing.assert_array_equal(demo.actions[last:, 3:6], kept)


def turned(parts, version):
    """The recording in a world that is turned by 90 degrees and moved against it."""
    half = np.sqrt(0.5)
    shift = np.array([0.3, -0.2, 0.15])
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    moved = dict(parts)
    for i in range(EPISODES):
        xml = str(parts[f"model_{i}"])
        for body in ("robot0_base", "table"):
            tag = re.search(rf'<body name="{body}"[^>]*>', xml)[0]
            place = turn @ np.array(re.search(r'pos="([^"]*)"', tag)[1].split(), float) + shift
            new = re.sub(r' (pos|quat)="[^"]*"', "", tag)[:-1]
            new += f' pos="{place[0]} {place[1]} {place[2]}" quat="{half} 0 0 {half}">'
            xml = xml.replace(tag, new)
        states = parts[f"states_{i}"].copy()
        states[:, CUBE] = states[:, CUBE] @ turn.T + shift
        w, x, y, z = states[:, CUBE_QUATERNION].T
        states[:, CUBE_QUATERNION] = half * np.stack([w - z, x - y, x + y, w + z], -1)
        states[:, CUBE_VELOCITY] = states[:, CUBE_VELOCITY] @ turn.T
        actions = parts[f"actions_{i}"].copy()
        if version == "1.4":  # its actions are in the world's axes, 1.5's in the base's
            actions[:, :3], actions[:, 3:6] = actions[:, :3] @ turn.T, actions[:, 3:6] @ turn.T
        moved |= {f"model_{i}": xml, f"states_{i}": states, f"actions_{i}": actions}
    return moved


@pytest.mark.parametrize("version", VERSIONS)
def test_the_robots_base_may_stand_elsewhere(tmp_path, files, version):
    here = imported(files[version], validation=0)
    there = imported(
        write(tmp_path / "turned.hdf5", turned(recorded(version), version)), validation=0
    )
    for a, b in zip(here.train, there.train, strict=True):
        np.testing.assert_allclose(b.states, a.states, atol=1e-9)
        np.testing.assert_allclose(b.eef_pos, a.eef_pos, atol=1e-9)
        np.testing.assert_allclose(b.actions[:, :3], a.actions[:, :3], atol=1e-9)
        np.testing.assert_allclose(
            matrix_from_rotvec(b.actions[:, 3:6]), matrix_from_rotvec(a.actions[:, 3:6]), atol=1e-9
        )


@pytest.mark.parametrize("version", VERSIONS)
def test_absolute_actions_are_targets(tmp_path, lift, files, version):
    parts = recorded(version)
    configs = parts["env_args"]["env_kwargs"]["controller_configs"]
    arm = configs if version == "1.4" else configs["body_parts"]["right"]
    arm |= {"control_delta": False} if version == "1.4" else {"input_type": "absolute"}
    delta = imported(files[version], validation=0).train
    scene = lift.scene("randomized")
    for i in range(EPISODES):
        origin = read_origin(str(parts[f"model_{i}"]), parts[f"states_{i}"][0], scene, lift.varied)
        base = np.eye(4) if version == "1.4" else origin.theirs_from_controller
        goal = np.zeros((len(parts[f"states_{i}"]), 7))
        goal[:-1, :3] = (delta[i].actions[:, :3] - base[:3, 3]) @ base[:3, :3]
        rotation = base[:3, :3].T @ matrix_from_rotvec(delta[i].actions[:, 3:6])
        goal[:-1, 3:6] = rotvec_from_matrix(rotation)
        goal[:, 6] = parts[f"actions_{i}"][:, 6]
        parts[f"actions_{i}"] = goal
    for a, b in zip(
        delta, imported(write(tmp_path / "a.hdf5", parts), validation=0).train, strict=True
    ):
        np.testing.assert_allclose(b.actions, a.actions, atol=1e-9)
    assert version == "1.4" or base[2, 3] > 0.5  # the frame of 1.5's base is not the world's


def test_without_actions_the_fingers_tell_the_gripper(tmp_path, files):
    chosen = imported(files["1.5"], validation=0).train
    path = write(tmp_path / "states.hdf5", recorded("1.5"), leave_out=["actions"])
    for a, b in zip(chosen, imported(path, actions="states", validation=0).train, strict=True):
        closes = [int(np.argmax(d.actions[:, 6] > 0)) for d in (a, b)]
        assert 0 <= closes[1] - closes[0] <= 1
        assert (b.actions[closes[1] :, 6] == 1).all()
    with pytest.raises(DatasetError, match=r"demo_0: no 'actions'. Import with --actions states"):
        imported(path)


def change(parts, what):
    """A recording with one thing wrong."""
    env = parts["env_args"]
    kwargs = env["env_kwargs"]
    right = kwargs["controller_configs"]["body_parts"]["right"]
    model = str(parts["model_0"])
    if what in ("PickPlaceCan", "NutAssemblySquare", "Door"):
        env["env_name"] = what
    elif what == "control_freq":
        kwargs["control_freq"] = 10
    elif what == "joints":
        right["type"] = "JOINT_POSITION"
    elif what == "stiff":
        right["kp"] = [300] * 6
    elif what == "table":
        parts["model_0"] = model.replace('pos="0 0 0.775"', 'pos="0 0 0.725"')
        assert parts["model_0"] != model
    elif what == "arm":
        parts["model_0"] = model.replace('pos="0 -0.316 0"', 'pos="0 -0.366 0"')
        assert parts["model_0"] != model
    elif what == "robot":
        parts["model_0"] = model.replace("robot0_joint7", "robot0_right_j7")
    elif what == "xml":
        parts["model_0"] = model[:2000]
    elif what == "states":
        parts["states_0"] = parts["states_0"][:, :-2]
    elif what == "nan":
        parts["states_0"][3, 4] = np.nan
    elif what == "short":
        parts["actions_0"] = parts["actions_0"][:-3]
    return parts


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("PickPlaceCan", "PickPlaceCan cannot be replayed in our tasks: its can goes from one bin"),
        ("NutAssemblySquare", "NutAssemblySquare cannot be replayed .*its pegs are fixed"),
        ("Door", "demonstrations of Door, but task 'lift' was asked.*can be imported: Lift"),
        ("control_freq", "recorded at 10 control steps a second; ours take 20"),
        ("joints", r"type 'JOINT_POSITION' \(expected 'OSC_POSE'\). Import with --actions states"),
        ("stiff", r"kp \[300.*Import with --actions states"),
        ("table", r"demo_0: the table's top is -0.050 m off"),
        ("arm", r"demo_0: its gripper is 0.\d+ m from where"),
        ("robot", "demo_0: no joint 'robot0_joint7' in its model_file"),
        ("xml", "demo_0: model_file is no MJCF"),
        ("states", "demo_0: states of 30 numbers, but its model_file has 32"),
        ("nan", "demo_0: states .* finite numbers"),
        ("short", "demo_0: actions .* expected"),
    ],
)
def test_what_cannot_be_replayed_is_refused(tmp_path, what, message):
    path = write(tmp_path / "bad.hdf5", change(recorded("1.5"), what))
    with pytest.raises(DatasetError, match=f"(?s){re.escape(str(path))}: .*{message}"):
        imported(path)
    assert not (tmp_path / "out0.hdf5").exists()


def test_other_task_is_named(files):
    with pytest.raises(DatasetError, match=r"demonstrations of Lift.*Import it with --task lift"):
        imported(files["1.5"], task="square")


@pytest.mark.parametrize("missing", ["states", "model_file"])
def test_missing_parts_are_named(tmp_path, missing):
    path = write(tmp_path / "bad.hdf5", recorded("1.5"), leave_out=[missing])
    with pytest.raises(DatasetError, match=f"demo_0: .*{missing}.*A replay needs"):
        imported(path)


def test_files_that_are_none(tmp_path, files):
    path = tmp_path / "bad.hdf5"
    with pytest.raises(DatasetError, match="no such file"):
        imported(path)
    path.write_bytes(b"<html>not found</html>")
    with pytest.raises(DatasetError, match="not an HDF5 file; it starts with"):
        imported(path)
    path.write_bytes(files["1.5"].read_bytes()[:20_000])
    with pytest.raises(DatasetError, match=r"damaged or truncated \(20000 bytes"):
        imported(path)
    with h5py.File(path, "w") as file:
        file["demo_0/qpos"] = np.zeros(3)
    with pytest.raises(DatasetError, match=r"not in robomimic's layout.*found \['demo_0'\]"):
        imported(path)


def test_nothing_is_overwritten_and_a_half_import_begins_anew(tmp_path, files):
    out = tmp_path / "lift.hdf5"
    config = RobomimicConfig(file=str(files["1.5"]), out=str(out))
    part = out.with_name("lift.hdf5.part")
    part.mkdir()
    (part / "demo_0.npz").write_bytes(b"half of another")
    import_demos(config)
    before = out.read_bytes()
    with pytest.raises(DatasetError, match=r"exists\. Choose another --out"):
        import_demos(config)
    assert out.read_bytes() == before
    assert not part.exists()


def test_delta_actions_of_an_imported_demonstration_are_small(files):
    """They are differenced between commands, so they must not jump more than robosuite's do."""
    for demo in imported(files["1.5"], validation=0).train:
        start = np.concatenate([demo.eef_pos[0], np.zeros(3)])
        moves = encode("eef_delta", demo.actions[:, :6], demo.actions[:, 6], start, np.eye(3))
        assert np.abs(moves[1:, :3]).max() < 0.05


def test_training_takes_a_dataset_and_its_numbers(tmp_path, files, monkeypatch):
    demos = imported(files["1.5"], validation=1, n=2, m=2)
    config = TrainConfig(dataset=str(demos.path), resolution=16, run_dir=str(tmp_path / "run"))
    like = like_its_dataset(config)
    assert (like.demos, like.validation, like.n, like.m) == (1, 1, 2, 2)
    layout = Layout.of(demos)
    total = layout.total
    black = Pictures(np.zeros((total, 16, 16, 3), np.uint8), layout, np.ones(total, bool))
    monkeypatch.setattr("jaxcam.pipeline.load_pictures", lambda *_: black)
    data = training_data([resolve(like, accelerator=False)], None)
    assert data.lengths.tolist() == [d.length for d in demos.episodes]
    assert [len(w) for w in data.windows] == [2, 1]
    assert demos.fingerprint in data.fingerprint
    with pytest.raises(ConfigError, match=r"demos is 1 in .* but 7 was asked. Leave --demos out"):
        train(replace(config, demos=7))
    assert not (tmp_path / "run").exists()


def test_help_is_fast():
    began = time.perf_counter()
    shown = subprocess.run(
        [sys.executable, "-m", "jaxcam.robomimic", "--help"], capture_output=True, text=True
    )
    assert "--filter-key" in shown.stdout
    assert time.perf_counter() - began < 3


def test_the_doctor_examines_a_file_as_it_would_be_imported(files, tmp_path):
    path = tmp_path / "lift.hdf5"
    path.write_bytes(files["1.5"].read_bytes())
    report = examine(path, 1)
    assert "as jaxcam imports it" in report.subtitle
    assert {f.mark for f in report.findings} == {"good"}, report.findings
    assert any(f.what == "replay, joint_delta" for f in report.findings)
    with h5py.File(path, "r+") as file:
        del file["data/demo_1/states"]
    (finding,) = examine(path, 1).findings
    assert finding.mark == "bad"
    assert "data/demo_1: no " in finding.got
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_left_out_and_what_is_not_validated_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    of_many(tmp_path / "few.hdf5", 3, {"train": [0], "valid": [1]})
    assert exit_code("robomimic", "few.hdf5") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of 3 demonstrations are neither in mask/train nor in mask/valid" in said
    assert "No validation demonstrations" not in said
    assert exit_code("robomimic", "few.hdf5", "--validation", 0, "--out", "all.hdf5") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "No validation demonstrations: training on it gives no validation loss" in said
    assert "Train on it" in said


def test_what_fails_when_replayed_is_not_advised(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    parts = recorded("1.5")
    for i in range(EPISODES):
        for name in ("states", "actions"):
            parts[f"{name}_{i}"] = parts[f"{name}_{i}"][:10]
    assert exit_code("robomimic", write(tmp_path / "short.hdf5", parts)) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "Do not train on it" in said
    assert "Train on it" not in said


def other_kind(file, what):
    """One thing of another kind than it should be."""
    match what:
        case "mask":
            file["mask"] = np.zeros(3)
        case "members":
            file["mask/train"] = np.arange(2)
        case "states":
            del file["data/demo_0/states"]
            file["data/demo_0/states/inner"] = np.zeros(3)
        case "text":
            del file["data/demo_0/actions"]
            file["data/demo_0/actions"] = np.array(["a"] * 5, "S1")
        case "model":
            file["data/demo_0"].attrs["model_file"] = np.arange(3)
        case "demo":
            del file["data/demo_0"]
            file["data/demo_0"] = np.zeros(3)
        case "actions":
            file["data/demo_0/actions"][3, 2] = np.inf
        case "env":
            file["data"].attrs["env_args"] = "[" * 100_000
        case "kwargs":
            file["data"].attrs["env_args"] = '{"env_name": "Lift", "env_kwargs": [1]}'


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("mask", "mask: no group"),
        ("members", "mask/train: int64.*expected a list of names"),
        ("states", "data/demo_0/states: no dataset"),
        ("text", "data/demo_0/actions: .*expected numbers"),
        ("model", "data/demo_0: attribute 'model_file' is no text"),
        ("demo", "data/demo_0: no group"),
        ("actions", "data/demo_0: actions that are not finite"),
        ("env", "not in robomimic's layout"),
        ("kwargs", "not in robomimic's layout"),
    ],
)
def test_parts_of_another_kind_are_told(tmp_path, what, message):
    path = write(tmp_path / "bad.hdf5", recorded("1.5"))
    with h5py.File(path, "r+") as file:
        other_kind(file, what)
    with pytest.raises(DatasetError, match=f"bad.hdf5: {message}"):
        imported(path)


def test_names_that_only_look_like_demonstrations_are_none(tmp_path):
    path = write(tmp_path / "odd.hdf5", recorded("1.5"))
    with h5py.File(path, "r+") as file:
        for name in ("demo_²", "demo_٣", "7", "demo_", "demo_" + "9" * 5000):
            file["data"].create_group(name)
    demos = imported(path)
    assert len(demos.episodes) == EPISODES
