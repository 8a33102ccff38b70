"""The nut and its peg: where they start, when the nut is on it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placements import assert_fills, place_of

from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import starts
from jaxcam.sim.tasks import square
from jaxcam.sim.tasks.square import Square
from jaxcam.sim.types import Start, State


def test_nut_and_peg_fill_their_ranges_and_stay_apart():
    task = Square()
    scene = task.scene("randomized")
    start = starts(task, scene, range(400))
    nut, peg = place_of(scene, start, "nut"), place_of(scene, start, "peg")
    assert_fills(np.stack([nut, peg])[..., :2], 0.18)
    apart = np.linalg.norm((nut - peg)[:, :2], axis=-1)
    assert square.APART <= apart.min() < square.APART + 0.02
    np.testing.assert_allclose(nut[:, 2], TABLE_TOP + 0.02)
    np.testing.assert_allclose(peg[:, 2], TABLE_TOP + 0.005)
    tip = np.hypot(0.054 + 0.02525, 0.015875)  # farthest corner of robosuite's nut
    assert tip + np.hypot(*square.BASE_HALF_SIZE[:2]) < square.APART


def square_state(nut, grip):
    """A nut relative to the peg's foot, its handle along y, and the grip relative to its middle."""
    task = Square()
    scene = task.scene("fixed")
    start = starts(task, scene, [0])
    state = NativeEngine(scene).reset(start)
    at = scene.qpos_of("nut")
    state.qpos[:, at : at + 2] = place_of(scene, state, "peg")[:, :2] + nut[:2]
    state.qpos[:, at + 2] = TABLE_TOP + nut[2]
    state.qpos[:, at + 3 : at + 7] = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    state.grip_position[:] = state.qpos[:, at : at + 3] + grip
    return task, scene, state, start


ABOVE = (0, 0, 0.2)


@pytest.mark.parametrize(
    ("nut", "grip", "done"),
    [
        ((0, 0, 0.02), ABOVE, True),
        ((0.0299, -0.0299, 0.02), ABOVE, True),
        ((0.0301, 0, 0.02), ABOVE, False),
        ((0, -0.0301, 0.02), ABOVE, False),
        ((0, 0, 0.0999), ABOVE, True),
        ((0, 0, 0.1001), ABOVE, False),
        ((0, 0, 0.02), (0, 0, 0.0425), True),
        ((0, 0, 0.02), (0, 0, 0.0422), False),
        ((0, 0, 0.02), (0, 0.054, 0), False),  # holds the handle
        ((0, 0, 0.02), (0, 0.054, 0.0425), True),
        ((0, 0, 0.02), (0, -0.054, 0), True),
    ],
)
def test_the_nut_is_around_the_peg_low_and_let_go(nut, grip, done):
    task, scene, state, start = square_state(nut, grip)
    assert task.success(scene, state, start).tolist() == [done]


def test_success_runs_on_device():
    task, scene, state, start = square_state((0, 0, 0.02), ABOVE)
    wanted = task.success(scene, state, start)
    assert wanted.all()
    on_device = jax.jit(lambda state, start: task.success(scene, state, start))
    success = on_device(State(*map(jnp.asarray, state)), Start(*map(jnp.asarray, start)))
    np.testing.assert_array_equal(success, wanted)
