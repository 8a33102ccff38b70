"""K and lens from corners, against the camera that they were projected through."""

import numpy as np
import pytest
from seen_boards import BOARD, SIZE, WIDE, board_poses, optics, seen

from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.boards import BoardSeen
from jaxcam.robot.calibration.lens.fit import fit_lens, project_board, ray_pixels
from jaxcam.robot.calibration.projection import HALF, pixels_of, straightened


def rays_off(fit, camera):
    """Pixels by which rays of the middle nine tenths of the picture are off."""
    pixels = ray_pixels(*SIZE)[1:-1, 1:-1]
    points = np.concatenate([straightened(pixels, camera), np.ones((*pixels.shape[:2], 1))], -1)
    return np.linalg.norm(pixels_of(points, fit.optics) - pixels, axis=-1)


@pytest.mark.parametrize(
    ("kind", "lens", "focal", "count"),
    [("opencv", (-0.2, 0.05, 4e-4, -3e-4, 0.01), 600.0, 5), ("fisheye", WIDE, 300.0, 4)],
)
def test_k_and_lens_are_found_with_their_uncertainty(kind, lens, focal, count):
    rng = np.random.default_rng(0)
    camera = optics(focal, lens, kind)
    poses = board_poses(rng, 20, far=0.25 if kind == "opencv" else 0.16)
    fit = fit_lens(BOARD.points, seen(camera, poses, rng), SIZE, kind, count)
    K, true = fit.optics.K, camera.K
    assert abs(K[0, 0] / true[0, 0] - 1) < 0.002
    assert abs(K[1, 1] / true[1, 1] - 1) < 0.002
    assert np.abs(K[:2, 2] - true[:2, 2]).max() < 1
    off = rays_off(fit, camera)
    assert (off < 4 * fit.rays[1:-1, 1:-1] + 0.02).all()  # what is extrapolated says so
    assert np.mean(off < 0.5) > 0.7
    off = [K[0, 0] - true[0, 0], K[1, 1] - true[1, 1], *(K[:2, 2] - true[:2, 2])]
    assert (np.abs(off) < 4 * fit.sigmas[:4]).all()
    assert 0.04 < fit.rms / np.sqrt(2) < 0.06
    np.testing.assert_allclose(fit.boards[:, :3, 3], poses[:, :3, 3], atol=2e-3)


def test_a_corner_that_is_none_is_left_out():
    rng = np.random.default_rng(1)
    camera = optics()
    views = seen(camera, board_poses(rng, 12, far=0.25), rng)
    views[3].pixels[5] += 9
    fit = fit_lens(BOARD.points, views, SIZE)
    assert not fit.used[3][5]
    assert sum(int((~u).sum()) for u in fit.used) < 4
    assert abs(fit.optics.K[0, 0] / 600 - 1) < 0.003


def test_boards_parallel_to_the_picture_do_not_tell_the_focal_length():
    rng = np.random.default_rng(2)
    poses = board_poses(rng, 12, tilt=0.002)
    fit = fit_lens(BOARD.points, seen(optics(), poses, rng), SIZE)
    assert fit.sigmas[0] / fit.optics.K[0, 0] > 0.02


def test_points_without_sense_are_refused():
    rng = np.random.default_rng(3)
    views = [BoardSeen("a", np.arange(24), rng.uniform(0, 480, (24, 2))) for _ in range(6)]
    with pytest.raises(DatasetError, match="not those of a flat board"):
        fit_lens(BOARD.points, views, SIZE)


@pytest.mark.parametrize(
    ("kind", "lens"), [("opencv", (-0.2, 0.05, 4e-4, -3e-4)), ("fisheye", WIDE)]
)
def test_opencvs_projection_is_that_of_the_rays(kind, lens):
    """Its pixels are half a pixel less."""
    camera = optics(400.0, lens, kind)
    pose = np.array([0.2, -0.3, 0.1, -0.1, -0.05, 0.3])
    own = np.array([camera.K[0, 0], camera.K[1, 1], *(camera.K[:2, 2] - HALF), *lens])
    theirs, by_camera, by_pose = project_board(BOARD.points, pose, own, kind)
    from scipy.spatial.transform import Rotation

    points = BOARD.points @ Rotation.from_rotvec(pose[:3]).as_matrix().T + pose[3:]
    np.testing.assert_allclose(theirs + HALF, pixels_of(points, camera), atol=1e-6)
    assert by_camera.shape == (24, 2, 8)
    step = np.zeros(6)
    step[4] = 1e-6
    ahead = project_board(BOARD.points, pose + step, own, kind)[0]
    np.testing.assert_allclose((ahead - theirs) / 1e-6, by_pose[..., 4], rtol=1e-3, atol=1e-2)
