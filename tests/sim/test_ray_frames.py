"""Frames of the rays: lines through one point stay so, and moments are about the right origin."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.config.names import RayFrame, names_of
from jaxcam.rays import invert, look_at, plucker
from jaxcam.rays.rotations import matrix_from_rotvec
from jaxcam.sim.ray_frames import frame_from_base, grip_in_base, in_ray_frame

BASE = np.eye(4)
BASE[:3, :3] = matrix_from_rotvec(np.array([0.0, 0, 0.7]))
BASE[:3, 3] = -0.5, 0.1, 0.9
WORLD = SimpleNamespace(world_from_base=BASE, table_top=0.8)
GRIP = np.array([[0.1, -0.2, 1.0], [0.0, 0.3, 1.1]])
TURN = matrix_from_rotvec(np.array([[3.0, 0.1, 0], [0, 2.9, 0.3]]))


def frames(name):
    return frame_from_base(name, WORLD, *grip_in_base(BASE, GRIP, TURN))


ORIGINS = {
    "base": np.tile(BASE[:3, 3], (2, 1)),
    "world": np.zeros((2, 3)),
    "grip": GRIP,
    "about_grip": GRIP,
    "about_table": np.tile([0, 0, 0.8], (2, 1)),
}
AXES = {"world": np.tile(np.eye(3), (2, 1, 1)), "grip": TURN}


@pytest.mark.parametrize("name", names_of(RayFrame))
def test_origins_and_axes_are_where_the_name_says(name):
    world_from_frame = BASE @ invert(frames(name))
    assert np.allclose(world_from_frame[:, :3, 3], ORIGINS[name], atol=1e-6)
    expected = AXES.get(name, np.tile(BASE[:3, :3], (2, 1, 1)))
    assert np.allclose(world_from_frame[:, :3, :3], expected, atol=1e-6)


@pytest.mark.parametrize("name", names_of(RayFrame))
def test_a_ray_through_the_origin_has_no_moment(name):
    """A camera that looks at a frame's origin has it in the middle of its picture."""
    world_from_camera = look_at(np.array([[1.0, 1, 2], [0.5, -1, 2]]), ORIGINS[name])
    base_from_camera = invert(BASE) @ world_from_camera
    poses = in_ray_frame(base_from_camera, frames(name))
    K = np.array([[10.0, 0, 1.5], [0, 10, 1.5], [0, 0, 1]])
    rays = np.asarray(plucker(K, poses, 3, 3))
    assert abs(rays[:, 1, 1, 3:]).max() < 1e-5 < abs(rays[:, 0, 0, 3:]).max()


def test_under_jax_it_is_the_same():
    for name in names_of(RayFrame):
        local = grip_in_base(BASE, jnp.asarray(GRIP), jnp.asarray(TURN))
        assert np.allclose(frame_from_base(name, WORLD, *local), frames(name), atol=1e-6)
