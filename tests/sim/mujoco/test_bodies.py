"""What both engines derive of a model, against MuJoCo's compiler."""

import mujoco
import numpy as np

from jaxcam.sim.mujoco.bodies import box_inertia, full_from_sparse


def box(half):
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><freejoint/><geom name="box" type="box" density="700"
        size="{half[0]} {half[1]} {half[2]}"/></body></worldbody></mujoco>"""
    )


def test_a_box_of_another_size_weighs_what_the_compiler_says():
    halves = np.array([[0.02, 0.03, 0.04], [0.05, 0.01, 0.02]])
    body, mass, inertia = box_inertia(box([0.02, 0.02, 0.02]), 0, halves)
    assert body == 1
    for half, m, i in zip(halves, mass, inertia, strict=True):
        model = box(half)
        turned = np.empty(9)  # the compiler sorts principal axes
        mujoco.mju_quat2Mat(turned, model.body_iquat[1])
        axes = turned.reshape(3, 3)
        np.testing.assert_allclose(m, model.body_mass[1], rtol=1e-12)
        full = axes @ np.diag(model.body_inertia[1]) @ axes.T
        np.testing.assert_allclose(np.diag(i), full, atol=1e-12)


def test_the_full_inertia_matrix_is_found_in_the_sparse_one(scene):
    model = scene.physics
    data, full = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    arm = np.ix_(scene.arm, scene.arm)
    np.testing.assert_array_equal(data.M[full_from_sparse(model)][arm], full[arm])
