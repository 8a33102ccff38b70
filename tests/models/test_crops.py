"""Crops move the intrinsics with the pixels: the ray of a pixel stays the ray of what it shows."""

import jax
import numpy as np
import pytest

from jaxcam.models.crops import random_crop
from jaxcam.rays import plucker, sample_poses
from jaxcam.sim.tasks.lift import Lift

HEIGHT, WIDTH = 40, 50
BATCH, VIEWS = 16, 2


def coordinate_batch():
    """Pictures whose pixels hold their own row and column."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    picture = np.stack([rows, columns, 0 * rows], -1).astype(np.uint8)
    K = np.array([[45.0, 0, 22], [0, 47, 23], [0, 0, 1]], np.float32)
    return {
        "image": np.broadcast_to(picture, (BATCH, VIEWS, HEIGHT, WIDTH, 3)),
        "K": np.broadcast_to(K, (BATCH, VIEWS, 3, 3)),
        "action": np.arange(BATCH),
    }


@pytest.fixture(scope="module")
def crop():
    return jax.jit(lambda batch, key: random_crop(batch, key, smallest=0.6))


@pytest.fixture(scope="module")
def cropped(crop):
    return jax.tree.map(np.asarray, crop(coordinate_batch(), jax.random.key(0)))


def source(cropped):
    """Row and column that every pixel was copied from, float [B, V, H, W, 2]."""
    return np.asarray(cropped["image"])[..., :2].astype(float)


def test_new_intrinsics_point_at_the_pixel_that_was_copied(cropped):
    # A pixel's centre, taken by the new K to the old picture, lies inside the pixel it shows.
    old = coordinate_batch()["K"]
    centres = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), -1)
    focal = np.stack([cropped["K"][..., 0, 0], cropped["K"][..., 1, 1]], -1)[:, :, None, None]
    middle = cropped["K"][..., None, None, :2, 2]
    x = (centres - middle) / focal
    there = x * [old[0, 0, 0, 0], old[0, 0, 1, 1]] + old[0, 0, :2, 2]
    shown = source(cropped)[..., ::-1] + 0.5
    assert abs(there - shown).max() < 0.5 + 1e-3
    assert abs((there - shown).mean((2, 3))).max() < 0.06  # not shifted to one side


def test_crop_then_rays_equals_rays_then_crop(cropped):
    poses = sample_poses(Lift.cameras, BATCH * VIEWS, 0).reshape(BATCH, VIEWS, 4, 4)
    before = np.asarray(plucker(coordinate_batch()["K"], poses, HEIGHT, WIDTH))
    after = np.asarray(plucker(cropped["K"], poses, HEIGHT, WIDTH))
    rows, columns = (source(cropped)[..., k].astype(int) for k in (0, 1))
    b, v = np.ogrid[:BATCH, :VIEWS]
    copied = before[b[..., None, None], v[..., None, None], rows, columns]
    # Half a pixel at f = 45 is 0.011 rad; one pixel of error would show.
    angle = np.linalg.norm(np.cross(copied[..., :3], after[..., :3]), axis=-1)
    assert angle.max() < 0.5 * np.hypot(1 / 45, 1 / 47) + 1e-4
    # Where the old pixel's centre is hit exactly, so is its ray.
    exact = angle < 1e-5
    assert exact.any()
    np.testing.assert_allclose(after[exact], copied[exact], atol=1e-4)


def test_every_view_draws_its_own_square_in_range(cropped):
    sources = source(cropped)
    extent = np.ptp(sources, axis=(2, 3)) + 1
    assert sources.min() == 0
    assert extent.min() >= 0.6 * 40 - 1
    assert (extent <= [HEIGHT, WIDTH]).all()
    assert len(np.unique(extent[..., 1])) > 8
    np.testing.assert_allclose(extent[..., 0] / HEIGHT, extent[..., 1] / WIDTH, atol=0.06)
    corners = sources[:, :, 0, 0]
    assert (corners[:, 0] != corners[:, 1]).any(-1).mean() > 0.8
    assert len(np.unique(corners.reshape(-1, 2), axis=0)) > BATCH
    assert (sources[:, :, -1, -1] <= [HEIGHT - 1, WIDTH - 1]).all()
    np.testing.assert_array_equal(cropped["action"], np.arange(BATCH))


def test_the_key_decides(crop, cropped):
    again = crop(coordinate_batch(), jax.random.key(0))
    other = crop(coordinate_batch(), jax.random.key(1))
    np.testing.assert_array_equal(again["image"], cropped["image"])
    np.testing.assert_array_equal(again["K"], cropped["K"])
    assert (np.asarray(other["K"]) != cropped["K"]).any((2, 3)).all()


def test_off_leaves_the_batch_as_it_is():
    batch = coordinate_batch()
    assert random_crop(batch, jax.random.key(0), smallest=1.0) is batch
