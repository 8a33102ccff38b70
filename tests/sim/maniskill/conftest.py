"""Push in ManiSkill: its world, some starts, and engines that share its child processes."""

import pytest
from sapien_views import WORLDS

from jaxcam.sim import make_engine, make_task
from jaxcam.sim.task import starts


@pytest.fixture(scope="module")
def push():
    return make_task("push")


@pytest.fixture(scope="module")
def world(maniskill, push):
    return push.scene("randomized")


@pytest.fixture(scope="module")
def start(push, world):
    return starts(push, world, range(WORLDS))


@pytest.fixture(scope="module")
def engine(world):
    return make_engine("auto", world, "osc_pose")


@pytest.fixture(scope="module")
def joint_engine(world):
    return make_engine("sapien", world, "joint_position")
