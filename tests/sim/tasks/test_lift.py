"""When Lift is done."""

import numpy as np

from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.lift import LIFTED


def test_lifted_is_four_centimetres_above_the_table(lift, scene):
    start = starts(lift, scene, range(3))
    state = NativeEngine(scene, varied=lift.varied).reset(start)
    state.qpos[:, scene.qpos_of("cube") + 2] = TABLE_TOP + LIFTED + np.array([-1e-6, 1e-6, 0.1])
    assert LIFTED == 0.04
    assert lift.success(scene, state, start).tolist() == [False, True, True]
