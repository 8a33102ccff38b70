"""What MJX is given of a model: sizes that differ between worlds, pairs that it can collide."""

import mujoco
import numpy as np
import pytest

from jaxcam.errors import ConfigError
from jaxcam.sim.mujoco.mjx_model import check_pairs, resized
from jaxcam.sim.task import starts


def test_sizes_become_the_model_that_mujoco_derives(lift, scene):
    sizes = starts(lift, scene, range(3)).geom_size
    geom, body = scene.physics.geom("cube_g0").id, scene.physics.body("cube_main").id
    bodies = resized(scene.physics, [geom], sizes)
    for i, half in enumerate(sizes[:, 0]):
        spec = mujoco.MjSpec()
        cube = spec.worldbody.add_body()
        cube.add_freejoint()
        density = scene.physics.body_mass[body] / (8 * scene.physics.geom_size[geom].prod())
        cube.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, density=density)
        model = spec.compile()
        for name in ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0"):
            want = getattr(model, name)[1]
            np.testing.assert_allclose(bodies[name][i, body], want, rtol=1e-5, err_msg=name)
        dof = scene.physics.body_dofadr[body]
        got = bodies["dof_invweight0"][i, dof : dof + 6]
        np.testing.assert_allclose(got, model.dof_invweight0, rtol=1e-5)
        got = [bodies["geom_size"][i, geom], bodies["geom_aabb"][i, geom].ravel()[3:]]
        np.testing.assert_allclose(got, [half, half], rtol=1e-6)
        np.testing.assert_allclose(bodies["geom_rbound"][i, geom], model.geom_rbound[0], rtol=1e-6)


def test_jax_refuses_pairs_by_name():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><geom name="crate" type="box" size="1 1 1"/>
        <body><freejoint/><geom name="tin" type="cylinder" size="1 1"/></body>
        </worldbody></mujoco>"""
    )
    with pytest.raises(ConfigError, match=r"cannot collide (crate|tin) with (crate|tin).*native"):
        check_pairs(model)
