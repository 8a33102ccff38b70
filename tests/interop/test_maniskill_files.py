"""ManiSkill's trajectory files: what its own recorder writes becomes demonstrations that replay."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from odd_files import flipped, odd_texts
from places import HELPERS
from running import exit_code

from jaxcam.checks.examine import examine
from jaxcam.config.datasets import ManiskillConfig
from jaxcam.data.demos import read_demos
from jaxcam.data.pictures import load_pictures
from jaxcam.data.splits import FIRST_SEED
from jaxcam.errors import DatasetError
from jaxcam.interop import maniskill_files
from jaxcam.interop.formats import recognise
from jaxcam.interop.importing import succeeds
from jaxcam.interop.maniskill import import_trajectories
from jaxcam.interop.maniskill_actions import LEAD, SIZES, grip_targets, gripper_signs
from jaxcam.interop.maniskill_files import open_file, read_demo, read_source
from jaxcam.rays import Camera
from jaxcam.rays.rotations import matrix_from_quaternion, rotvec_from_matrix
from jaxcam.sim import make_task
from jaxcam.sim.actions import ACTION_SPACES
from jaxcam.sim.maniskill import kinematics

CASES = {
    "push": "PushCube-v1,pd_ee_delta_pose,1,2,-3",
    "lift_upright": "LiftPegUpright-v1,pd_joint_pos,1,2",
    "roll_ball": "JaxcamRollBall-v1,pd_ee_pose,1,2",
}
"""Environment, control mode and seeds of what is recorded; negative ones stand still and fail."""


@pytest.fixture(scope="session")
def recorded(maniskill, tmp_path_factory):
    """A folder with what ManiSkill's own recorder wrote."""
    folder = tmp_path_factory.mktemp("recorded")
    cases = [f"{name}={how}" for name, how in CASES.items()]
    script = HELPERS / "maniskill_record.py"
    ran = subprocess.run(
        [sys.executable, script, folder, *cases], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    return folder


def imported(folder, name, out, **settings):
    settings = {"validation": 1, "out": str(out), **settings}
    return import_trajectories(ManiskillConfig(file=str(folder / f"{name}.h5"), **settings))


def replayed(capsys, *arguments):
    """What the command prints, and its exit code."""
    code = exit_code("replay", *arguments)
    return " ".join(capsys.readouterr().out.split()), code


@pytest.mark.parametrize("mode", SIZES)
def test_targets_are_those_of_maniskills_controllers(recorded, mode):
    truth = np.load(recorded / "targets.npz")
    actions, joints, wanted = (truth[f"{mode}/{what}"] for what in ("actions", "joints", "targets"))
    position, rotation = grip_targets(mode, actions.astype(float), joints)
    if "joint" in mode:
        there, axes, _ = kinematics.forward(wanted)
    else:
        unit = wanted[:, 3:] / np.linalg.norm(wanted[:, 3:], axis=-1, keepdims=True)
        there, axes = wanted[:, :3], matrix_from_quaternion(unit)
    np.testing.assert_allclose(position, there, atol=2e-6)
    np.testing.assert_allclose(rotvec_from_matrix(rotation @ axes.mT), 0, atol=2e-6)
    assert np.ptp(position, 0).max() > 0.01


def test_states_cameras_and_targets_are_carried_over(recorded, tmp_path):
    result = imported(recorded, "push", tmp_path / "out.hdf5")
    assert result.names == ["traj_0", "traj_1"]
    assert result.dropped == {"traj_2": "failed when it was recorded"}
    header, demo = result.demos.header, result.demos.train[0]
    assert (header.task, header.scene, header.train, header.valid) == ("push", "randomized", 1, 1)
    assert (header.n, header.m, demo.seed) == (3, 1, FIRST_SEED)
    assert demo.cameras.tolist() == [0, 1, 2]
    assert result.demos.valid[0].cameras.tolist() == [3]
    assert "PushCube-v1" in header.versions["imported"]
    with h5py.File(recorded / "push.h5") as file:
        states = file["traj_0/env_states"]
        robot, cube = states["articulations/panda"][:], states["actors/cube"][:]
        goal = states["actors/goal_region"][0, :7]
        length = len(file["traj_0/actions"])
    assert demo.length == length
    np.testing.assert_array_equal(demo.states[:, 1:10], robot[:, 13:22])
    np.testing.assert_array_equal(demo.states[:, 10:17], cube[:, :7])
    np.testing.assert_array_equal(demo.states[:, 17:26], robot[:, 22:])
    np.testing.assert_array_equal(demo.states[:, 26:], cube[:, 7:])
    np.testing.assert_array_equal(demo.fixtures[2], goal)
    assert np.linalg.norm(demo.fixtures[0, :2]) > 0.01  # the table is moved by us
    assert np.linalg.norm(np.diff(demo.actions[:, :3], axis=0), axis=-1).max() < 0.04
    assert np.linalg.norm(demo.actions[:, :3] - demo.eef_pos[1:], axis=-1).max() < 0.06


def test_pictures_are_rendered_from_recorded_states(recorded, tmp_path):
    """One from each camera of the schedule, the cube where the states say it is."""
    demos = imported(recorded, "push", tmp_path / "out.hdf5").demos
    side, demo = 48, demos.train[0]
    pictures = load_pictures(demos, side)
    camera = Camera.from_fovy(np.deg2rad(demos.header.fovy_deg), side, side, np.eye(4))
    distances = []
    for row in (np.array(0), np.array(demo.length - 1)):
        for slot, pose in enumerate(demos.header.world_from_camera[demo.cameras]):
            picture = pictures.rgb[pictures.layout.at(0, row, slot)].astype(int)
            blue = picture[..., 2] - picture[..., :2].max(-1) > 60
            uv, _ = replace(camera, world_from_camera=pose).project(demo.states[row, 10:13])
            if blue.sum() > 8 and (abs(uv - side / 2) < side / 2 - 6).all():
                middle = np.argwhere(blue).mean(0)[::-1] + 0.5
                distances.append(np.linalg.norm(middle - uv))
    assert len(distances) >= 2
    assert max(distances) < 4


@pytest.mark.parametrize("name", CASES)
def test_replay_takes_the_file_and_all_of_it_still_works(
    name, recorded, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    printed, code = replayed(capsys, recorded / f"{name}.h5")
    assert code == 0, printed
    for space in ACTION_SPACES:
        assert f"{space} │ 2 of 2 │ 100.0%" in printed
    data = read_demos(Path(f"data/{name}-randomized-{name}.hdf5"), task=name)
    assert (len(data.train), len(data.valid)) == (1, 1)
    assert ("traj_2: failed when it was recorded" in printed) == (name == "push")


def test_the_doctor_examines_a_file_as_it_would_be_imported(recorded):
    before = sorted(recorded.iterdir())
    report = examine(recorded / "push.h5", 1)
    assert "as jaxcam imports it" in report.subtitle
    assert "bad" not in {f.mark for f in report.findings}, report.findings
    assert {"grip", "replay, joint_delta"} <= {f.what for f in report.findings}
    assert report.overlays is not None
    assert sorted(recorded.iterdir()) == before


def test_replay_says_why_a_demonstration_is_lost(recorded, tmp_path, monkeypatch, capsys):
    for end in ("h5", "json"):
        (tmp_path / f"peg.{end}").write_bytes((recorded / f"lift_upright.{end}").read_bytes())
    with h5py.File(tmp_path / "peg.h5", "r+") as file:
        file["traj_1/actions"][15:] = file["traj_1/actions"][14]  # stands still; its states do not
    monkeypatch.chdir(tmp_path)
    printed, code = replayed(capsys, "peg.h5", "--action-space", "eef_abs")
    assert code == 1
    assert "1 of 2" in printed
    assert "eef_abs, traj_1: from control step" in printed
    assert "the peg is elsewhere than it was recorded" in printed


def trajectory(folder, *, done=True, env="PushCube-v1", settings=None, mode="pd_joint_pos", base=0):
    """A file of one episode of five steps in ManiSkill's layout, made by hand."""
    task = make_task("push")
    start = task.start(task.scene("fixed"), 3)
    robot = np.zeros((6, 31))
    robot[:, :7] = -0.615 + base, 0, 0, 1, 0, 0, 0
    robot[:, 13:22] = start.qpos[:9]
    cube, goal = np.zeros((6, 13)), np.zeros((6, 13))
    cube[:, :7], goal[:, :7] = start.qpos[9:], start.fixtures[2]
    if done:
        cube[-1, :2] = goal[-1, :2]
    path = folder / "made.h5"
    with h5py.File(path, "w") as file:
        file["traj_0/actions"] = np.tile(np.append(start.qpos[:7], 1), (5, 1)).astype(np.float32)
        file["traj_0/success"] = np.array([False] * 4 + [done])
        file["traj_0/env_states/articulations/panda"] = robot
        file["traj_0/env_states/actors/cube"] = cube
        file["traj_0/env_states/actors/goal_region"] = goal
    info = {"env_id": env, "env_kwargs": settings or {}}
    about = {"env_info": info, "episodes": [{"episode_id": 0, "control_mode": mode}]}
    path.with_suffix(".json").write_text(json.dumps(about))
    return path


def read(path):
    source = read_source(ManiskillConfig(file=str(path)))
    with open_file(path) as file:
        return source, read_demo(source, file, "traj_0", "pd_joint_pos", FIRST_SEED)


@pytest.mark.parametrize("done", [True, False])
def test_success_is_our_tasks(tmp_path, done):
    source, demo = read(trajectory(tmp_path, done=done))
    assert succeeds(demo, source.task, source.scene) == done
    np.testing.assert_allclose(demo.actions[:, :3], demo.eef_pos[1:], atol=1e-6)
    np.testing.assert_array_equal(demo.gripper, -1)


def test_only_maniskills_files_are_taken_for_its(tmp_path):
    assert recognise(trajectory(tmp_path)) == "maniskill"
    assert recognise(tmp_path / "made.json") == "unknown"
    assert recognise(tmp_path / "missing.h5") == "unknown"
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data/demo_0"] = 1
    assert recognise(tmp_path / "other.h5") == "unknown"


def test_actions_that_are_no_targets_give_way_to_the_way_of_the_arm():
    q = np.linspace(0.1, 0.3, 6)[:, None] * np.ones(7)
    position, rotation = grip_targets("pd_joint_vel", np.zeros((5, 8)), q)
    there, axes, _ = kinematics.forward(q[[LEAD, LEAD + 1, LEAD + 2, 5, 5]])
    np.testing.assert_array_equal(position, there)
    np.testing.assert_array_equal(rotation, axes)


def test_the_gripper_keeps_its_command_at_zero():
    assert gripper_signs(np.array([[0.0], [1], [-0.4], [0], [0.2]])).tolist() == [-1, -1, 1, 1, -1]


def without(name):
    def spoil(path):
        with h5py.File(path, "r+") as file:
            del file[name]

    return spoil


def with_nan(path):
    with h5py.File(path, "r+") as file:
        file["traj_0/env_states/actors/cube"][2, 0] = np.nan


def cut(path):
    path.write_bytes(path.read_bytes()[:3000])


def untold(path):
    path.with_suffix(".json").unlink()


def mistold(path):
    path.with_suffix(".json").write_text('{"episodes": []}')


def changed(name, array):
    def spoil(path):
        with h5py.File(path, "r+") as file:
            del file[name]
            file[name] = array

    return spoil


def linked(path):
    with h5py.File(path, "r+") as file:
        del file["traj_0/actions"]
        file["traj_0/actions"] = h5py.ExternalLink("/etc/passwd", "/")


def giant(path):
    with h5py.File(path, "r+") as file:
        del file["traj_0/actions"]
        file.create_dataset("traj_0/actions", (1 << 40, 8), "f4", chunks=(64, 8))


def episode(entry):
    def spoil(path):
        said = json.loads(path.with_suffix(".json").read_text())
        path.with_suffix(".json").write_text(json.dumps({**said, "episodes": [entry]}))

    return spoil


def of_two_robots(path):
    with h5py.File(path, "r+") as file:
        file["traj_0/env_states/articulations/panda-1"] = np.zeros((6, 31))


@pytest.mark.parametrize(
    ("spoil", "settings", "message"),
    [
        (untold, {}, r"made.json: no such file.*task is not known"),
        (mistold, {}, "not what ManiSkill writes beside trajectories.*env_id"),
        (cut, {}, "made.h5: damaged or truncated .3000 bytes"),
        (without("traj_0/env_states"), {}, "traj_0: .*env_states.*record_env_state"),
        (without("traj_0"), {}, "traj_0: .*all trajectories of the .json"),
        (without("traj_0/env_states/actors/cube"), {}, "traj_0/env_states/actors: no 'cube'"),
        (with_nan, {}, "traj_0: .*not finite"),
        (of_two_robots, {}, "traj_0: robots .*panda-1.*expected one Panda"),
        (None, {"env": "PickCube-v1"}, r"trajectories of 'PickCube-v1'\. Known: PushCube-v1"),
        (None, {"env": "PushCube-v2"}, "did you mean 'PushCube-v1'"),
        (None, {"settings": {"sim_config": {"control_freq": 50}}}, "at 50 control steps"),
        (None, {"mode": None}, r"episodes\[0\] \(traj_0\): control_mode None; expected its name"),
        (
            None,
            {"mode": "pd_joint_po"},
            "no control mode 'pd_joint_po', did you mean 'pd_joint_pos'",
        ),
        (None, {"settings": {"sim_config": [1]}}, "not what ManiSkill writes beside"),
        (None, {"settings": "none"}, "not what ManiSkill writes beside"),
        (
            changed("traj_0/actions", np.zeros((5, 7))),
            {},
            "actions of 7 numbers; pd_joint_pos has 8",
        ),
        (changed("traj_0/actions", np.array(["a"] * 5, "S1")), {}, "actions: .*expected numbers"),
        (changed("traj_0/actions", np.zeros((3, 8))), {}, "there must be one state more"),
        (changed("traj_0/env_states", np.zeros(3)), {}, "traj_0/env_states: no group"),
        (changed("traj_0/env_states/articulations/panda", np.zeros(6)), {}, "expected one Panda"),
        (changed("traj_0/env_states/actors/cube", np.zeros((6, 10))), {}, "'cube' has states"),
        (changed("traj_0/env_states/actors/cube", np.zeros((4, 13))), {}, "'cube' has states"),
        (
            changed("traj_0/env_states/actors/goal_region", np.zeros((6, 7))),
            {},
            "'goal_region' has",
        ),
        (linked, {}, "traj_0/actions is a link to another file"),
        (giant, {}, "declare"),
        (episode({"control_mode": "pd_joint_pos"}), {}, "episode_id None; expected a whole"),
        (episode({"episode_id": "../0"}), {}, "episode_id '../0'; expected a whole number"),
        (episode(3), {}, "episode_id None; expected a whole number"),
        (None, {"base": 0.1}, r"base is at \[-0.515.*in our task at \[-0.615"),
    ],
)
def test_bad_files_are_named_with_the_reason(tmp_path, spoil, settings, message):
    path = trajectory(tmp_path, **settings)
    if spoil:
        spoil(path)
    with pytest.raises(DatasetError, match=f"(?s)made.*{message}" if spoil is None else message):
        read(path)


def test_nothing_is_written_of_failures_nor_over_a_dataset(maniskill, tmp_path):
    out = tmp_path / "out.hdf5"
    with pytest.raises(
        DatasetError, match=r"no trajectory succeeds.*traj_0: failed when it was recorded"
    ):
        imported(trajectory(tmp_path, done=False).parent, "made", out, validation=0)
    trajectory(tmp_path)
    with pytest.raises(DatasetError, match="none is left to train on"):
        imported(tmp_path, "made", out)
    assert not out.exists()
    imported(tmp_path, "made", out, validation=0)
    with pytest.raises(DatasetError, match=r"out.hdf5 exists"):
        imported(tmp_path, "made", out, validation=0)


def test_odd_values_and_flipped_bits_of_the_json_are_read_or_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(maniskill_files, "make_task", lambda name: SimpleNamespace(scene=str))
    (tmp_path / "a.h5").write_bytes(b"read later")
    episode = {"episode_id": 0, "control_mode": "pd_joint_pos", "success": True}
    env = {"env_id": "PushCube-v1", "env_kwargs": {"sim_config": {"control_freq": 20}}}
    whole = {"env_info": env, "episodes": [episode, episode], "source_type": "motionplanning"}
    texts = [text.encode("utf-8", "surrogatepass") for text in odd_texts([whole])]
    refused = 0
    for content in [*texts, *flipped(json.dumps(whole).encode())]:
        (tmp_path / "a.json").write_bytes(content)
        try:
            read_source(ManiskillConfig(file=str(tmp_path / "a.h5")))
        except DatasetError as error:
            refused += 1
            str(error).encode("utf-8", "surrogatepass")
    assert refused > 30
