"""What an engine promises: an episode goes on until it succeeds, is lost or runs out of time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.sim.engine import Progress, begin, control_step
from jaxcam.sim.types import Command, State

WORLDS = 3
HORIZON = 5
COMMAND = Command(np.zeros((WORLDS, 6)), np.zeros(WORLDS))


def state_of(ok=(True,) * WORLDS):
    still = np.zeros((WORLDS, 2))
    return State(
        qpos=still, qvel=still, warmstart=still, closed=np.zeros(WORLDS),
        rest=np.zeros((WORLDS, 7)), grip_position=np.zeros((WORLDS, 3)),
        grip_rotation=np.zeros((WORLDS, 3, 3)), ok=np.array(ok),
    )  # fmt: skip


def taken(progress, after, done):
    """A control step that ends in a state, in which worlds are done or not."""
    return control_step(
        lambda state, command, active: after, lambda state: np.array(done), progress, COMMAND
    )


@pytest.mark.parametrize("compiled", [False, True])
def test_a_diverged_world_never_succeeds(compiled):
    progress, lost = begin(state_of(), HORIZON), state_of(ok=(True, False, True))

    def step(progress, lost):
        return taken(progress, lost, [True, True, False])

    if compiled:
        progress, lost = jax.tree.map(jnp.asarray, (progress, lost))
        step = jax.jit(step)
    progress = step(progress, lost)
    assert progress.success.tolist() == [True, False, False]
    assert progress.steps.tolist() == [1, HORIZON, HORIZON]
    assert progress.active.tolist() == [False, False, True]
    again = step(progress, lost)
    assert again.success.tolist() == [True, False, False]


def test_a_world_that_was_given_up_never_succeeds():
    progress = begin(state_of(), HORIZON, alive=np.array([True, False, True]))
    progress = taken(progress, state_of(), [True, True, False])
    assert progress.success.tolist() == [True, False, False]


def test_success_keeps_its_step_and_the_horizon_ends_the_others():
    progress = begin(state_of(), HORIZON)
    for t in range(HORIZON):
        assert progress.active.tolist() == [True, t < 3, t < 1]
        progress = taken(progress, state_of(), [False, t >= 2, t >= 0])
    assert isinstance(progress, Progress)
    assert not progress.active.any()
    assert progress.success.tolist() == [False, True, True]
    assert progress.steps.tolist() == [HORIZON, 3, 1]
