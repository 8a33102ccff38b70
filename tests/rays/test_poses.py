"""Pose sampling against the authors' released sets, the camera schedule, and pose noise."""

import json
from dataclasses import replace

import jax
import jaxlie
import numpy as np
import places
import pytest
from rays_oracle import random_poses

from jaxcam.errors import ConfigError
from jaxcam.rays import (
    POSE_RANGES,
    Camera,
    opengl_from_opencv,
    perturb,
    sample_poses,
    spherical,
    stair,
    stair_cameras,
)

GOLDEN = json.loads((places.GOLDEN / "rays.json").read_text())["poses"]
ROBOSUITE = POSE_RANGES["robosuite"]


@pytest.mark.parametrize(("name", "seed"), [("train_seed1_first2", 1), ("test_seed23_first2", 23)])
def test_released_pose_sets(name, seed):
    got = sample_poses(ROBOSUITE, 2, seed)
    np.testing.assert_allclose(opengl_from_opencv(got), GOLDEN[name], rtol=0, atol=1e-12)
    assert got.dtype == np.float64


def test_the_first_poses_do_not_depend_on_the_count():
    np.testing.assert_array_equal(
        sample_poses(ROBOSUITE, 20, seed=4)[:3], sample_poses(ROBOSUITE, 3, seed=4)
    )
    assert sample_poses(ROBOSUITE, 0, seed=4).shape == (0, 4, 4)


@pytest.mark.parametrize("name", POSE_RANGES)
def test_samples_lie_in_their_ranges_and_fill_them(name):
    ranges = POSE_RANGES[name]
    poses = sample_poses(ranges, 300, seed=0)
    Camera.from_fovy(0.8, 64, 64, poses).validate(name)
    azimuth, elevation, distance = spherical(poses, ranges.centre)
    slack = 1e-9
    inside = [(low - slack <= azimuth) & (azimuth <= high + slack) for low, high in ranges.azimuth]
    assert np.any(inside, axis=0).all()
    for interval in inside:
        np.testing.assert_allclose(interval.mean(), 1 / len(inside), atol=0.12)
    for value, (low, high) in ((elevation, ranges.elevation), (distance, ranges.distance)):
        assert (value >= low - slack).all()
        assert (value <= high + slack).all()
        assert np.ptp(value) > 0.9 * (high - low)


def test_separated_sets_share_all_but_the_azimuth_interval():
    train = sample_poses(POSE_RANGES["robosuite_separated_train"], 50, seed=42)
    test = sample_poses(POSE_RANGES["robosuite_separated_test"], 50, seed=42)
    centre = ROBOSUITE.centre
    (a, e, d), (b, f, g) = spherical(train, centre), spherical(test, centre)
    np.testing.assert_allclose(e, f, atol=1e-12)
    np.testing.assert_allclose(d, g, atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(b - a), 30, atol=1e-9)


def test_cameras_look_into_the_box():
    """The optical axis meets the plane of each sampled look-at point inside the box."""
    point = replace(ROBOSUITE, look_at=((0.1, 0.1), (-0.05, -0.05), (0.0, 0.0)))
    camera = Camera.from_fovy(0.8, 64, 64, sample_poses(point, 10, seed=0))
    uv, depth = camera.project(np.array([[0.1, -0.05, 0.8]]))
    np.testing.assert_allclose(uv, 32, atol=1e-9)
    assert (depth > 0.4).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distance": (0.0, 1.0)}, "distance must be positive"),
        ({"elevation": (30.0, 60.0)}, "not degrees"),
        ({"elevation": (0.6, 0.5)}, "empty"),
        ({"distance": (1.0, np.inf)}, "finite numbers up to"),
        ({"distance": (1e39, 1e39)}, "finite numbers up to"),
        ({"azimuth": ((0.0, np.nan),)}, "finite numbers up to"),
        ({"centre": (0.0, -1e39, 0.0)}, "finite numbers up to"),
        ({"azimuth": ()}, "at least one"),
        ({"azimuth": ((0.0, 1.0), (0.5, 2.0))}, "not overlap"),
    ],
)
def test_impossible_ranges(change, message):
    with pytest.raises(ConfigError, match=message):
        replace(ROBOSUITE, **change)


@pytest.mark.parametrize(("n", "m", "cameras"), [(3, 1, 202), (4, 2, 402), (5, 0, 5), (2, 2, 400)])
def test_stair(n, m, cameras):
    schedule = stair(200, n, m)
    assert schedule.shape == (200, n)
    np.testing.assert_array_equal(schedule[7], np.arange(7 * m, 7 * m + n))
    assert stair_cameras(200, n, m) == cameras == schedule.max() + 1
    assert len(np.unique(schedule)) == cameras


@pytest.mark.parametrize(("demos", "n", "m"), [(0, 3, 1), (5, 1, 2), (5, 3, -1), (5, 0, 0)])
def test_impossible_stairs(demos, n, m):
    with pytest.raises(ConfigError, match="n >= m >= 0"):
        stair(demos, n, m)


@pytest.mark.parametrize(("rotation", "translation"), [(0.1, 0.03), (1e-3, 0.0), (3.0, 1.0)])
def test_noise_has_exactly_the_asked_size(rotation, translation):
    poses = random_poses(np.random.default_rng(0), (50,))
    noisy = perturb(poses, jax.random.key(0), rotation, translation)
    before = jaxlie.SE3.from_matrix(jax.numpy.asarray(poses, jax.numpy.float32))
    relative = before.inverse() @ jaxlie.SE3.from_matrix(noisy)
    angle = np.linalg.norm(relative.rotation().log(), axis=-1)
    np.testing.assert_allclose(angle, rotation, rtol=1e-3, atol=2e-6)
    distance = np.linalg.norm(noisy[:, :3, 3] - poses[:, :3, 3], axis=-1)
    np.testing.assert_allclose(distance, translation, rtol=1e-4, atol=1e-6)
    Camera.from_fovy(0.8, 64, 64, noisy).validate()


def test_noise_points_everywhere_and_follows_its_key():
    poses = np.tile(np.eye(4), (2000, 1, 1))
    noisy = perturb(poses, jax.random.key(1), 0.2, 1.0)
    axes = np.asarray(jaxlie.SO3.from_matrix(noisy[:, :3, :3]).log()) / 0.2
    for directions in (np.asarray(noisy[:, :3, 3]), axes):
        np.testing.assert_allclose(directions.mean(0), 0, atol=0.06)
        np.testing.assert_allclose(directions.T @ directions / 2000, np.eye(3) / 3, atol=0.04)
    np.testing.assert_array_equal(perturb(poses, jax.random.key(1), 0.2, 1.0), noisy)
    assert np.abs(perturb(poses, jax.random.key(2), 0.2, 1.0) - noisy).max() > 0.1


def test_noise_of_many_sizes_under_jit():
    poses = random_poses(np.random.default_rng(0), (3,))
    sizes = np.array([0.0, 0.1, 0.2], np.float32)
    noisy = jax.jit(perturb)(poses, jax.random.key(0), sizes, sizes)
    np.testing.assert_allclose(noisy[0], poses[0], atol=1e-6)
    moved = np.linalg.norm(noisy[:, :3, 3] - poses[:, :3, 3], axis=-1)
    np.testing.assert_allclose(moved, sizes, atol=1e-6)


def test_spherical_of_known_places():
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = [[1, 0, 0.8], [0, 2, 0.8], [-1, 0, 1.8]]
    azimuth, elevation, distance = spherical(poses, ROBOSUITE.centre)
    np.testing.assert_allclose(azimuth, [0, np.pi / 2, np.pi])
    np.testing.assert_allclose(elevation, [0, 0, np.pi / 4], atol=1e-12)
    np.testing.assert_allclose(distance, [1, 2, np.sqrt(2)])


def test_gradients_of_spherical_are_finite_on_the_axis_and_at_the_centre():
    def gradient(position):
        pose = jax.numpy.eye(4).at[:3, 3].set(jax.numpy.array(position, jax.numpy.float32))
        return jax.jacobian(lambda p: jax.numpy.stack(spherical(p, np.zeros(3))))(pose)[:, :3, 3]

    # d azimuth, d elevation, d distance by x, y, z: on the axis only the distance has one.
    for z in (2.0, -2.0):
        want = [[0, 0, 0], [0, 0, 0], [0, 0, np.sign(z)]]
        np.testing.assert_allclose(gradient([0, 0, z]), want, atol=1e-6)
    np.testing.assert_array_equal(gradient([0, 0, 0]), 0)
    assert np.isfinite(gradient([1e-30, -1e-30, 1.0])).all()
    beside = [[0, 0.5, 0], [-0.25, 0, 0.25], [np.sqrt(0.5), 0, np.sqrt(0.5)]]
    np.testing.assert_allclose(gradient([2, 0, 2]), beside, atol=1e-6)
    # The values themselves are what they were.
    pose = jax.numpy.eye(4).at[2, 3].set(-3.0)
    np.testing.assert_allclose(spherical(pose, np.zeros(3)), [0, -np.pi / 2, 3], rtol=1e-6)
