"""Attention that knows the frames of its tokens: the authors' numbers, and what does not matter."""

import importlib.util
import os
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from places import GOLDEN

from jaxcam.models.fusion import token_frames
from jaxcam.models.token_frames import camera_projections, cell_angles, ray_angles
from jaxcam.rays.rotations import matrix_from_rotvec

spec = importlib.util.spec_from_file_location("make_prope", GOLDEN / "make_prope.py")
make_prope = importlib.util.module_from_spec(spec)
spec.loader.exec_module(make_prope)
GRID = make_prope.ROWS, make_prope.COLUMNS
WAYS = ("prope", "gta", "ray_rope")


def framed_attention(way, made, extra=0):
    """Attention by softmax in NumPy's order, between tokens of pictures and `extra` of the base."""
    config = SimpleNamespace(
        frames_tokens=True, network=way, conditioning=way, ray_convention="jaxcam"
    )
    images = np.zeros((make_prope.BATCH, make_prope.VIEWS, make_prope.HEIGHT, make_prope.WIDTH, 3))
    framing = token_frames(config, made | {"image": images}, GRID, make_prope.CHANNELS)
    q, k, v = (jnp.asarray(made[n]) for n in "qkv")
    if extra:
        q, k, v = (jnp.concatenate([x, x[:, :extra]], 1) for x in (q, k, v))
    q, k, v = framing.query(q), framing.read(k), framing.read(v)
    scores = jnp.einsum("bnhd,bmhd->bhnm", q, k, precision="highest") / q.shape[-1] ** 0.5
    mixed = jnp.einsum("bhnm,bmhd->bnhd", jax.nn.softmax(scores), v, precision="highest")
    return np.asarray(framing.output(mixed))


@pytest.mark.parametrize("way", ["prope", "gta"])
def test_attention_is_that_of_the_reference_code(way):
    got = framed_attention(way, make_prope.inputs())
    np.testing.assert_allclose(got, np.load(GOLDEN / "prope.npz")[way], atol=1e-5)


@pytest.mark.skipif("PROPE_REFERENCE" not in os.environ, reason="needs PROPE_REFERENCE=.../jax.py")
def test_the_golden_numbers_are_the_reference_codes():
    golden = np.load(GOLDEN / "prope.npz")
    for way, values in make_prope.reference(os.environ["PROPE_REFERENCE"]).items():
        np.testing.assert_allclose(values, golden[way], atol=1e-6)
        np.testing.assert_allclose(framed_attention(way, make_prope.inputs()), values, atol=1e-5)


def motion():
    motion = np.eye(4, dtype=np.float32)
    motion[:3, :3] = matrix_from_rotvec(np.array([0.3, -0.5, 0.8]))
    motion[:3, 3] = 0.4, -0.2, 0.1
    return motion


@pytest.mark.parametrize("way", ["prope", "gta"])
def test_a_common_motion_of_all_cameras_changes_nothing_and_one_of_a_single_one_does(way):
    made = make_prope.inputs()
    here, poses = framed_attention(way, made), made["base_from_camera"]
    together = framed_attention(way, made | {"base_from_camera": motion() @ poses})
    np.testing.assert_allclose(together, here, atol=2e-5)
    alone = poses.copy()
    alone[:, 1] = motion() @ alone[:, 1]
    assert np.abs(framed_attention(way, made | {"base_from_camera": alone}) - here).max() > 0.01


def test_ray_angles_turn_about_the_vertical_together():
    """RoPE of azimuths is relative about the base's z, where all cameras turn by one angle."""
    made = make_prope.inputs()
    here, poses, turn = framed_attention("ray_rope", made), made["base_from_camera"], motion()
    turn[:3, :3] = matrix_from_rotvec(np.array([0, 0, 1.3]))
    together = framed_attention("ray_rope", made | {"base_from_camera": turn @ poses})
    np.testing.assert_allclose(together, here, atol=2e-5)
    tilted = framed_attention("ray_rope", made | {"base_from_camera": motion() @ poses})
    assert np.abs(tilted - here).max() > 0.01
    moved = poses.copy()
    moved[..., :3, 3] += 0.3  # directions do not know where a camera stands
    moved = framed_attention("ray_rope", made | {"base_from_camera": moved})
    np.testing.assert_array_equal(moved, here)


@pytest.mark.parametrize("way", WAYS)
def test_tokens_of_the_base_see_where_a_single_camera_stands(way):
    """A picture's own tokens cannot tell; an action's query, which stands in the base, can."""
    made = {n: v[:, : GRID[0] * GRID[1]] for n, v in make_prope.inputs().items() if n in "qkv"}
    cameras = {n: make_prope.inputs()[n][:, :1] for n in ("K", "base_from_camera")}
    here = framed_attention(way, made | cameras)
    there = cameras | {"base_from_camera": motion() @ cameras["base_from_camera"]}
    if way != "ray_rope":
        np.testing.assert_allclose(framed_attention(way, made | there), here, atol=2e-5)
    extra = 2
    here, there = (framed_attention(way, made | c, extra)[:, -extra:] for c in (cameras, there))
    assert np.abs(here - there).max() > 0.01


def test_projections_are_inverse_to_each_other_and_project():
    made = make_prope.inputs()
    made["K"][..., 0, 1] = 3.0  # skew
    into, back = camera_projections(
        made["K"], made["base_from_camera"], make_prope.HEIGHT, make_prope.WIDTH
    )
    identity = np.broadcast_to(np.eye(4), into.shape)
    np.testing.assert_allclose(into @ back, identity, atol=1e-5)
    point = np.linalg.inv(made["base_from_camera"]) @ [0.3, 0.1, 2.0, 1.0]
    pixel = np.einsum("...ij,...j->...i", made["K"], point[..., :3])
    column, row = (pixel[..., i] / pixel[..., 2] for i in (0, 1))
    shares = np.einsum("...ij,j->...i", into, [0.3, 0.1, 2.0, 1.0])
    np.testing.assert_allclose(shares[..., 2], pixel[..., 2], rtol=1e-4, atol=1e-5)
    for i, (value, side) in enumerate(((column, make_prope.WIDTH), (row, make_prope.HEIGHT))):
        np.testing.assert_allclose(
            shares[..., i] / shares[..., 2], value / side - 0.5, rtol=1e-3, atol=1e-3
        )


def test_angles_are_those_of_columns_rows_and_rays():
    cells = cell_angles(2, 3, 2)
    assert cells.shape == (6, 4)
    np.testing.assert_allclose(cells[5], [2, 0.2, 1, 0.1], rtol=1e-6)
    rays = np.array([[0, 2, 0], [-1, 0, 0], [1, 0, 1]], np.float32)
    expected = np.array([[0.5, 1, 0, 0], [1, 2, 0, 0], [0, 0, 0.25, 0.5]]) * np.pi
    np.testing.assert_allclose(ray_angles(rays, 2), expected, atol=1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_sixteen_bits_stay_and_others_are_left_alone(way):
    made = make_prope.inputs()
    config = SimpleNamespace(
        frames_tokens=True, network=way, conditioning=way, ray_convention="jaxcam"
    )
    images = np.zeros((make_prope.BATCH, make_prope.VIEWS, make_prope.HEIGHT, make_prope.WIDTH, 3))
    framing = token_frames(config, made | {"image": images}, GRID, 16, cells=False)
    x = jnp.concatenate([made["q"], made["k"][:, :3]], 1).astype(jnp.bfloat16)
    moved = framing.read(x)
    assert moved.dtype == x.dtype
    np.testing.assert_array_equal(moved[:, -3:], x[:, -3:])
    np.testing.assert_array_equal(moved[..., 8:], x[..., 8:])  # without cells half is free
    assert not np.array_equal(moved[:, :-3, :, :8], x[:, :-3, :, :8])
