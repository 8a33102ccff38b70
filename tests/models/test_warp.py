"""Pictures seen anew from one view: of a painted table they are that view's own picture."""

import jax
import numpy as np
import pytest

from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import NOMINAL_POSE, TABLE_HEIGHT
from jaxcam.models.crops import random_crop
from jaxcam.models.warp import plane_points, warped
from jaxcam.rays import look_at, plucker
from jaxcam.rays.intrinsics import intrinsics

SIZE = 40, 48
K = np.asarray(intrinsics(45, *SIZE), np.float32)
VIEW = plane_points(np.array(NOMINAL_POSE), 45, TABLE_HEIGHT, *SIZE)


def paint(x, y):
    """A colour for each point of the table, 40 to 215, smooth over a few centimetres."""
    waves = (np.sin(9 * x + 4 * y), np.cos(7 * y - 2 * x), np.sin(5 * x * y))
    return 127.5 + 87 * np.stack(waves, -1)


def picture(pose, distortion=None):
    """What a camera sees of the painted table, by where its rays meet the plane."""
    rays = np.asarray(plucker(K, pose, *SIZE, distortion=distortion), np.float64)
    d = rays[..., :3]
    along = (TABLE_HEIGHT - pose[2, 3]) / d[..., 2]
    x, y = (pose[i, 3] + along * d[..., i] for i in (0, 1))
    return np.where((along > 0)[..., None], paint(x, y), 0)


def observation(poses, distortion=None):
    lenses = {} if distortion is None else {"distortion": np.stack([[distortion] * len(poses)])}
    images = np.stack([picture(p, distortion) for p in poses]).astype(np.float32)
    shape = (1, len(poses), 3, 3)
    poses = np.stack(poses).astype(np.float32)[None]
    return {
        "image": images[None],
        "K": np.broadcast_to(K, shape),
        "base_from_camera": poses,
    } | lenses


def cameras():
    return [
        look_at(np.array(place), np.array([0.56, 0.0, TABLE_HEIGHT]))
        for place in ((1.2, 0.3, 0.5), (0.9, -0.6, 0.7))
    ]


LENS = np.array([-0.2, 0.05, 0.001, -0.002, 0, 0, 0, 0, 0], np.float32)


@pytest.mark.parametrize("distortion", [None, LENS], ids=["pinhole", "lens"])
def test_all_cameras_of_a_table_give_the_pictures_of_one_view(distortion):
    obs = observation(cameras(), distortion)
    viewed = np.asarray(jax.jit(lambda o: warped(o, o["base_from_camera"], *VIEW))(obs))
    assert viewed.shape == (1, 2, *SIZE, 3)
    expected = paint(VIEW[0][..., 0], VIEW[0][..., 1])
    for one in viewed[0]:
        there = (one > 30).all(-1)
        assert there.mean() > 0.3  # the rest is outside the picture, black
        assert np.abs(one - expected)[there].mean() < 2.5


def test_what_a_crop_shows_stays_where_it_was():
    obs = observation(cameras())
    crop = random_crop(obs, jax.random.key(1), smallest=0.6)
    assert not np.array_equal(crop["K"], obs["K"])
    whole, part = (np.asarray(warped(o, o["base_from_camera"], *VIEW)) for o in (obs, crop))
    both = (whole > 30).all(-1) & (part > 30).all(-1)
    assert both.mean() > 0.1
    assert np.abs(whole - part)[both].mean() < 6  # crops take the nearest pixel
    assert (part > 30).all(-1).sum() < (whole > 30).all(-1).sum()


def test_points_lie_on_the_plane_and_on_their_rays():
    points, sees = VIEW
    assert sees.all()
    np.testing.assert_allclose(points[..., 2], TABLE_HEIGHT, atol=1e-12)
    rays = np.asarray(plucker(K, np.array(NOMINAL_POSE), *SIZE), np.float64)
    np.testing.assert_allclose(np.cross(points, rays[..., :3]), rays[..., 3:], atol=1e-5)


def test_a_view_that_sees_no_table_is_refused_and_the_sky_is_black():
    level = look_at(np.array([1.0, 0.0, 0.5]), np.array([0.0, 0.0, 0.5]))
    points, sees = plane_points(level, 45, TABLE_HEIGHT, *SIZE)
    assert 0.3 < sees.mean() < 0.6
    assert np.isfinite(points).all()
    obs = observation(cameras())
    assert not np.asarray(warped(obs, obs["base_from_camera"], points, sees))[:, :, ~sees].any()
    up = look_at(np.array([1.0, 0.0, 0.5]), np.array([0.9, 0.0, 1.5]))
    with pytest.raises(ConfigError, match="does not see the plane"):
        plane_points(up, 45, TABLE_HEIGHT, *SIZE)
