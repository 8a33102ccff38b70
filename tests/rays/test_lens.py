"""Lenses: against OpenCV, a float64 bisection, finite differences, and their own inverse."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from rays_oracle import LENSES, oracle_distort, oracle_limit, random_camera, seeds

from jaxcam.errors import CameraError, ConfigError
from jaxcam.rays import Camera, patch_rays, plucker
from jaxcam.rays import lens as lenses

H, W = 48, 64
K0 = np.array([[40.0, 0, 31], [0, 42, 25], [0, 0, 1]])
EXACTLY = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-15)
some = settings(max_examples=25, deadline=None, derandomize=True)
every_lens = pytest.mark.parametrize("name", LENSES)


def camera_with(name, height=H, width=W, seed=3):
    kind, coefficients = LENSES[name]
    pose = random_camera(seed).world_from_camera
    scale = np.array([[width / W], [height / H], [1]])
    return Camera(K0 * scale, pose, height, width, np.array(coefficients), kind)


def by_opencv(camera):
    """Unit directions in camera axes by OpenCV's own solver, `[height, width, 3]`."""
    uv = np.asarray(camera.pixel_centres(), np.float64).reshape(-1, 1, 2)
    if camera.lens == "fisheye":
        xy = cv2.fisheye.undistortPoints(uv, camera.K, camera.distortion, criteria=EXACTLY)
    else:
        xy = cv2.undistortPoints(uv, camera.K, camera.distortion, criteria=EXACTLY)
    d = np.concatenate([xy.reshape(-1, 2), np.ones((len(uv), 1))], -1)
    return (d / np.linalg.norm(d, axis=-1, keepdims=True)).reshape(H, W, 3)


@every_lens
def test_rays_are_opencvs(name):
    camera = camera_with(name)
    rays = np.asarray(plucker(camera.K, np.eye(4), H, W, **lens_of(camera)), np.float64)
    want = by_opencv(camera)
    # Where OpenCV's iteration converged: its answer lands on the pixel.
    x, y = oracle_distort(want[..., 0] / want[..., 2], want[..., 1] / want[..., 2], *LENSES[name])
    landed = np.stack([x, y], -1) * [K0[0, 0], K0[1, 1]] + K0[:2, 2]
    converged = np.abs(landed - camera.pixel_centres()).max(-1) < 1e-8
    has_ray = camera.has_ray()
    assert (converged & has_ray).mean() > (0.5 if name == "folding" else 0.99)
    np.testing.assert_allclose(rays[converged & has_ray, :3], want[converged & has_ray], atol=1e-6)
    np.testing.assert_array_equal(rays[..., 3:], 0)  # the camera is at the origin


def lens_of(camera):
    return {"distortion": camera.distortion, "lens": camera.lens}


@every_lens
def test_points_are_put_where_opencv_puts_them(name):
    camera = camera_with(name)
    points = np.random.default_rng(0).uniform((-0.5, -0.4, 0.8), (0.5, 0.4, 2), (40, 3))
    if camera.lens == "fisheye":
        uv, _ = cv2.fisheye.projectPoints(
            points[:, None], np.zeros(3), np.zeros(3), camera.K, camera.distortion
        )
    else:
        uv, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    still = Camera(camera.K, np.eye(4), H, W, camera.distortion, camera.lens)
    got, depth = still.project(points)
    np.testing.assert_allclose(got, uv[:, 0], atol=1e-9)
    np.testing.assert_allclose(depth, points[:, 2])


@every_lens
def test_the_field_is_where_the_radial_map_rises(name):
    """Every point of the field has its pixel's ray; beyond it there is none, and nothing is NaN."""
    kind, coefficients = LENSES[name]
    limit = oracle_limit(kind, coefficients)
    around = np.linspace(0, 2 * np.pi, 7)[:, None]

    def at(angles):
        radius = np.tan(angles)
        return radius * np.cos(around), radius * np.sin(around)

    if limit < 1.4:
        beyond = at(np.array([limit + 1e-4, 1.5]))
        assert not lenses.distort(*beyond, np.array(coefficients), kind)[2].any()
    x, y = at(np.linspace(0, min(limit - 1e-2, 1.25), 50))
    x2, y2, inside = lenses.distort(x, y, np.array(coefficients), kind)
    assert inside.all()
    a, b, c = lenses.sight_lines(x2, y2, np.array(coefficients), kind)
    assert (c > 0).mean() > 0.85  # decentring moves the rim by a little
    np.testing.assert_allclose((a / np.where(c, c, 1))[c > 0], x[c > 0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose((b / np.where(c, c, 1))[c > 0], y[c > 0], rtol=1e-6, atol=1e-9)


def test_outside_the_field_there_is_no_ray_and_no_nan():
    camera = camera_with("folding")
    has_ray = camera.has_ray()
    assert 0.3 < has_ray.mean() < 0.95
    assert has_ray[H // 2, W // 2]
    assert not has_ray[0, 0]
    rays = np.asarray(camera.plucker())
    assert np.isfinite(rays).all()
    np.testing.assert_array_equal((rays != 0).any(-1), has_ray)
    points = camera.unproject(np.ones((H, W)))
    np.testing.assert_array_equal(points[~has_ray] - camera.centre, 0)
    behind = np.array([[0.0, 0, -1], [30.0, 0, 1.0], [0.1, 0.1, 1.0]])
    world = behind @ camera.world_from_camera[:3, :3].T + camera.centre
    uv, depth = camera.project(world)
    assert np.isfinite(uv).all()
    np.testing.assert_array_equal(depth > 0, [False, False, True])
    jax_uv, jax_depth = jax.jit(lambda c, p: c.project(p))(camera, jnp.asarray(world))
    assert np.isfinite(jax_uv).all()
    np.testing.assert_array_equal(jax_depth > 0, [False, False, True])


@every_lens
def test_unproject_undoes_project(name):
    camera = camera_with(name)
    depth = np.random.default_rng(0).uniform(0.2, 4, (H, W))
    has_ray = camera.has_ray()
    uv, z = camera.project(camera.unproject(depth))
    # At the very rim, rounding decides on which side of it a point is.
    rim = has_ray & (z < 0)
    assert rim.mean() < 0.01
    np.testing.assert_allclose(z[has_ray & ~rim], depth[has_ray & ~rim])
    np.testing.assert_allclose(
        uv[has_ray & ~rim], camera.pixel_centres()[has_ray & ~rim], atol=1e-6
    )


@every_lens
def test_image_operations_keep_each_pixels_ray(name):
    camera = camera_with(name)
    whole = np.asarray(camera.plucker())
    np.testing.assert_allclose(camera.crop(8, 12, 24, 40).plucker(), whole[8:32, 12:52], atol=2e-5)
    np.testing.assert_allclose(camera.flip_horizontal().plucker(), whole[:, ::-1], atol=2e-5)
    np.testing.assert_allclose(camera.resize(3 * H, 5 * W).plucker()[1::3, 2::5], whole, atol=2e-5)
    point = camera.unproject(np.array(2.0), np.array([30.2, 21.1]))
    for changed, want in (
        (camera.crop(1, 2, 30, 40), [28.2, 20.1]),
        (camera.resize(2 * H, 3 * W), [90.6, 42.2]),
        (camera.flip_horizontal(), [W - 30.2, 21.1]),
    ):
        np.testing.assert_allclose(changed.project(point)[0], want, atol=1e-6)


def test_no_coefficients_are_a_pinhole():
    camera = random_camera(5, H, W)
    for kind, zeros in (("opencv", 4), ("opencv", 5), ("opencv", 8), ("opencv", 9)):
        got = plucker(
            camera.K, camera.world_from_camera, H, W, distortion=np.zeros(zeros), lens=kind
        )
        np.testing.assert_allclose(got, camera.plucker(), atol=2e-6)


def test_authors_convention_bends_alike():
    camera = camera_with("five")
    shifted = Camera(
        camera.K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]),
        *(camera.world_from_camera,),
        H,
        W,
        camera.distortion,
    )
    want = np.roll(shifted.plucker(), 3, axis=-1)
    np.testing.assert_allclose(camera.plucker(convention="authors"), want, atol=2e-6)


def test_views_with_lenses_of_both_kinds_and_none_share_a_batch():
    views = [camera_with("five"), camera_with("fisheye"), camera_with("eight")]
    packed = np.stack([*(lenses.pack(c.distortion, c.lens) for c in views), np.zeros(9)])
    batch = np.stack([packed, packed[::-1]]).astype(np.float32)  # [B, V, D]
    pose = views[0].world_from_camera
    got = plucker(K0, pose, H, W, distortion=batch)
    assert got.shape == (2, 4, H, W, 6)
    for i, camera in enumerate(views):
        np.testing.assert_allclose(got[0, i], camera.plucker(), atol=2e-6)
        np.testing.assert_allclose(got[1, 3 - i], camera.plucker(), atol=2e-6)
    np.testing.assert_allclose(got[0, 3], plucker(K0, pose, H, W), atol=2e-6)
    shared = Camera(K0, pose, H, W, batch, "opencv")
    assert shared.batch == (2, 4)
    mapped = jax.vmap(jax.vmap(lambda d: plucker(K0, pose, H, W, distortion=d)))(batch)
    np.testing.assert_allclose(mapped, got, atol=2e-6)
    uv, _ = shared.project(np.broadcast_to(views[0].unproject(np.ones((H, W)))[5, 6], (2, 4, 3)))
    np.testing.assert_allclose(uv[0, 0], [6.5, 5.5], atol=1e-5)


@jax.jit
def weighted_gradients(weight, K, coefficients):
    def value(k, d):
        return jnp.sum(weight * plucker(k, jnp.eye(4), 5, 7, distortion=d))

    return jax.grad(value, (0, 1))(K, coefficients)


@every_lens
def test_gradients_match_finite_differences_in_float64(name):
    kind, coefficients = LENSES[name]
    coefficients = lenses.pack(np.array(coefficients), kind)
    K = np.array([[12.0, 0.1, 3.5], [0, 11, 2.5], [0, 0, 1]])  # a pixel's centre on the axis
    rng = np.random.default_rng(0)
    weight = rng.normal(size=(5, 7, 6))
    weight[..., 3:] = 0
    gK, gd = weighted_gradients(weight, K, coefficients)
    u, v = np.arange(7) + 0.5, np.arange(5)[:, None] + 0.5

    def value(K, d):
        line = np.stack(lenses.sight_lines(*lenses.normalised(K, u, v), d, "opencv"), -1)
        return np.sum(weight[..., :3] * line / np.linalg.norm(line, axis=-1, keepdims=True))

    h = 1e-6
    for got, index in ((gK, (0, 0)), (gK, (0, 2)), (gK, (1, 1)), (gK, (1, 2))):
        step = np.zeros((3, 3))
        step[index] = h
        want = (value(K + step, coefficients) - value(K - step, coefficients)) / (2 * h)
        np.testing.assert_allclose(got[index], want, rtol=1e-3, atol=1e-4)
    for i in range(4 if kind == "fisheye" else len(LENSES[name][1])):
        step = h * np.eye(9)[i]
        want = (value(K, coefficients + step) - value(K, coefficients - step)) / (2 * h)
        np.testing.assert_allclose(gd[i], want, rtol=1e-3, atol=1e-4)


def test_gradients_are_finite_outside_the_field():
    camera = camera_with("folding")
    gradient = jax.jit(jax.grad(lambda c: jnp.sum(c.plucker() ** 2 * 0.5 + c.plucker())))(camera)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


@some
@given(seeds)
def test_random_lenses_in_both_precisions(seed):
    """Distorted by the definition, undone by the solver, wherever the map is steep enough."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=5) * [0.25, 0.1, 2e-3, 2e-3, 0.03]
    angle = 0.95 * min(oracle_limit("opencv", d), 1.0) * np.sqrt(rng.uniform(size=300))
    around = rng.uniform(0, 2 * np.pi, 300)
    x, y = np.tan(angle) * np.cos(around), np.tan(angle) * np.sin(around)
    x2, y2 = oracle_distort(x, y, "opencv", d)
    h = 1e-6
    (ax, ay), (bx, by) = (
        [(p - q) / (2 * h) for p, q in zip(*pair, strict=True)]
        for pair in (
            (oracle_distort(x + h, y, "opencv", d), oracle_distort(x - h, y, "opencv", d)),
            (oracle_distort(x, y + h, "opencv", d), oracle_distort(x, y - h, "opencv", d)),
        )
    )
    steep = ax * by - ay * bx > 0.3  # nearer to the rim, rounding and decentring lose some
    a, b, c = lenses.sight_lines(x2, y2, d, "opencv")
    assert (c[steep] == 1).all()
    np.testing.assert_allclose(a[steep], x[steep], atol=1e-9)
    np.testing.assert_allclose(b[steep], y[steep], atol=1e-9)
    single = lenses.sight_lines(*(jnp.asarray(v, jnp.float32) for v in (x2, y2, d)), "opencv")
    np.testing.assert_allclose(single[0][steep], x[steep], atol=5e-5)
    assert (single[2][steep] == 1).all()


def test_bad_coefficients_are_refused():
    with pytest.raises(CameraError, match=r"Expected \[\.\.\., 4 or 5 or 8 or 9\].*got \[12\]"):
        plucker(K0, np.eye(4), H, W, distortion=np.zeros(12))
    with pytest.raises(CameraError, match="column instead of a row"):
        plucker(K0, np.eye(4), H, W, distortion=np.zeros((5, 1)))
    with pytest.raises(CameraError, match="failed calibration"):
        plucker(K0, np.eye(4), H, W, distortion=[0.1, np.nan, 0, 0])
    with pytest.raises(CameraError, match="ninth coefficient"):
        plucker(K0, np.eye(4), H, W, distortion=np.full(9, 0.1))
    with pytest.raises(ConfigError, match="did you mean 'fisheye'"):
        Camera(K0, np.eye(4), H, W, np.zeros(4), "fish-eye").validate()
    with pytest.raises(CameraError, match=r"^demo_1/wrist: values of distortion"):
        Camera(K0, np.eye(4), H, W, np.full(4, np.inf)).validate("demo_1/wrist")


@pytest.mark.parametrize("name", [None, "five", "fisheye"])
def test_rays_of_patches_are_those_of_their_centres(name):
    camera = random_camera(2, H, W) if name is None else camera_with(name)
    lens = {} if name is None else lens_of(camera)
    got = np.asarray(patch_rays(camera.K, camera.world_from_camera, H, W, 16, **lens))
    assert got.shape == (3, 4, 6)
    # The centre of a patch is the corner of four pixels: one pixel of a camera moved by a half.
    whole = camera.crop(-0.5, -0.5, H, W).plucker()
    np.testing.assert_allclose(got, np.asarray(whole)[8::16, 8::16], atol=4e-6)
    odd = patch_rays(camera.K, camera.world_from_camera, H, W, 1, **lens)
    np.testing.assert_allclose(odd, camera.plucker(), atol=2e-6)


def test_patches_must_tile_the_image():
    with pytest.raises(CameraError, match="patches of 7 pixels do not tile an image of 48 x 64"):
        patch_rays(K0, np.eye(4), H, W, 7)
