"""The can: where it starts, when it is placed, how high it stands."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placements import assert_fills, place_of

from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.pick_place_can import PickPlaceCan
from jaxcam.sim.types import Command, Start, State


def still(engine, state, steps=40):
    """The world after a while, the hand staying where it is."""
    grip = np.concatenate([state.grip_position, np.tile([np.pi, 0, 0], (len(state.qpos), 1))], -1)
    for _ in range(steps):
        state = engine.step(state, Command(grip, -np.ones(len(grip))))
    return state


def test_can_and_target_fill_their_ranges_and_stay_apart():
    task = PickPlaceCan()
    scene = task.scene("randomized")
    start = starts(task, scene, range(400))
    both = np.stack([place_of(scene, start, "can"), start.fixtures[:, 2, :3]])
    assert_fills(both[..., :2], 0.2)
    apart = np.linalg.norm((both[0] - both[1])[:, :2], axis=-1)
    assert 0.15 <= apart.min() < 0.17
    np.testing.assert_allclose(both[0, :, 2], TABLE_TOP + 0.05)
    np.testing.assert_allclose(both[1, :, 2], TABLE_TOP + 0.04)


def test_the_can_stands_as_high_as_robosuite_says():
    task = PickPlaceCan()
    scene = task.scene("fixed")
    engine = NativeEngine(scene)
    state = still(engine, engine.reset(starts(task, scene, range(2))))
    np.testing.assert_allclose(place_of(scene, state, "can")[:, 2], TABLE_TOP + 0.04, atol=1e-3)


def can_state(aside, height, count=1):
    """A can at a place relative to its target."""
    task = PickPlaceCan()
    scene = task.scene("fixed")
    start = starts(task, scene, range(count))
    state = NativeEngine(scene).reset(start)
    at = scene.qpos_of("can")
    state.qpos[:, at : at + 2] = start.fixtures[:, 2, :2] + aside
    state.qpos[:, at + 2] = TABLE_TOP + height
    return task, scene, state, start


@pytest.mark.parametrize(
    ("aside", "height", "done"),
    [
        ([0.0, 0.0], 0.04, True),
        ([0.03, -0.0399], 0.04, True),
        ([0.03, 0.0401], 0.04, False),
        ([-0.051, 0.0], 0.04, False),
        ([0.0, 0.0], 0.099, True),
        ([0.0, 0.0], 0.101, False),
        ([0.0, 0.0], -0.001, False),
    ],
)
def test_the_can_is_placed_near_its_target_and_low(aside, height, done):
    task, scene, state, start = can_state(aside, height)
    assert task.success(scene, state, start).tolist() == [done]


def test_success_runs_on_device():
    task, scene, state, start = can_state([0.01, 0], 0.04, 3)
    wanted = task.success(scene, state, start)
    assert wanted.all()
    on_device = jax.jit(lambda state, start: task.success(scene, state, start))
    success = on_device(State(*map(jnp.asarray, state)), Start(*map(jnp.asarray, start)))
    np.testing.assert_array_equal(success, wanted)
