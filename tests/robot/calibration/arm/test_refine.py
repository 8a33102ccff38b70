"""The refinement, from a pose that is some degrees and centimetres off."""

import functools

import numpy as np
import pytest
from boxed_arm import CAMERA, boxed_arm, film

from jaxcam.robot.calibration.arm.refine import Prior, Refiner, Solution
from jaxcam.robot.calibration.projection import apart, moved

OFF = np.r_[0.02, -0.015, 0.02, np.deg2rad([1.2, -1.0, 1.5])]


@functools.cache
def refined(off=(0.0, 0.0, 0.0), lag=0.0):
    refiner = Refiner(boxed_arm(), film([CAMERA] * 4, off=off, lag=lag))
    return refiner, refiner.refine(Solution(moved(CAMERA, OFF), np.zeros(3), 0.0))


def test_the_pose_is_found():
    _, got = refined()
    place, turn = apart(CAMERA, got.solution.base_from_camera)
    assert place < 0.008
    assert turn < np.deg2rad(0.5)
    assert got.typical < 0.5
    assert got.support(2.0) > 0.4


def test_the_deviation_that_is_said_is_of_the_size_of_the_error():
    _, got = refined()
    place, _ = apart(CAMERA, got.solution.base_from_camera)
    assert 0.2 * place < got.spread[0] < 0.05


def test_pictures_that_are_late_are_found():
    _, got = refined(lag=0.06)
    assert got.solution.lag == pytest.approx(0.06, abs=0.015)
    assert apart(CAMERA, got.solution.base_from_camera)[0] < 0.01


def test_joints_that_are_off_are_found_where_they_can_be():
    """A fault of the first joint looks like a camera that was turned about its axis."""
    _, got = refined(off=(0.0, np.deg2rad(-0.8), 0.0))
    assert got.solution.joints[1] > np.deg2rad(0.2)
    assert apart(CAMERA, got.solution.base_from_camera)[0] < 0.012


def test_slopes_are_the_motion_of_the_contour():
    """Against points that are projected again from a camera that was moved."""
    refiner, got = refined()
    solution = got.solution
    looked = refiner.look(solution, 4.0)
    slopes = refiner.slopes(solution, looked)
    step = np.r_[1e-4, -2e-4, 1e-4, 2e-4, 1e-4, -1e-4]
    poses = refiner.arm.poses(refiner.angles(solution))
    first = looked.contours[0]
    ways = []
    for camera in (solution.base_from_camera, moved(solution.base_from_camera, step)):
        there = np.linalg.inv(camera) @ poses[0][first.owners] @ np.c_[
            first.points, np.ones(len(first.points))][..., None]  # fmt: skip
        ways.append(there[:, :2, 0] / there[:, 2] @ refiner.film.K[:2, :2].T)
    motion = ((ways[1] - ways[0]) * first.normals).sum(-1)
    np.testing.assert_allclose(slopes[: len(motion), :6] @ step, motion, atol=2e-4)


def test_an_arm_that_is_in_no_picture_says_nothing():
    refiner, _ = refined()
    away = Solution(moved(CAMERA, np.r_[0, 0, 0, 0, np.pi, 0]), np.zeros(3), 0.0)
    got = refiner.refine(away, (4.0,))
    assert got.support(2.0) == 0
    np.testing.assert_array_equal(got.solution.base_from_camera, away.base_from_camera)
    assert not refiner.equations(away, 4.0).normal.any()


def test_joints_that_are_held_do_not_move():
    refiner, _ = refined()
    joints = np.deg2rad([0.5, 0.0, 0.0])
    got = refiner.refine(Solution(CAMERA, joints, 0.0), (4.0,), Prior(joints, joint_sigma=1e-6))
    np.testing.assert_allclose(got.solution.joints, joints, atol=1e-6)
