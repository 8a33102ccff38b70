"""Environments as small and short as they can be."""

import gymnasium
import pytest
from small_envs import SMALL

import jaxcam.envs


@pytest.fixture
def make():
    """Makes one environment; options as for `gymnasium.make`."""

    def make(task="lift", **options):
        return gymnasium.make(jaxcam.envs.env_id(task), **{**SMALL, **options})

    return make


@pytest.fixture
def make_vec():
    """Makes several environments; options as for `gymnasium.make_vec`."""

    def make_vec(task="lift", num_envs=3, **options):
        options = {**SMALL, **options}
        return gymnasium.make_vec(jaxcam.envs.env_id(task), num_envs=num_envs, **options)

    return make_vec
