"""Shaped rewards against robosuite's own code, which is run on our worlds.

robosuite's environments need an older MuJoCo. Their reward functions do not: they are called with
what they look at, taken from our states.
"""

import copy
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from robosuite.environments.base import MujocoEnv
from robosuite.environments.manipulation.lift import Lift
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.environments.manipulation.nut_assembly import NutAssembly
from robosuite.environments.manipulation.pick_place import PickPlace

from jaxcam.data.collection import run_expert
from jaxcam.envs.shaped import OBJECTS, PADS, ShapedReward
from jaxcam.sim import make_engine, make_task
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import starts
from jaxcam.sim.tasks.pick_place_can import NEAR
from jaxcam.sim.tasks.square import HANDLE
from jaxcam.sim.types import State

ENVS = {"lift": Lift, "pick_place_can": PickPlace, "square": NutAssembly}
HAND = SimpleNamespace(important_sites={"grip_site": "grip"})


class Env:
    """What robosuite's reward functions look at, of one of our worlds."""

    reward_shaping, reward_scale, single_object_mode, table_offset = True, 1.0, 2, [0, 0, TABLE_TOP]

    def __init__(self, task, world, start):
        self.env, self.model = ENVS[task], copy.copy(world.physics)
        model, name = self.model, OBJECTS[task]
        for geom, size in zip(make_task(task).varied, start.geom_size[0], strict=True):
            model.geom_size[model.geom(geom).id] = size
        self.data = mujoco.MjData(model)
        body = int(model.jnt_bodyid[model.joint(f"{name}_joint0").id])
        geoms = [model.geom(i).name for i in range(model.ngeom) if model.geom_bodyid[i] == body]
        thing = SimpleNamespace(
            name=name, root_body=model.body(body).name, contact_geoms=geoms,
            important_sites={"handle": "handle"},
        )  # fmt: skip
        self.cube, self.objects, self.nuts = thing, [thing], [thing]
        self.obj_body_id, self.object_to_id, self.nut_to_id = {name: body}, {name: 0}, {name: 0}
        # Half a compartment of its bin is our target's radius.
        self.bin2_pos, self.bin_size = np.array([0, 0, TABLE_TOP]), np.full(3, 4 * NEAR)
        self.target_bin_placements = start.fixtures[0, -1:, :3]
        self.table_body_id = model.body("table").id
        self.peg1_body_id = self.peg2_body_id = model.body("peg_root").id if task == "square" else 0
        self.robots = [SimpleNamespace(gripper=HAND)]

    def reward_of(self, qpos, grip, success):
        """robosuite's reward where a world is so."""
        self.data.qpos[:] = qpos
        mujoco.mj_forward(self.model, self.data)
        at = self.data.body(self.cube.root_body)
        sites = {"grip": grip, "handle": at.xpos + at.xmat.reshape(3, 3) @ [HANDLE, 0, 0]}
        self.sim = SimpleNamespace(
            data=SimpleNamespace(
                body_xpos=self.data.xpos, contact=self.data.contact, ncon=self.data.ncon,
                get_site_xpos=sites.get, get_body_xpos=lambda name: self.data.body(name).xpos,
            ),
            model=SimpleNamespace(geom_id2name=lambda i: self.model.geom(int(i)).name),
        )  # fmt: skip
        self.success = success
        self.objects_in_bins = self.objects_on_pegs = np.array([success])
        return self.env.reward(self)

    def staged_rewards(self):
        return self.env.staged_rewards(self)

    def check_contact(self, *groups):
        return MujocoEnv.check_contact(self, *groups)

    def _check_success(self):
        return self.success

    def _check_grasp(self, gripper, object_geoms):
        geoms = getattr(object_geoms, "contact_geoms", object_geoms)
        return ManipulationEnv._check_grasp(self, [[pad] for pad in PADS], geoms)

    def _gripper_to_target(self, *args, **kwargs):
        return ManipulationEnv._gripper_to_target(self, *args, **kwargs)


@pytest.fixture(scope="module")
def episode():
    """An expert's episode: task, world, start, positions [T, nq] and places of the grip [T, 3]."""

    def episode(name):
        task = make_task(name)
        world = task.scene("randomized")
        engine = make_engine("native", world, "osc_pose", task.varied)
        demo = run_expert(task, world, engine, [7])[0]
        qpos, grip = demo.states[::3, 1 : 1 + world.nq], demo.eef_pos[::3]
        return task, world, starts(task, world, [7]), qpos, grip

    return episode


def state_of(qpos, grip):
    nothing = [np.zeros(len(qpos))] * 4
    turned = np.tile(np.eye(3), (len(qpos), 1, 1))
    return State(qpos, *nothing, grip, turned, np.ones(len(qpos), bool))


@pytest.mark.parametrize("name", ENVS)
def test_they_are_robosuites(episode, name):
    task, world, start, qpos, grip = episode(name)
    state, count = state_of(qpos, grip), len(qpos)
    start_of_all = type(start)(*(x.repeat(count, 0) for x in start))
    success = np.asarray(task.success_in(world)(state, start_of_all))
    ours = ShapedReward(name, world)(state, start_of_all, success, np.ones(count, bool))
    env = Env(name, world, start)
    theirs = np.array([env.reward_of(*one) for one in zip(qpos, grip, success, strict=True)])
    if name == "pick_place_can":  # its compartments have corners, and our target has none
        at = world.qpos_of("can")
        aside = np.abs(qpos[:, at : at + 2] - start.fixtures[0, 2, :2])
        corners = (aside < NEAR).all(-1) & (np.linalg.norm(aside, axis=-1) > NEAR)
        ours, theirs, success = ours[~corners], theirs[~corners], success[~corners]
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert (ours[success] == 1).all()
    # All stages are there: in reach, grasped, lifted and over the goal.
    assert len(np.unique(ours.round(3))) > 10
    assert 0.5 < ours[~success].max() < 0.9


def test_what_does_not_go_on_gets_nothing(episode):
    _, world, start, qpos, grip = episode("lift")
    pair = [0, 1]
    two = type(start)(*(x.repeat(2, 0) for x in start))
    success = np.array([True, False])
    reward = ShapedReward("lift", world)
    assert reward(state_of(qpos[pair], grip[pair]), two, success, ~success)[0] == 0
    assert (reward(state_of(qpos[pair], grip[pair]), two, success, np.zeros(2, bool)) == 0).all()


def test_environments_give_them(make_vec):
    """More where the hand is nearer to the cube, and summed over a chunk."""
    envs = make_vec(num_envs=2, reward="shaped")
    one = make_vec(num_envs=2, reward="shaped", chunk=2)
    for each in (envs, one):
        each.reset(options={"pair": 0})
    down = np.array([[0, 0, -0.02, 0, 0, 0, -1.0], [0, 0, 0.02, 0, 0, 0, -1.0]])
    sums = sum(envs.step(down)[1] for _ in range(2))
    np.testing.assert_allclose(one.step(down[:, None].repeat(2, 1))[1], sums)
    later = sum(envs.step(down)[1] for _ in range(2))
    assert later[0] > sums[0]
    assert later[1] < sums[1]
