"""The ray-map: against an oracle, the authors' numbers, and the properties that define it."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest
from hypothesis import given, settings
from rays_oracle import oracle, random_camera, random_poses, seeds

import jaxcam.rays
from jaxcam.errors import ConfigError
from jaxcam.rays import Camera, opencv_from_opengl, plucker

GOLDEN = json.loads((places.GOLDEN / "rays.json").read_text())
H, W = 6, 9
some = settings(max_examples=25, deadline=None, derandomize=True)


def split(ray_map):
    return np.asarray(ray_map[..., :3], np.float64), np.asarray(ray_map[..., 3:], np.float64)


@some
@given(seeds)
def test_matches_float64_oracle(seed):
    camera = random_camera(seed)
    got = plucker(camera.K, camera.world_from_camera, H, W)
    want = oracle(camera.K, camera.world_from_camera, H, W)
    np.testing.assert_allclose(got, want, atol=2e-6)
    assert got.shape == (H, W, 6)
    assert got.dtype == jnp.float32


@some
@given(seeds)
def test_authors_convention_is_the_oracle_in_their_terms(seed):
    camera = random_camera(seed)
    got = plucker(camera.K, camera.world_from_camera, H, W, convention="authors")
    pose = opencv_from_opengl(camera.world_from_camera)
    want = np.roll(oracle(camera.K, pose, H, W, offset=1.0), 3, axis=-1)
    np.testing.assert_allclose(got, want, atol=2e-6)
    via_record = Camera(camera.K, pose, H, W).plucker(convention="authors")
    np.testing.assert_array_equal(via_record, got)


@pytest.mark.parametrize("convention", ["authors", "pixel_centres"])
def test_golden_numbers_of_the_first_test_pose(convention):
    pose = np.array(GOLDEN["poses"]["test_seed23_first2"][0])
    camera = Camera.from_fovy(np.pi / 4, 256, 256, opencv_from_opengl(pose))
    if convention == "authors":
        got = plucker(camera.K, pose, 256, 256, convention="authors")
    else:
        got = jnp.roll(camera.plucker(), 3, axis=-1)
    for where, want in GOLDEN["rays"][convention].items():
        row, column = map(int, where.split(","))
        np.testing.assert_allclose(got[row, column], want, atol=1e-6)


@some
@given(seeds)
def test_directions_are_unit_and_moments_are_normal_to_them(seed):
    d, m = split(random_camera(seed).plucker())
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.sum(d * m, axis=-1), 0, atol=1e-6)


@some
@given(seeds)
def test_rays_pass_through_the_centre_and_through_what_the_pixel_sees(seed):
    camera = random_camera(seed)
    d, m = split(camera.plucker())
    depth = np.random.default_rng(seed).uniform(0.3, 3, (H, W))
    surface = camera.unproject(depth)
    for point in (camera.centre, surface):
        np.testing.assert_allclose(np.cross(point, d), m, atol=4e-6)
    # In front of the camera, not behind it.
    assert (np.sum(d * (surface - camera.centre), axis=-1) > 0).all()


@some
@given(seeds)
def test_moving_along_a_ray_keeps_that_ray(seed):
    camera = random_camera(seed)
    before = camera.plucker()
    pose = camera.world_from_camera.copy()
    pose[:3, 3] += 0.7 * np.asarray(before[2, 3, :3], np.float64)
    after = plucker(camera.K, pose, H, W)
    np.testing.assert_allclose(after[2, 3], before[2, 3], atol=2e-6)
    assert np.abs(after[..., 3:] - before[..., 3:]).max() > 1e-3


@some
@given(seeds)
def test_rigid_motion_acts_by_the_adjoint(seed):
    camera = random_camera(seed)
    motion = random_poses(np.random.default_rng(seed + 1))
    R, t = motion[:3, :3], motion[:3, 3]
    d, m = split(camera.plucker())
    moved_d, moved_m = split(camera.in_frame(motion).plucker())
    np.testing.assert_allclose(moved_d, d @ R.T, atol=2e-6)
    np.testing.assert_allclose(moved_m, m @ R.T + np.cross(t, d @ R.T), atol=6e-6)


@pytest.mark.parametrize("batch", [(), (1,), (2, 1, 3)])
def test_batch_axes(batch):
    camera = random_camera(3, batch=batch)
    got = plucker(camera.K, camera.world_from_camera, H, W)
    assert got.shape == (*batch, H, W, 6)
    for index in np.ndindex(*batch):
        want = oracle(camera.K[index], camera.world_from_camera[index], H, W)
        np.testing.assert_allclose(got[index], want, atol=2e-6)


def test_batch_axes_broadcast_between_intrinsics_and_pose():
    one, many = random_camera(0), random_camera(1, batch=(4,))
    shared_K = plucker(one.K, many.world_from_camera, H, W)
    shared_pose = plucker(many.K[:, None], many.world_from_camera[None], H, W)
    assert shared_K.shape == (4, H, W, 6)
    assert shared_pose.shape == (4, 4, H, W, 6)
    np.testing.assert_allclose(
        shared_K[2], plucker(one.K, many.world_from_camera[2], H, W), atol=1e-6
    )
    np.testing.assert_allclose(
        shared_pose[1, 3], plucker(many.K[1], many.world_from_camera[3], H, W), atol=1e-6
    )


def test_jit_and_vmap_agree_with_the_plain_call():
    camera = random_camera(5, batch=(3,))
    K, pose = jnp.asarray(camera.K), jnp.asarray(camera.world_from_camera)
    plain = plucker(camera.K, camera.world_from_camera, H, W)
    np.testing.assert_allclose(
        jax.jit(plucker, static_argnums=(2, 3))(K, pose, H, W), plain, atol=1e-6
    )
    np.testing.assert_allclose(
        jax.vmap(lambda k, x: plucker(k, x, H, W))(K, pose), plain, atol=1e-6
    )


@jax.jit
def weighted_sum_gradients(weight, K, X):
    return jax.grad(lambda k, x: jnp.sum(weight * plucker(k, x, 3, 4)), (0, 1))(K, X)


@some
@given(seeds)
def test_gradients_match_finite_differences_of_the_oracle(seed):
    camera = random_camera(seed, 3, 4)
    rng = np.random.default_rng(seed)
    weight = rng.normal(size=(3, 4, 6))
    dK, dX = rng.normal(size=(3, 3)), rng.normal(size=(4, 4))
    dK[2], dK[1, 0], dX[3] = 0, 0, 0

    gK, gX = weighted_sum_gradients(weight, camera.K, camera.world_from_camera)
    assert np.isfinite(gK).all()
    assert np.isfinite(gX).all()
    got = np.sum(gK * dK) + np.sum(gX * dX)
    h = 1e-6
    ahead, behind = (
        np.sum(weight * oracle(camera.K + s * dK, camera.world_from_camera + s * dX, 3, 4))
        for s in (h, -h)
    )
    np.testing.assert_allclose(got, (ahead - behind) / (2 * h), rtol=1e-3, atol=1e-3)


def test_float32_also_with_x64_on():
    camera = random_camera(2)
    with jax.enable_x64(True):
        assert plucker(camera.K, camera.world_from_camera, H, W).dtype == jnp.float32


def test_checks_add_nothing_to_a_compiled_program():
    K, pose = jnp.eye(3), jnp.eye(4)
    checked = jax.make_jaxpr(lambda k, x: plucker(k, x, H, W))(K, pose)
    (only,) = checked.eqns  # the ray-map's own program: the checks are beside it
    assert only.params["name"] == "rays"
    assert "callback" not in str(checked)


def test_nothing_is_multiplied_as_a_matrix():
    """No dot products, hence no TF32 or bfloat16 rounding on any device."""
    program = jax.make_jaxpr(lambda k, x: plucker(k, x, H, W))(jnp.eye(3), jnp.eye(4))
    assert "dot_general" not in str(program)


def test_numpy_dtypes_and_lists_share_one_compiled_program(caplog):
    camera = random_camera(4, 5, 11)
    K, pose = camera.K, camera.world_from_camera
    first = plucker(K, pose, 5, 11)
    with caplog.at_level("WARNING"), jax.log_compiles():
        np.testing.assert_array_equal(plucker(K.tolist(), pose.tolist(), 5, 11), first)
        np.testing.assert_array_equal(plucker(K.astype(np.float32), pose, np.int64(5), 11), first)
        assert "Compiling" not in caplog.text
        plucker(K, pose, 5, 12)
        assert "Compiling" in caplog.text


def test_both_ways_of_calling():
    assert callable(jaxcam.rays.plucker)
    assert jaxcam.rays.plucker is plucker


def test_unknown_convention_names_the_known_ones():
    with pytest.raises(ConfigError, match=r"'author', did you mean 'authors'\? Known: jaxcam"):
        plucker(*_valid(), H, W, convention="author")


def _valid():
    camera = random_camera(0)
    return camera.K, camera.world_from_camera
