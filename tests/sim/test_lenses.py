"""Pictures through lenses: of a sky whose colour is known in every direction."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.errors import SimError
from jaxcam.rays import Camera, look_at
from jaxcam.rays.lens import pack
from jaxcam.sim.lenses import SCALE, LensPainter, sampled
from jaxcam.sim.painter import require_pinholes
from jaxcam.sim.types import View

HEIGHT, WIDTH = 24, 32
LENSES = np.stack(
    [pack([-0.3, 0.1, 0.01, -0.02]), pack([0.2, 0, 0, 0]), pack([0.1, 0, 0, 0], "fisheye")]
)


class Sky:
    """Draws a colour for every direction of sight."""

    def __init__(self, scale=1):
        self.scene, self.height, self.width = None, scale * HEIGHT, scale * WIDTH
        self.asked = []

    def look(self):
        return "sky"

    def rgb(self, view):
        require_pinholes(view)
        self.asked.append(view)
        return colours(Camera(view.K, view.world_from_camera, self.height, self.width))


def colours(camera):
    direction = np.asarray(camera.plucker())[..., :3]
    return np.where(camera.has_ray()[..., None], np.round(127 + 120 * direction), 0).astype(
        np.uint8
    )


def view(lenses):
    count = len(LENSES)
    pose = look_at(np.array([[1.0, 0.2, 1], [0.3, 1, 0.5], [0, -1, 2]]), np.zeros((count, 3)))
    K = np.tile(np.array([[30.0, 0, 15], [0, 24, 13], [0, 0, 1]]), (count, 1, 1))
    nothing = np.zeros((count, 1))
    return View(nothing, nothing, nothing, K, pose, lenses)


def test_a_pixel_has_the_colour_of_its_bent_ray():
    painter, shown = LensPainter(Sky(), Sky(SCALE)), view(LENSES)
    pictures = painter.rgb(shown).astype(int)
    camera = Camera(shown.K, shown.world_from_camera, HEIGHT, WIDTH, LENSES)
    truth = colours(camera).astype(int)
    assert abs(pictures - truth).max() <= 2
    straight = colours(Camera(shown.K, shown.world_from_camera, HEIGHT, WIDTH)).astype(int)
    assert abs(truth - straight).max((1, 2, 3)).min() > 3  # which a pinhole's picture is not
    assert painter.look() == f"sky-lens{SCALE}x"


def test_without_lenses_the_picture_is_the_painter_s():
    plain = Sky()
    pictures = LensPainter(plain, Sky(SCALE)).rgb(view(None))
    assert np.array_equal(pictures, Sky().rgb(view(None)))
    assert len(plain.asked) == 1


def test_pixels_without_a_ray_are_black():
    folding = np.tile(pack([-2.0, 0, 0, 0]), (3, 1))
    pictures, shown = LensPainter(Sky(), Sky(SCALE)).rgb(view(folding)), view(folding)
    has_ray = Camera(shown.K, shown.world_from_camera, HEIGHT, WIDTH, folding).has_ray()
    assert not has_ray.all()
    assert has_ray.any()
    assert not pictures[~has_ray].any()
    assert pictures[has_ray].any(-1).all()


def test_both_namespaces_sample_alike():
    rng = np.random.default_rng(0)
    pictures = rng.integers(0, 256, (2, 6, 8, 3)).astype(np.uint8)
    u, v = rng.uniform(0, 8, (2, 5, 5)), rng.uniform(0, 6, (2, 5, 5))
    drawn = rng.random((2, 5, 5)) < 0.8
    host = sampled(pictures, u, v, drawn)
    device = sampled(*map(jnp.asarray, (pictures, u, v, drawn)))
    assert abs(host.astype(int) - np.asarray(device)).max() <= 1
    middle = np.full((2, 1, 1), 3.5)
    exact = sampled(pictures, middle, middle, np.ones((2, 1, 1), bool))
    assert np.array_equal(exact[:, 0, 0], pictures[:, 3, 3])


def test_a_plain_painter_refuses_lenses():
    with pytest.raises(SimError, match="lenses=True"):
        Sky().rgb(view(LENSES))
