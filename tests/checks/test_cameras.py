"""What the doctor says of a dataset's cameras."""

import numpy as np
import pytest
from many_cameras import CAMERAS, seen_by_many, with_poses

from jaxcam.checks.cameras import check_cameras, check_poses
from jaxcam.data.cameras import EXPECTED
from jaxcam.rays import opengl_from_opencv


@pytest.fixture(scope="module")
def many(demos):
    return seen_by_many(demos)


def test_the_papers_cameras_are_good(many, demos):
    for data in (many, demos):
        assert check_cameras(data).mark == "good"
        assert check_poses(data).mark == "good"


def test_a_mix_up_is_bad_and_its_likely_cause_is_named(many):
    poses = opengl_from_opencv(many.header.world_from_camera)
    finding = check_cameras(with_poses(many, poses))
    assert (finding.mark, finding.expected) == ("bad", EXPECTED)
    assert finding.got.startswith(f"{CAMERAS} of {CAMERAS} cameras are odd")
    assert finding.where == f"0, 1, 2, 3, 4 and {CAMERAS - 5} more"
    assert finding.fix.startswith("Likely cause: the axes are OpenGL's")


def test_what_no_mix_up_explains_is_bad(many):
    poses = many.header.world_from_camera.copy()
    poses[:, 2, 3] += 9
    finding = check_cameras(with_poses(many, poses))
    assert finding.mark == "bad"
    assert "No usual mix-up" in finding.fix


def test_a_few_odd_cameras_are_noted(many):
    poses = many.header.world_from_camera.copy()
    poses[7, 0, 3] += 20
    finding = check_cameras(with_poses(many, poses))
    assert (finding.mark, finding.where) == ("note", "7")
    assert "too far away or too near 1" in finding.got
    assert finding.fix == "Look at the pictures of those."


def test_pictures_upside_down(many):
    poses = many.header.world_from_camera @ np.diag([-1.0, -1, 1, 1])
    finding = check_cameras(with_poses(many, poses))
    assert finding.mark == "bad"
    assert f"upside down {CAMERAS}" in finding.got


def test_poses_that_are_not_rigid_are_bad(many):
    poses = many.header.world_from_camera.copy()
    poses[3, 0, 3] = np.nan
    finding = check_poses(with_poses(many, poses))
    assert finding.mark == "bad"
    assert "world_from_camera[3]" in finding.got
