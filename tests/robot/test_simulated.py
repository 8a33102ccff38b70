"""The simulated robot: what it films, feels and does."""

import numpy as np
import pytest
from rehearsal import CAMERAS, lifter, rester

from jaxcam.errors import ConfigError
from jaxcam.interop.cameras.files import read_cameras
from jaxcam.rays import Camera
from jaxcam.robot.driver import Setup
from jaxcam.robot.simulated import SimulatedLift

NAMES = ("first", "second", "third")
SIDE = 40


@pytest.fixture(scope="module")
def robot():
    return SimulatedLift()


def scene(placement, start=0):
    file, cameras = read_cameras(CAMERAS), {}
    for name in NAMES:
        entry = file.of((placement,), name)
        K = entry.optics.at(SIDE, SIDE, name)
        cameras[name] = (K, (SIDE, SIDE), entry.pose.of((placement,)))
    return Setup(start, "", placement, cameras)


def test_the_cube_is_where_its_cameras_say(robot, lift):
    world, compared = lift.scene("randomized"), 0
    for placement in "123":
        robot.prepare(scene(placement))
        qpos = lift.start(world, 1_000_000).qpos
        cube = qpos[world.qpos_of("cube") :][:3] - world.world_from_base[:3, 3]
        cube = cube @ world.world_from_base[:3, :3]
        for name, picture in robot.observe().items():
            if "images" not in name:
                continue
            K, (height, width), pose = scene(placement).cameras[name.rpartition(".")[2]]
            uv, depth = Camera(K, pose, height, width).project(cube)
            red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
            rows, columns = np.nonzero(green > 1.5 * np.maximum(red, blue))
            if len(rows) < 5:
                continue  # hidden
            compared += 1
            assert depth > 0
            assert np.abs(uv - [columns.mean() + 0.5, rows.mean() + 0.5]).max() < 2
    assert compared >= 6


def rollout(robot, act, steps=64):
    for action in act(robot.observe())[:steps]:
        robot.act(action)
    return robot.outcome()


def test_it_says_how_it_went(robot, lift):
    act = lifter(lift, lift.scene("randomized"))
    robot.prepare(scene("1"))
    assert rollout(robot, act) == "success"
    robot.prepare(scene("1"))  # begins anew
    assert rollout(robot, rester, 8) == "failure"


def test_holding_goes_on_to_the_last_target(robot):
    robot.prepare(scene("2"))
    before = robot.observe()["observation.state"][7:10]
    robot.act(np.float32([0, 0, 0.02, 0, 0, 0, -1]))
    for _ in range(10):
        robot.hold()
    after = robot.observe()["observation.state"][7:10]
    np.testing.assert_allclose(after - before, [0, 0, 0.02], atol=4e-3)


def test_what_it_cannot_do_is_refused(robot):
    with pytest.raises(ConfigError, match="did you mean 'eef_delta'"):
        SimulatedLift(action_space="eef_delt")
    with pytest.raises(ConfigError, match="unknown rotations 'nominl', did you mean 'nominal'"):
        SimulatedLift(rotations="nominl")
    with pytest.raises(ConfigError, match="speed must be"):
        SimulatedLift(speed=-1)
    with pytest.raises(ConfigError, match="give cameras a file"):
        robot.prepare(Setup(0, "", "", {}))
    cameras = scene("1").cameras
    with pytest.raises(ConfigError, match="without a lens, and first have"):
        robot.prepare(Setup(0, "", "1", cameras, {"first": np.ones(9)}))
    K, _, pose = cameras["third"]
    with pytest.raises(ConfigError, match="at one size, and K is for 60x30, 40x40"):
        robot.prepare(Setup(0, "", "1", cameras | {"third": (K, (30, 60), pose)}))
    robot.prepare(scene("1"))
    with pytest.raises(ConfigError, match=r"shape \[8\]; eef_delta has 7"):
        robot.act(np.zeros(8))
    with pytest.raises(ConfigError, match="not prepared"):
        SimulatedLift().hold()
