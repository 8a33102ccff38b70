"""Camera poses that mean something else: each mix-up is refused, and named, before rendering."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from many_cameras import CAMERAS, rotated, scaled, seen_by_many, with_optics, with_poses

from jaxcam.data.cameras import Fault, camera_faults, require_possible, require_rigid, sights_of
from jaxcam.data.pictures import load_pictures
from jaxcam.errors import CameraError
from jaxcam.rays import invert, opengl_from_opencv
from jaxcam.rays.rotations import matrix_from_quaternion, quaternion_from_matrix
from jaxcam.sim import make_task


@pytest.fixture(scope="module")
def many(demos):
    return seen_by_many(demos)


def quaternions(poses, by):
    q = np.roll(quaternion_from_matrix(poses[:, :3, :3]), by, -1)
    return rotated(poses, matrix_from_quaternion(q))


def in_base(poses):
    base = make_task("lift").scene("randomized").world_from_base
    return invert(base) @ poses


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
        faults = camera_faults(data)
        assert not faults.odd.any()
        assert faults.cause is None
        require_rigid(data)
        require_possible(data)


def test_each_camera_is_tried_on_the_grip_of_its_own_demonstrations(demos):
    sights = sights_of(demos)
    filmed = [(demo, int(row)) for demo in demos.episodes for row in demo.cameras]
    assert sights.rows.tolist() == sorted({row for _, row in filmed})
    for row, points in zip(sights.rows, sights.points, strict=True):
        places = np.concatenate([demo.eef_pos for demo, camera in filmed if camera == row])
        assert (points[:, None] == places).all(-1).any(-1).all()
    (rows,), (f,) = np.unique(sights.sizes[:, 0]), np.unique(sights.K[:, 1, 1])
    fovy = 2 * np.arctan(rows / 2 / f)
    assert fovy == pytest.approx(np.deg2rad(demos.header.fovy_deg))


def test_each_reason_is_counted(many):
    poses = many.header.world_from_camera
    behind = camera_faults(with_poses(many, opengl_from_opencv(poses)))
    assert tuple(behind.by_fault) == get_args(Fault)
    assert behind.summary == (
        f"{CAMERAS} of {CAMERAS} cameras are odd: behind the camera {CAMERAS}, "
        f"upside down {CAMERAS}"
    )
    away = camera_faults(with_poses(many, poses @ np.diag([-1.0, 1, -1, 1])))  # the top is up
    assert f"odd: behind the camera {CAMERAS}" in away.summary
    far = camera_faults(with_poses(many, scaled(poses, 1000)))
    assert far.by_fault["too far away or too near"].sum() == CAMERAS


def test_nothing_is_rendered_for_impossible_cameras(demos, tmp_path):
    poses = opengl_from_opencv(demos.header.world_from_camera)
    spoilt = replace(with_poses(demos, poses), path=tmp_path / "spoilt.hdf5")
    with pytest.raises(CameraError, match="OpenGL"):
        load_pictures(spoilt, 24)
    assert not list(tmp_path.iterdir())


def test_cameras_that_no_mix_up_explains(many):
    poses = many.header.world_from_camera.copy()
    poses[:, 2, 3] += 9
    faults = camera_faults(with_poses(many, poses))
    assert (faults.tolerable, faults.cause) == (False, None)
    assert "No usual mix-up" in faults.remedy


def test_a_few_odd_cameras_are_named_and_used(many):
    poses = many.header.world_from_camera.copy()
    poses[7, 0, 3] += 20
    faults = camera_faults(with_poses(many, poses))
    assert faults.tolerable
    assert np.flatnonzero(faults.odd).tolist() == [7]
    require_possible(with_poses(many, poses))


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


@pytest.mark.parametrize("fovy", [np.nan, 0.0, np.pi / 4])
def test_a_field_of_view_that_cannot_be_is_refused(many, fovy):
    with pytest.raises(CameraError, match="outside the picture"):
        require_possible(replace(many, header=replace(many.header, fovy_deg=fovy)))


def test_fields_of_view_of_their_own_that_are_too_narrow_are_named(many):
    """Not poses, which no reading mends; those are still named where they are wrong, too."""
    wide = with_optics(many, fovy="45:70", lens="opencv:-0.1:0")
    require_possible(wide)
    narrow = with_optics(many, fovy="2:5")
    with pytest.raises(CameraError, match=r"own intrinsics .*wider fields of view"):
        require_possible(narrow)
    turned = with_poses(wide, opengl_from_opencv(wide.header.world_from_camera))
    with pytest.raises(CameraError, match="the axes are OpenGL's"):
        require_possible(turned)
