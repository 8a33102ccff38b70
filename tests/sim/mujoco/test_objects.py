"""What objects are made of."""

import mujoco
import numpy as np

from jaxcam.sim.mujoco.objects import prism
from jaxcam.sim.tasks import pick_place_can as can
from jaxcam.sim.tasks.pick_place_can import PickPlaceCan


def test_hulls_are_small_and_fit():
    model = PickPlaceCan().scene("fixed").physics
    geom = model.geom("can_g0")
    assert geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH
    assert model.mesh_vertnum[geom.dataid[0]] == 16
    corners = prism(can.RADIUS, can.HALF_HEIGHT, 8)
    outer = np.linalg.norm(corners[:, :2], axis=-1)
    np.testing.assert_allclose((outer + outer * np.cos(np.pi / 8)) / 2, can.RADIUS)
    np.testing.assert_allclose(abs(corners[:, 2]), can.HALF_HEIGHT)
