"""ManiSkill's simulation on a card: one process for many worlds.

Without a card the process's own part is run on a stand-in for ManiSkill's environment that is as
wide as a test wants, and on ManiSkill itself with one world, which is all that it allows on a CPU.
"""

import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from jaxcam.errors import SimError
from jaxcam.rays import look_at
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import engine_name, make_engine, make_painter, make_task, simulator_of
from jaxcam.sim.maniskill import machine, studio, worlds
from jaxcam.sim.maniskill.machine import Device
from jaxcam.sim.maniskill.memory import JOINTS, Sizes, open_memory
from jaxcam.sim.maniskill.pool import Pool
from jaxcam.sim.maniskill.worker import Worker
from jaxcam.sim.maniskill.worlds import Assignment
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command, View

SIZES = Sizes(JOINTS + 7, JOINTS + 6, 3)
CARD = Assignment("JaxcamPush-v1", "fixed", True, "gpu", SIZES)
HEIGHT, WIDTH = 4, 6
K = np.array([[5.0, 0, 3], [0, 5, 2], [0, 0, 1]])


class StandIn:
    """An environment of many worlds in which joints are wherever they are told to be.

    World i has its object at x = i at first; a world told to go beyond 100 diverges. Pictures show
    the first joint in red, the x of what is only seen in green and the camera's in blue.
    """

    def __init__(self, to, width, eye=None):
        self.sim_freq, self.control_freq, self.open, self.steps = 100, 20, True, 0
        self.qpos, self.qvel = np.zeros((width, SIZES.nq)), np.zeros((width, SIZES.nv))
        self.qpos[:, JOINTS] = np.arange(width)
        lenses = [Lens() for _ in range(width)]
        self.eyes = SimpleNamespace(
            _render_cameras=lenses, take_picture=self.take, get_extrinsic_matrix=self.extrinsics,
            get_picture=lambda name: [self.textures[name]],
        )  # fmt: skip
        sensors = {"eye": SimpleNamespace(camera=self.eyes)}
        entities = [SimpleNamespace(per_scene_id=2, name="cube")]
        self.scene = SimpleNamespace(
            sensors=sensors, update_render=lambda **_: [lens.settle() for lens in lenses],
            sub_scenes=[SimpleNamespace(entities=entities)],
        )  # fmt: skip
        self.size = eye

    def close(self):
        self.open = False

    def numbers(self):
        return self.qpos.copy(), self.qvel.copy(), np.tile(np.arange(7.0), (len(self.qpos), 1))

    def put(self, start, qvel):
        assert np.isfinite(start.qpos).all()  # what has diverged must not reach PhysX again
        self.qpos, self.qvel = start.qpos.copy(), qvel.copy()

    def advance(self, targets):
        assert targets.shape == (len(self.qpos), JOINTS)
        self.steps += 1
        self.qpos[:, :JOINTS] = targets
        self.qvel += 1
        self.qpos[targets[:, 0] > 100] = np.nan

    def show(self, start, world_from_camera):
        self.shown = self.shown if start is None else start
        self.cameras = world_from_camera

    def take(self):
        numbers = self.shown.qpos[:, 0], self.shown.fixtures[:, 0, 0], self.cameras[:, 0, 3]
        colour = np.stack([*numbers, numbers[0]], -1)[:, None, None]
        shape = (len(colour), *self.size, 4)
        depth = np.broadcast_to([0, 0, -2500, 2], shape)
        textures = {"Color": np.broadcast_to(colour, shape).astype(np.uint8)}
        textures["PositionSegmentation"] = depth.astype(np.int16)
        self.textures = {name: Tensor(x) for name, x in textures.items()}

    def extrinsics(self):
        return Tensor(np.linalg.inv(self.cameras)[:, :3])


class Lens:
    """Intrinsics of one camera; on a card the first picture settles them."""

    settled = False

    def set_perspective_parameters(self, near, far, fx, fy, cx, cy, skew):
        assert not self.settled
        self.K = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])

    def get_intrinsic_matrix(self):
        return self.K

    def settle(self):
        self.settled = True


class Tensor:
    """An array on a card."""

    def __init__(self, array):
        self.array = array

    def cpu(self):
        return self

    def numpy(self):
        return self.array


@pytest.fixture
def child(monkeypatch):
    """What a child process on a card does, its memory, and the environments that it makes."""
    made = []

    def make(*args, **kwargs):
        made.append(StandIn(*args, **kwargs))
        return made[-1]

    monkeypatch.setattr(worlds, "open_env", make)
    monkeypatch.setattr(studio, "open_env", make)
    file = os.memfd_create("test")
    memory = open_memory(file, SIZES)
    yield SimpleNamespace(worker=Worker(CARD, memory), memory=memory, made=made)
    os.close(file)


def begin(child, count):
    child.memory.qpos[:count] = np.arange(count)[:, None]
    child.memory.qvel[:count] = 0
    child.worker.load(list(range(count)))


def go_on(child, rows, targets):
    """Asks for a step from where worlds are, as the parent does."""
    memory = child.memory
    memory.qpos[rows], memory.qvel[rows] = memory.qpos_now[rows], memory.qvel_now[rows]
    memory.targets[rows] = targets
    child.worker.step(list(rows))


def test_one_environment_steps_all_worlds_at_once(child):
    begin(child, 5)
    go_on(child, np.arange(5), 10 + np.arange(5)[:, None])
    assert len(child.made) == 1
    assert child.made[0].steps == 1
    np.testing.assert_array_equal(child.memory.qpos_now[:5, 0], 10 + np.arange(5))
    np.testing.assert_array_equal(child.memory.qpos_now[:5, JOINTS], np.arange(5))
    np.testing.assert_array_equal(child.memory.qvel_now[:5], 1)
    np.testing.assert_array_equal(child.memory.grip[:5], np.tile(np.arange(7), (5, 1)))


def test_worlds_that_are_not_asked_for_are_put_back_when_they_are(child):
    begin(child, 3)
    frozen = child.memory.qpos_now[1].copy()
    for t in range(4):
        go_on(child, np.array([0, 2]), 20.0 + t)
    np.testing.assert_array_equal(child.memory.qpos_now[1], frozen)
    go_on(child, np.array([0, 1, 2]), np.array([[30.0], [31], [32]]))
    np.testing.assert_array_equal(child.memory.qpos_now[:3, 0], [30, 31, 32])
    np.testing.assert_array_equal(child.memory.qvel_now[:3, 0], [5, 1, 5])  # it went on from there


def test_a_world_that_diverges_is_told_and_does_not_reach_the_others(child):
    begin(child, 3)
    go_on(child, np.arange(3), np.array([[1.0], [101], [3]]))
    assert np.isnan(child.memory.qpos_now[1]).all()
    go_on(child, np.array([0, 2]), np.array([[4.0], [6]]))
    np.testing.assert_array_equal(child.memory.qpos_now[[0, 2], 0], [4, 6])
    np.testing.assert_array_equal(child.memory.qvel_now[[0, 2], 0], 2)
    assert np.isfinite(child.made[0].qpos[[0, 2]]).all()


def test_more_worlds_are_a_new_environment_in_which_all_are_put_where_they_were(child):
    begin(child, 2)
    go_on(child, np.arange(2), np.array([[5.0], [6]]))
    memory = child.memory
    memory.qpos[:2], memory.qvel[:2] = memory.qpos_now[:2], memory.qvel_now[:2]
    memory.qpos[2:4], memory.qvel[2:4] = 7, 0
    memory.targets[:4] = 8
    child.worker.step([0, 1, 2, 3])
    assert [env.open for env in child.made] == [False, True]
    np.testing.assert_array_equal(memory.qpos_now[:4, JOINTS], [0, 1, 7, 7])
    np.testing.assert_array_equal(memory.qvel_now[:4, 0], [2, 2, 1, 1])
    begin(child, 3)
    assert len(child.made) == 2  # fewer worlds need no other


def ask_views(child, count, first=0.0, lens=K):
    memory = child.memory
    memory.qpos[:count] = first + np.arange(count)[:, None]
    memory.fixtures[:count] = 50 + np.arange(count)[:, None, None]
    memory.K[:count], memory.camera[:count] = lens, np.eye(4)
    memory.camera[:count, 0, 3] = 100 + np.arange(count)


def test_pictures_of_all_views_are_taken_at_once(child):
    for count, first in ((5, 0.0), (3, 20.0)):  # the fewer are drawn by what drew the more
        ask_views(child, count, first)
        names = child.worker.draw(count, HEIGHT, WIDTH, True)
        assert names == ["nothing", "", "cube"]
        rgb, depth, segments = child.memory.layers(count, HEIGHT, WIDTH)
        rows = np.arange(count)
        want = np.stack([first + rows, 50 + rows, 100 + rows], -1)[:, None, None]
        np.testing.assert_array_equal(rgb, np.broadcast_to(want, rgb.shape))
        np.testing.assert_array_equal(depth, 2.5)
        np.testing.assert_array_equal(segments, 2)
    assert len(child.made) == 1


@pytest.mark.parametrize("change", ["more", "size", "lens"])
def test_what_a_card_has_settled_is_made_anew(child, change):
    ask_views(child, 3)
    child.worker.draw(3, HEIGHT, WIDTH, False)
    count, height = (4 if change == "more" else 3), (5 if change == "size" else HEIGHT)
    ask_views(child, count, lens=K + np.diag([1.0, 0, 0]) if change == "lens" else K)
    child.worker.draw(count, height, WIDTH, False)
    assert [env.open for env in child.made] == [False, True]
    child.worker.draw(count, height, WIDTH, False)
    assert len(child.made) == 2


def test_a_camera_that_is_elsewhere_is_an_error(child, monkeypatch):
    ask_views(child, 3)
    monkeypatch.setattr(StandIn, "extrinsics", lambda _: Tensor(np.tile(np.eye(4)[:3], (3, 1, 1))))
    with pytest.raises(ValueError, match="not the one that was asked"):
        child.worker.draw(3, HEIGHT, WIDTH, False)


@pytest.fixture
def world():
    return make_task("push").scene("randomized")


@pytest.mark.parametrize("there", [True, False])
def test_the_card_is_used_where_there_is_one(world, monkeypatch, there):
    device = Device("gpu", "a card") if there else Device("", "there is no card")
    monkeypatch.setattr(machine, "cuda", lambda: device)
    monkeypatch.setattr(machine, "require", lambda: None)
    assert engine_name("auto", world) == ("sapien-gpu" if there else "sapien")
    assert engine_name("sapien", world) == "sapien"
    assert next(iter(simulator_of(world).engines)) == "sapien"  # makes demonstrations, wherever
    painter = make_painter(world, 8)
    assert len(painter.pool.children(100)) == (1 if there else min(os.cpu_count() or 1, 8))
    if not there:
        with pytest.raises(SimError, match=r"sapien-gpu .* there is no card"):
            make_engine("sapien-gpu", world, "osc_pose")


def test_a_card_without_what_it_takes_is_told(monkeypatch):
    monkeypatch.setattr(machine, "has_nvidia", lambda: True)
    monkeypatch.setattr(machine, "device", lambda: Device("gpu", "a card"))
    monkeypatch.setattr(machine, "SIMULATING", "raise OSError('no PhysX for this card')")
    machine.cuda.cache_clear()
    try:
        assert machine.cuda() == Device("", "OSError: no PhysX for this card")
    finally:
        machine.cuda.cache_clear()


def test_one_process_has_all_worlds_of_a_card(world):
    pool = Pool(world, on_gpu=True)
    assert len(pool.children(1)) == len(pool.children(500)) == 1
    pool.close()


ONE_WORLD = """
import dataclasses, sys
import numpy as np
from jaxcam.sim import make_task
from jaxcam.sim.maniskill.memory import Sizes
from jaxcam.sim.maniskill.worlds import Assignment, BatchedWorlds, SeparateWorlds
from jaxcam.sim.task import starts

task = make_task("roll_ball")
world = task.scene("randomized")
to = Assignment(world.env, world.name, False, "cpu", Sizes(world.nq, world.nv, 3))
rows, ways = np.array([0]), []
start = starts(task, world, [0])
moving = np.zeros(world.nv)
moving[9:12] = 0.1, -0.3, 0  # the ball rolls
state = np.concatenate([start.qpos[0], moving])[None]
for kind in (BatchedWorlds, SeparateWorlds):
    worlds = kind(to)
    worlds.grow(1)
    worlds.load(rows, state)
    way = [np.concatenate(worlds.read(rows), -1)]
    for t in range(20):
        targets = start.qpos[:, :9] + 0.02 * t * np.array([1, 0.5, 0, 0, 0, 0, 0, 0, -0.05])
        worlds.step(rows, targets)
        way.append(np.concatenate(worlds.read(rows), -1))
    ways.append(way)
np.save("ways.npy", ways)
"""


def test_batches_are_maniskills_own_worlds(maniskill, tmp_path):
    """The way of a world in a batch of one, through ManiSkill's tensors, and by SAPIEN's parts."""
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", ONE_WORLD], cwd=tmp_path, check=True,
        env=machine.child_environment(), capture_output=True,
    )  # fmt: skip
    batched, separate = np.load(tmp_path / "ways.npy")
    assert abs(separate[-1] - separate[0])[0, 9:11].max() > 0.1  # the ball has rolled
    assert abs(separate[-1] - separate[0])[0, 0] > 0.1  # and the arm turned
    np.testing.assert_allclose(batched, separate, atol=1e-4)


@pytest.fixture
def card(maniskill):
    if not machine.cuda().kind:
        pytest.skip(f"It takes a card that ManiSkill simulates on: {machine.cuda().name}.")


def test_a_card_does_as_the_cpu_does(card, world):
    """Free motion as on the CPU, for more worlds than a process has there, and their pictures."""
    task = make_task("push")
    start = starts(task, world, range(20))
    ways = []
    for name in ("sapien", "sapien-gpu"):
        engine = make_engine(name, world, "osc_pose")
        state = engine.reset(start)
        np.testing.assert_allclose(state.qpos, start.qpos, atol=1e-5)
        pose = np.concatenate([state.grip_position, rotvec_from_matrix(state.grip_rotation)], -1)
        pose[:, :3] += [0.03, -0.04, 0.05]
        for t in range(20):
            state = engine.step(state, Command(pose, np.ones(20)), np.arange(20) % 5 != t % 5)
        assert state.ok.all()
        ways.append(state)
    cpu, gpu = ways
    np.testing.assert_allclose(gpu.qpos, cpu.qpos, atol=2e-3)
    np.testing.assert_allclose(gpu.grip_position, cpu.grip_position, atol=2e-3)
    poses = np.asarray(look_at(np.array([[0.5, 0.1, 0.5]]), np.zeros(3))).repeat(20, 0)
    lens = np.tile([[90.0, 0, 32], [0, 90, 32], [0, 0, 1]], (20, 1, 1))
    view = View(gpu.qpos, start.geom_size, start.fixtures, lens, poses)
    layers = make_painter(world, 64).layers(view)
    assert layers.rgb.std((1, 2, 3)).min() > 10
    cube = next(i for i, name in enumerate(layers.names) if name.endswith("cube"))
    middle = np.einsum("nij,nj->ni", poses[:, :3, :3].mT, gpu.qpos[:, 9:12] - poses[:, :3, 3])
    u, v = 90 * middle[:, 0] / middle[:, 2] + 32, 90 * middle[:, 1] / middle[:, 2] + 32
    for i in range(20):
        rows, columns = np.nonzero(layers.segments[i] == cube)
        if 2 < u[i] < 62 and 2 < v[i] < 62:
            assert abs(np.array([columns.mean() - u[i], rows.mean() - v[i]])).max() < 2
