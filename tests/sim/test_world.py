"""What a policy feels of its world."""

import numpy as np


def test_proprio_is_in_the_base_frame(lift, scene):
    qpos = lift.start(scene, 0).qpos
    qpos[scene.fingers] = 0.01, -0.02
    felt = scene.proprio(qpos, scene.world_from_base[:3, 3] + [0.1, 0.2, 0.3])
    assert felt.dtype == np.float32
    np.testing.assert_allclose(felt, [*qpos[scene.arm], 0.1, 0.2, 0.3, 0.03], rtol=1e-6)
