"""A camera's pose from a tag on the hand, against the truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tagged import OPTICS, eye

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.hand_eye.fit import (
    Seen,
    check_motions,
    fit_hand_eye,
    most_different_poses,
    refine,
    slow_steps,
    solve_linear,
    turns_of,
)
from jaxcam.robot.calibration.projection import apart, moved, pixels_of, placed, pose_of
from jaxcam.robot.calibration.tags.places import square

SIZE, AIM = 0.06, np.array([0.45, 0.0, 0.2])
CAMERA = eye(far=0.7, aim=AIM)
DOWN = pose_of(Rotation.from_euler("x", np.pi).as_matrix(), AIM)
FACING = pose_of(CAMERA[:3, :3] @ np.diag([1.0, -1, -1]), AIM + 0.05 * -CAMERA[:3, 2])
TAG = moved(np.linalg.inv(DOWN) @ FACING, np.array([0, 0, 0, 0.3, -0.2, 0.1]))


def grips(count=15, turn=(0.6, 0.6, 0.6), seed=0):
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(rng.uniform(-1, 1, (count, 3)) * turn)
    rotations = Rotation.from_matrix(DOWN[:3, :3]) * turns
    return pose_of(rotations.as_matrix(), AIM + rng.uniform(-0.12, 0.12, (count, 3)))


def corners(poses, noise=0.05, seed=0):
    pixels = pixels_of(placed(np.linalg.inv(CAMERA) @ poses @ TAG, square(SIZE)), OPTICS)
    pixels = pixels + np.random.default_rng(seed).normal(0, noise, pixels.shape)
    return [Seen(square(SIZE), some) for some in pixels]


def test_fifteen_poses_give_camera_and_tag():
    poses = grips()
    fit = fit_hand_eye(poses, corners(poses), OPTICS)
    for true, got, spread in (
        (CAMERA, fit.mount_from_camera, fit.spread),
        (TAG, fit.holder_from_target, fit.target_spread),
    ):
        place, turn = apart(true, got)
        assert place < 0.003
        assert turn < np.deg2rad(0.3)
        assert place < 5 * spread[0]
    assert fit.rms < 0.15


def test_grip_poses_that_are_not_exact_make_the_camera_less_sure():
    """All corners of a picture share that error."""
    errors, sure = [], []
    for seed in range(6):
        poses, rng = grips(seed=seed), np.random.default_rng(seed)
        read = np.stack([moved(p, rng.normal(0, [5e-4] * 3 + [2e-3] * 3)) for p in poses])
        fit = fit_hand_eye(read, corners(poses, seed=seed), OPTICS)
        errors.append(apart(CAMERA, fit.mount_from_camera)[0])
        sure.append(fit.spread[0])
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) / np.median(sure) < 2


def test_pictures_that_show_something_else_do_not_count():
    poses = grips(20)
    shown = corners(poses)
    for i in (3, 11):
        shown[i].pixels[:] += 25
    fit = fit_hand_eye(poses, shown, OPTICS)
    assert not np.concatenate([fit.used[3], fit.used[11]]).any()
    assert apart(CAMERA, fit.mount_from_camera)[0] < 0.003


def test_the_linear_solution_is_exact_without_noise():
    poses = grips(5)
    camera, tag = solve_linear(poses, np.linalg.inv(CAMERA) @ poses @ TAG)
    np.testing.assert_allclose(camera, CAMERA, atol=1e-9)
    np.testing.assert_allclose(tag, TAG, atol=1e-9)


@pytest.mark.parametrize(
    ("turn", "match"),
    [((0.01, 0.01, 0.01), "hardly turns"),
     ((0.01, 0.01, 0.8), "one axis only: its z axis .*Lacking: turns about .*x axis|y axis")],
)  # fmt: skip
def test_motions_that_are_lacking_are_named(turn, match):
    poses = grips(turn=turn)
    with pytest.raises(DatasetError, match=match):
        fit_hand_eye(poses, corners(poses), OPTICS)


def test_turns_are_about_the_grips_own_axes():
    spreads, axes = turns_of(grips(40, turn=(0.0, 0.9, 0.3)))
    assert abs(axes[0][1]) > 0.9
    assert spreads[0] > 2 * spreads[1] > 0.1
    check_motions(grips(40, turn=(0.0, 0.9, 0.5)))


def test_too_few_pictures():
    poses = grips(4)
    with pytest.raises(DatasetError, match=r"4 pictures.*at least 6"):
        fit_hand_eye(poses, corners(poses), OPTICS)


def test_poses_that_differ_and_are_slow_are_taken():
    still = np.tile(DOWN, (6, 1, 1))
    fast = grips(6)
    allowed = slow_steps([still, fast])
    assert allowed[:6].all()
    assert not allowed[6:].any()
    chosen = most_different_poses(np.concatenate([still, fast]), np.ones(12, bool), 5)
    assert len(chosen) == 5
    assert sum(i < 6 for i in chosen) == 1


def test_a_camera_on_the_hand_and_a_tag_that_stands():
    """The same, with the frames exchanged."""
    poses = grips()
    on_hand = np.linalg.inv(DOWN) @ eye(far=0.3, aim=AIM)
    stands = pose_of(Rotation.from_euler("z", 0.4).as_matrix(), AIM)
    sights = [
        Seen(square(SIZE), pixels_of(placed(np.linalg.inv(pose @ on_hand) @ stands, square(SIZE)),
                                     OPTICS))
        for pose in poses
    ]  # fmt: skip
    fit = fit_hand_eye(np.linalg.inv(poses), sights, OPTICS)
    np.testing.assert_allclose(fit.mount_from_camera, on_hand, atol=1e-5)
    np.testing.assert_allclose(fit.holder_from_target, stands, atol=1e-5)


def test_a_board_of_which_each_picture_shows_a_part():
    poses, rng = grips(), np.random.default_rng(0)
    board = np.c_[0.02 * np.stack(np.meshgrid(np.arange(5), np.arange(4)), -1).reshape(-1, 2),
                  np.zeros(20)]  # fmt: skip
    sights = []
    for pose in poses:
        some = board[np.sort(rng.choice(20, rng.integers(6, 20), replace=False))]
        pixels = pixels_of(placed(np.linalg.inv(CAMERA) @ pose @ TAG, some), OPTICS)
        sights.append(Seen(some, pixels + rng.normal(0, 0.05, pixels.shape)))
    fit = fit_hand_eye(poses, sights, OPTICS)
    assert apart(CAMERA, fit.mount_from_camera)[0] < 0.002
    assert apart(TAG, fit.holder_from_target)[1] < np.deg2rad(0.3)


def test_a_tag_of_another_size_is_disclosed_by_the_hands_motion():
    poses = grips()
    sights = [Seen(s.points * 1.2, s.pixels) for s in corners(poses)]
    fit = fit_hand_eye(poses, sights, OPTICS)
    start = fit.mount_from_camera, fit.holder_from_target
    scaled = refine(lambda _: poses, sights, OPTICS, start, "scale")
    assert scaled.also == pytest.approx(1 / 1.2, abs=0.01)
    assert abs(scaled.also - 1 / 1.2) < 4 * np.sqrt(scaled.covariance[12, 12])
