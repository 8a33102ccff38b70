"""Camera poses that mean something else: each mix-up is refused, and named, before rendering."""

from dataclasses import replace

import numpy as np
import pytest

from jaxcam.checks.cameras import check_cameras, check_poses, require_possible
from jaxcam.checks.held_out import check_field_of_view, check_held_out, check_ranges
from jaxcam.data.pictures import load_pictures
from jaxcam.errors import CameraError
from jaxcam.rays import POSE_RANGES, invert, opengl_from_opencv, sample_poses
from jaxcam.rays.rotations import matrix_from_quaternion, quaternion_from_matrix

CAMERAS = 60


@pytest.fixture(scope="module")
def many(demos):
    """The session's demonstrations ten times, each seen by a camera of its own."""
    every = demos.episodes * (CAMERAS // 6)
    train = [replace(demo, cameras=np.array([i])) for i, demo in enumerate(every)]
    poses = sample_poses(POSE_RANGES["robosuite"], CAMERAS, 1)
    header = replace(demos.header, world_from_camera=poses, train=CAMERAS, valid=0)
    return replace(demos, header=header, train=train, valid=[])


def with_poses(demos, poses):
    return replace(demos, header=replace(demos.header, world_from_camera=poses))


def rotated(poses, rotation):
    poses = poses.copy()
    poses[:, :3, :3] = rotation
    return poses


def scaled(poses, unit):
    poses = poses.copy()
    poses[:, :3, 3] *= unit
    return poses


def quaternions(poses, by):
    q = np.roll(quaternion_from_matrix(poses[:, :3, :3]), by, -1)
    return rotated(poses, matrix_from_quaternion(q))


def in_base(poses):
    from jaxcam.sim import make_task

    return invert(make_task("lift").scene("randomized").world_from_base) @ poses


MIX_UPS = {
    "w2c as c2w": (invert, "map world to camera; store their inverses"),
    "OpenGL as OpenCV": (opengl_from_opencv, "the axes are OpenGL's"),
    "OpenGL w2c": (lambda x: invert(opengl_from_opencv(x)), "world to camera in OpenGL's axes"),
    "R transposed": (lambda x: rotated(x, x[:, :3, :3].swapaxes(-1, -2)), "are transposed"),
    "xyzw as wxyz": (lambda x: quaternions(x, -1), "xyzw read as wxyz"),
    "wxyz as xyzw": (lambda x: quaternions(x, 1), "wxyz read as xyzw"),
    "millimetres": (lambda x: scaled(x, 1000), "in millimetres; divide them by 1000"),
    "centimetres": (lambda x: scaled(x, 100), "in centimetres"),
    "base frame": (in_base, "in the robot's base frame; store world_from_base @ poses"),
}


@pytest.mark.parametrize("case", MIX_UPS)
def test_a_mix_up_of_conventions_is_refused_and_named(many, case):
    spoil, cause = MIX_UPS[case]
    spoilt = with_poses(many, spoil(many.header.world_from_camera))
    with pytest.raises(CameraError, match=rf"cameras \d.* of {CAMERAS} cameras are odd.*{cause}"):
        require_possible(spoilt)


def test_the_papers_cameras_pass(many, demos):
    for data in (many, demos):
        assert check_cameras(data).mark == "good"
        assert check_poses(data).mark == "good"
        require_possible(data)


def test_each_reason_is_counted(many):
    behind = with_poses(many, opengl_from_opencv(many.header.world_from_camera))
    assert f"behind the camera {CAMERAS}, upside down {CAMERAS}" in check_cameras(behind).got
    turned = many.header.world_from_camera @ np.diag([-1.0, 1, -1, 1])  # looks away, top up
    assert f"odd: behind the camera {CAMERAS}" in check_cameras(with_poses(many, turned)).got
    far = with_poses(many, scaled(many.header.world_from_camera, 1000))
    assert f"too far away or too near {CAMERAS}" in check_cameras(far).got


def test_nothing_is_rendered_for_impossible_cameras(demos, tmp_path):
    poses = opengl_from_opencv(demos.header.world_from_camera)
    spoilt = replace(with_poses(demos, poses), path=tmp_path / "spoilt.hdf5")
    with pytest.raises(CameraError, match="OpenGL"):
        load_pictures(spoilt, 24)
    assert not list(tmp_path.iterdir())


def test_cameras_that_no_mix_up_explains(many):
    poses = many.header.world_from_camera.copy()
    poses[:, 2, 3] += 9
    found = check_cameras(with_poses(many, poses))
    assert found.mark == "bad"
    assert "No usual mix-up" in found.fix


def test_a_few_odd_cameras_are_told_and_used(many):
    poses = many.header.world_from_camera.copy()
    poses[7, 0, 3] += 20
    found = check_cameras(with_poses(many, poses))
    assert (found.mark, found.where) == ("note", "7")
    assert "too far away or too near 1" in found.got
    require_possible(with_poses(many, poses))


def test_pictures_upside_down(many):
    poses = many.header.world_from_camera @ np.diag([-1.0, -1, 1, 1])
    found = check_cameras(with_poses(many, poses))
    assert found.mark == "bad"
    assert f"upside down {CAMERAS}" in found.got


def spoilt_pose(index, value):
    def spoil(poses):
        poses = poses.copy()
        poses[3][index] = value
        return poses

    return spoil


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (spoilt_pose((0, 3), np.nan), r"world_from_camera\[3\]: values.*finite"),
        (spoilt_pose((0, 0), 2.0), r"\[3\]: rotation R"),
        (lambda x: x @ np.diag([1.0, -1, 1, 1]), "mirrored basis.*60 of 60"),
        (spoilt_pose((3, 0), 1.0), "last row"),
    ],
)
def test_poses_that_are_not_rigid(many, spoil, match):
    with pytest.raises(CameraError, match=match):
        require_possible(with_poses(many, spoil(many.header.world_from_camera)))


def test_cameras_and_episodes_of_the_evaluation_do_not_belong_in_a_dataset(many):
    assert check_held_out(many).mark == "good"
    poses = many.header.world_from_camera.copy()
    poses[:4] = sample_poses(POSE_RANGES["robosuite"], 9, 23)[5:]
    found = check_held_out(with_poses(many, poses))
    assert found.mark == "bad"
    assert "4 of test, 0 of validation" in found.got
    leak = replace(many, train=[replace(many.train[0], seed=2_000_007), *many.train[1:]])
    assert "evaluation: 2000007" in check_held_out(leak).got


def test_cameras_from_elsewhere_than_those_of_the_evaluation(many):
    assert check_ranges(many).mark == "good"
    poses = many.header.world_from_camera.copy()
    poses[:3] = sample_poses(replace(POSE_RANGES["robosuite"], distance=(1.5, 2.0)), 3, 0)
    poses[3, :3, :3] = poses[4, :3, :3]  # looks past the table
    found = check_ranges(with_poses(many, poses))
    assert (found.mark, found.where) == ("note", "0, 1, 2, 3")


@pytest.mark.parametrize("name", POSE_RANGES)
def test_the_papers_ranges_are_their_own(many, name, monkeypatch):
    from jaxcam.sim.tasks.lift import Lift

    monkeypatch.setattr(Lift, "cameras", POSE_RANGES[name])
    poses = sample_poses(POSE_RANGES[name], 200, 0)
    assert check_ranges(with_poses(many, poses)).mark == "good"


@pytest.mark.parametrize(("fovy", "hint"), [(60.0, "cameras' own"), (np.pi / 4, "like radians")])
def test_a_field_of_view_of_other_cameras(many, fovy, hint):
    assert check_field_of_view(many).mark == "good"
    found = check_field_of_view(replace(many, header=replace(many.header, fovy_deg=fovy)))
    assert found.mark == "bad"
    assert hint in found.fix


@pytest.mark.parametrize("fovy", [np.nan, 0.0, np.pi / 4])
def test_a_field_of_view_that_cannot_be_is_refused(many, fovy):
    with pytest.raises(CameraError, match="outside the picture"):
        require_possible(replace(many, header=replace(many.header, fovy_deg=fovy)))
