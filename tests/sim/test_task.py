"""How episodes start: what a seed decides, and how far things vary."""

import numpy as np

from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import ROOM_SHIFT, START_JOINT_NOISE, TABLE_SHIFT, starts
from jaxcam.sim.tasks.lift import HALF_SIZE, PLACEMENT


def test_the_same_seed_gives_the_same_start_in_both_scenes(lift, scenes):
    fixed, randomized = (starts(lift, scenes[n], range(20)) for n in ("fixed", "randomized"))
    np.testing.assert_array_equal(fixed.qpos, randomized.qpos)
    np.testing.assert_array_equal(fixed.geom_size, randomized.geom_size)
    assert (fixed.fixtures == fixed.fixtures[0]).all()
    assert len(np.unique(randomized.fixtures[:, :, 0])) == 40
    again = lift.start(scenes["randomized"], 13)
    np.testing.assert_array_equal(again.qpos, randomized.qpos[13])
    np.testing.assert_array_equal(again.fixtures, randomized.fixtures[13])
    assert (np.ptp(randomized.qpos, 0)[:7] > 0).all()


def test_starts_fill_their_ranges_and_stay_inside(lift, scene):
    start = starts(lift, scene, range(400))
    cube = scene.qpos_of("cube")
    place, half = start.qpos[:, cube : cube + 3], start.geom_size[:, 0]
    for values, low, high in (
        (place[:, :2], -PLACEMENT, PLACEMENT),
        (half, *HALF_SIZE),
        (start.fixtures[:, 0, :2], -TABLE_SHIFT, TABLE_SHIFT),
        (start.fixtures[:, 1, :2], -ROOM_SHIFT, ROOM_SHIFT),
    ):
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high >= values.max() > high - 0.05 * (high - low)
    np.testing.assert_allclose(place[:, 2], TABLE_TOP + half[:, 2] + 0.01)
    yaw = 2 * np.arctan2(start.qpos[:, cube + 6], start.qpos[:, cube + 3])
    assert np.ptp(yaw) > 1.9 * np.pi
    noise = start.qpos[:, scene.arm] - scene.home
    assert abs(noise.std() / START_JOINT_NOISE - 1) < 0.05
    top = start.fixtures[:, 0, 2] + scene.visual.geom("table_visual").size[2]
    np.testing.assert_allclose(top, TABLE_TOP)
    np.testing.assert_allclose(np.linalg.norm(start.fixtures[..., 3:], axis=-1), 1)
