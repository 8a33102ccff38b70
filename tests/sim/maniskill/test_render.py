"""SAPIEN's pictures show worlds where our cameras and rays say they are."""

import numpy as np
import pytest
from sapien_views import HEIGHT, WIDTH, K, views

from jaxcam.errors import SimError
from jaxcam.rays import Camera
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim import make_painter

HALF = 0.02
"""Half-size (m) of Push's cube."""


@pytest.fixture(scope="module")
def layers(world, start):
    return make_painter(world, HEIGHT, WIDTH).layers(views(start))


def test_unprojected_depth_lies_on_the_cube(layers, start, world):
    """One ray of ours per pixel, as long as SAPIEN says: its end is on a face of the cube."""
    view, cube = views(start), world.qpos_of("cube")
    number = next(i for i, name in enumerate(layers.names) if name.endswith("cube"))
    pose = start.qpos[0, cube : cube + 7]
    count = 0
    for i, world_from_camera in enumerate(view.world_from_camera):
        rays = np.asarray(Camera(K, world_from_camera, HEIGHT, WIDTH).plucker(), float)
        hit = layers.segments[i] == number
        count += hit.sum()
        direction = rays[hit][:, :3]
        along = direction / (direction @ world_from_camera[:3, 2])[:, None]
        points = world_from_camera[:3, 3] + layers.depth[i][hit][:, None] * along
        local = abs((points - pose[:3]) @ matrix_from_quaternion(pose[3:]))
        to_face = abs(local.max(-1) - HALF)
        assert to_face.max() < 2e-3
        assert local.max() < HALF + 2e-3
    assert count > 200


def test_the_fingers_are_where_they_are_predicted(layers, start, engine):
    """The middle of the fingers' pixels, against the projection of the point between them."""
    state, view = engine.reset(start), views(start)
    numbers = [i for i, name in enumerate(layers.names) if name.endswith("finger")]
    assert len(numbers) == 2
    middle = state.grip_position[0] - 0.017 * state.grip_rotation[0][:, 2]  # of their meshes
    for i, world_from_camera in enumerate(view.world_from_camera):
        pixels = np.argwhere(np.isin(layers.segments[i], numbers))[:, ::-1] + 0.5
        assert len(pixels) > 30
        u, v, w = K @ (world_from_camera[:3, :3].T @ (middle - world_from_camera[:3, 3]))
        assert np.linalg.norm(pixels.mean(0) - [u / w, v / w]) < 3


def test_pictures_repeat_and_show_states_and_cameras(world, start, layers):
    painter, view = make_painter(world, HEIGHT, WIDTH), views(start)
    pictures = painter.rgb(view)
    assert pictures.dtype == np.uint8
    assert pictures.shape == (4, HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(pictures, layers.rgb)
    backwards = {k: v[::-1] for k, v in view._asdict().items() if v is not None}
    np.testing.assert_array_equal(painter.rgb(view._replace(**backwards))[::-1], pictures)
    moved = view.fixtures.copy()
    moved[:, 2, 0] += 0.1  # the target
    assert (painter.rgb(view._replace(fixtures=moved)) != pictures).any()
    assert (pictures[0] != pictures[1]).any()


def test_a_camera_that_sapien_cannot_have_is_an_error(world, start):
    view = views(start, 1)
    mirrored = view.world_from_camera * np.array([-1.0, 1, 1, 1])
    with pytest.raises(SimError, match="not the one that was asked"):
        make_painter(world, HEIGHT, WIDTH).rgb(view._replace(world_from_camera=mirrored))
