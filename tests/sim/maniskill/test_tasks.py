"""ManiSkill's tasks: starts, success and experts, and their environments without the bridge."""

import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.data.collection import run_expert
from jaxcam.data.replay import replay_all
from jaxcam.rays import POSE_RANGES, invert, sample_poses
from jaxcam.rays.rotations import matrix_from_quaternion, matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import make_engine, make_painter, make_task
from jaxcam.sim.experts import CLOSE_BY, FAR, STEP, STRETCH, TURN, pushing_grip
from jaxcam.sim.maniskill.machine import child_environment, device
from jaxcam.sim.task import starts
from jaxcam.sim.types import Start, State, View

NAMES = ("push", "lift_upright", "roll_ball")
SEEDS = range(2000, 2010)
LONGEST = {"push": 100, "lift_upright": 170, "roll_ball": 145}
K = np.array([[50.0, 0, 30], [0, 55, 33], [0, 0, 1]])


@pytest.fixture(scope="module", params=NAMES)
def world(request):
    """A task and its randomised world."""
    task = make_task(request.param)
    return task, task.scene("randomized")


def some(name, count=400, scene="randomized"):
    task = make_task(name)
    world = task.scene(scene)
    return task, world, starts(task, world, range(count))


def fills(values, low, high):
    assert low <= values.min() < low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) < values.max() <= high


def x_axis(pose):
    return matrix_from_quaternion(pose[..., 3:7])[..., 0]


def test_what_the_paper_says_of_the_tasks():
    tasks = {name: make_task(name) for name in NAMES}
    assert [tasks[n].horizon for n in NAMES] == [150, 450, 150]
    assert [tasks[n].views for n in NAMES] == [1, 1, 2]
    assert [tasks[n].stair for n in NAMES] == [(3, 1), (3, 1), (4, 2)]
    for name, task in tasks.items():
        assert task.cameras is POSE_RANGES[f"maniskill_{name}"]
    np.testing.assert_allclose([tasks[n].fovy_deg for n in NAMES], [57.29578, 57.29578, 90])


def test_push_starts_as_the_authors_do():
    _, _, start = some("push")
    cube, target = start.qpos[:, 9:], start.fixtures[:, 2]
    way = target[:, :2] - cube[:, :2]
    travel = np.linalg.norm(way, axis=-1)
    fills(travel, 0.2, 0.3)
    anchor = cube[:, :2] + way / 3
    fills(anchor[:, 0], -0.15, 0.05)
    fills(anchor[:, 1], -0.1, 0.1)
    fills(np.arctan2(way[:, 1], way[:, 0]), -np.pi, np.pi)
    np.testing.assert_allclose(x_axis(cube)[:, :2], way / travel[:, None], atol=1e-9)
    np.testing.assert_allclose(cube[:, 2], 0.02)
    np.testing.assert_allclose(abs(x_axis(target)[:, 2]), 1)  # the disc lies


def test_lift_upright_starts_as_the_authors_do():
    _, _, start = some("lift_upright")
    peg = start.qpos[:, 9:]
    fills(peg[:, 0], -0.2, 0.0)
    fills(peg[:, 1], -0.1, 0.1)
    np.testing.assert_allclose(peg[:, 2], 0.025)
    along = x_axis(peg)
    np.testing.assert_allclose(along[:, 2], 0, atol=1e-9)
    fills(np.arctan2(along[:, 1], along[:, 0]), -np.pi, np.pi)
    np.testing.assert_allclose(np.linalg.norm(peg[:, 3:7], axis=-1), 1)


def test_roll_ball_starts_as_the_authors_do():
    _, world, start = some("roll_ball")
    ball, target = start.qpos[:, 9:], start.fixtures[:, 2]
    fills(ball[:, 0], -0.4, 0.2)
    fills(ball[:, 1], 0.5, 0.7)
    fills(target[:, 0], -0.4, 0.2)
    fills(target[:, 1], -0.3, -0.1)
    np.testing.assert_allclose(ball[:, 2], 0.035)
    base = world.world_from_base
    np.testing.assert_allclose(base[:3, 3], [-0.1, 1, 0])
    np.testing.assert_allclose(base[:3, 0], [0, -1, 0], atol=1e-12)  # it faces the target


@pytest.mark.parametrize("name", NAMES)
def test_scenes_share_the_draws_and_only_one_moves_the_table(name):
    (_, _, fixed), (_, _, moved) = (some(name, 200, scene) for scene in ("fixed", "randomized"))
    np.testing.assert_array_equal(fixed.qpos, moved.qpos)
    np.testing.assert_array_equal(fixed.fixtures[:, 2:], moved.fixtures[:, 2:])
    assert (fixed.fixtures[:, :2] == [0, 0, 0, 1, 0, 0, 0]).all()
    for axis in range(2):
        fills(moved.fixtures[:, 0, axis], -0.2, 0.2)
    noise = fixed.qpos[:, :7] - make_task(name).scene("fixed").home
    np.testing.assert_allclose(noise.std(), 0.02, rtol=0.1)
    np.testing.assert_array_equal(fixed.qpos[:, 7:9], 0.04)


def state_of(world, qpos):
    count = len(qpos)
    return State(
        qpos, np.zeros((count, world.nv)), np.zeros((count, 0)), np.zeros(count), qpos[:, :7],
        np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)), np.ones(count, bool),
    )  # fmt: skip


def at(name, place=(0.0, 0.0), height=0.0, tilt=0.0):
    """An object relative to its target, raised, or a peg so far from upright (degrees)."""
    task, world, start = some(name, 3)
    qpos = start.qpos.copy()
    if name == "lift_upright":
        angle = np.deg2rad(90 - tilt) / 2
        qpos[:, 12:16] = [np.cos(angle), 0, -np.sin(angle), 0]
    else:
        qpos[:, 9:11] = start.fixtures[:, 2, :2] + place
        qpos[:, 11] += height
    return task, world, state_of(world, qpos), start


@pytest.mark.parametrize(
    ("case", "done"),
    [
        (("push",), True),
        (("push", (0.07, -0.071)), True),
        (("push", (0.071, -0.071)), False),
        (("push", (0, 0), 0.0049), True),
        (("push", (0, 0), 0.0051), False),
        (("roll_ball", (0, -0.099)), True),
        (("roll_ball", (0.101, 0)), False),
        (("lift_upright", (0, 0), 0, 19.9), True),
        (("lift_upright", (0, 0), 0, -19.9), True),
        (("lift_upright", (0, 0), 0, 20.1), False),
        (("lift_upright", (0, 0), 0, 160.1), True),
        (("lift_upright", (0, 0), 0, 90), False),
    ],
)
def test_success_is_the_authors_on_host_and_on_device(case, done):
    task, world, state, start = at(*case)
    assert task.success(world, state, start).tolist() == [done] * 3
    on_device = jax.jit(lambda state, start: task.success(world, state, start))
    success = on_device(State(*map(jnp.asarray, state)), Start(*map(jnp.asarray, start)))
    assert success.tolist() == [done] * 3


def test_nothing_is_done_at_the_start(world):
    task, scene = world
    start = starts(task, scene, range(100))
    assert not task.success(scene, state_of(scene, start.qpos), start).any()


def test_cameras_see_what_is_moved(world):
    """The middles of objects and targets are in the pictures, as far as the authors' cameras go."""
    task, scene = world
    start = starts(task, scene, range(200))
    cameras = sample_poses(task.cameras, 200, 23)
    points = np.concatenate([start.qpos[:, None, 9:12], start.fixtures[:, 2:, :3]], 1)
    camera_from_world = np.asarray(invert(cameras))
    local = points @ camera_from_world[:, :3, :3].swapaxes(1, 2) + camera_from_world[:, None, :3, 3]
    half = np.tan(np.deg2rad(task.fovy_deg) / 2)
    inside = (abs(local[..., :2]) < half * local[..., 2:]).all(-1)
    assert inside.mean() > {"push": 0.9, "lift_upright": 0.95, "roll_ball": 0.75}[task.name]


@pytest.mark.parametrize("distance", [0.25, 0.5, 0.8])
def test_a_pushing_hand_is_broadside_and_leans_where_it_must(distance):
    base, like = np.zeros(3), np.diag([1.0, -1, -1])
    for yaw in np.linspace(0, 6, 7):
        along = np.array([np.cos(yaw), np.sin(yaw)])
        grip = pushing_grip(base, np.array([distance, 0, 0.02]), along, like)
        np.testing.assert_allclose(grip @ grip.T, np.eye(3), atol=1e-12)
        assert grip[:, 1] @ like[:, 1] > -0.1  # turned by a quarter at most
        lean = np.arcsin(grip[0, 2])  # the fingers point down and out, or down and back
        expected = STRETCH * (max(0, distance - FAR) - max(0, CLOSE_BY - distance))
        assert lean == pytest.approx(expected)
        if not expected:
            assert abs(grip[:2, 1] @ along) < 1e-12


@pytest.fixture(scope="module")
def shown(maniskill, world):
    """A task, its world, and its expert's episodes."""
    task, scene = world
    engine = make_engine("auto", scene, "osc_pose")
    return task, scene, run_expert(task, scene, engine, list(SEEDS))


def test_the_expert_succeeds_by_small_steps_and_turns(shown):
    task, _, demos = shown
    assert sum(demo is not None for demo in demos) >= len(SEEDS) - 1
    demos = [demo for demo in demos if demo]
    assert max(demo.length for demo in demos) <= LONGEST[task.name]
    for demo in demos:
        points = np.concatenate([demo.eef_pos[:1], demo.actions[:, :3]])
        assert np.linalg.norm(np.diff(points, axis=0), axis=-1).max() <= STEP * (1 + 1e-6)
        turns = matrix_from_rotvec(demo.actions[:, 3:6])
        turns = rotvec_from_matrix(turns[1:] @ turns[:-1].mT)
        assert np.linalg.norm(turns, axis=-1).max() <= TURN * (1 + 1e-6)
        joints = demo.states[:, 1:8]
        assert abs(np.diff(joints, axis=0)).max() < 0.25  # the arm does not swing


def test_what_is_moved_ends_where_it_belongs(shown):
    task, _, demos = shown
    for demo in filter(None, demos):
        thing = demo.qpos[-1, 9:]
        if task.name == "lift_upright":  # the peg stands by itself
            assert abs(x_axis(thing)[2]) > np.cos(np.deg2rad(5))
            assert thing[2] == pytest.approx(0.12, abs=0.005)
            assert demo.actions[-1, 6] < 0
        else:
            near = {"push": 0.06, "roll_ball": 0.08}[task.name]
            assert np.linalg.norm(thing[:2] - demo.fixtures[2, :2]) < near


@pytest.mark.slow
def test_fifty_episodes_replay_in_every_action_space(maniskill, world):
    task, scene = world
    engine = make_engine("auto", scene, "osc_pose")
    demos = [d for d in run_expert(task, scene, engine, list(range(3000, 3050))) if d]
    assert len(demos) >= 48
    for success in replay_all(demos, task, scene).values():
        assert success.mean() >= 0.97


ENVIRONMENTS = """
import json, sys
import gymnasium, numpy as np, sapien
import jaxcam.sim.maniskill.envs
from jaxcam.rays import from_maniskill, sample_poses

K, SIGHTS = np.array(json.loads(sys.argv[2])), 4
measured = {}
for env_id in ("JaxcamPush-v1", "JaxcamLiftUpright-v1", "JaxcamRollBall-v1"):
    for scene in ("fixed", "randomized"):
        env = gymnasium.make(env_id, scene=scene, resolution=64, render_backend=sys.argv[1],
                             obs_mode="rgb+segmentation", control_mode="pd_joint_pos").unwrapped
        task, start = env.task, env.task.start(env.world, 7)
        after = []
        for seed in (7, None, None, [7]):
            _, info = env.reset(seed=seed)
            after.append(env.state().qpos[0])
        poses = sample_poses(task.cameras, task.views, SIGHTS)
        env.set_cameras(np.tile(K, (task.views, 1, 1)), poses)
        obs = env.get_obs()
        wrong = []
        for params, pose in zip(obs["sensor_param"].values(), poses, strict=True):
            wrong.append(abs(np.asarray(params["intrinsic_cv"][0]) - K).max())
            wrong.append(abs(from_maniskill(np.asarray(params["extrinsic_cv"][0])) - pose).max())
        views = list(obs["sensor_data"].values())
        ids = np.unique(np.asarray(views[0]["segmentation"]))
        named = env.segmentation_id_map
        gripper = env.agent.controller.controllers["gripper"].config
        markers = [np.asarray(marker.pose.raw_pose[0]) for marker in env.markers]
        body = sapien.render.RenderBodyComponent
        floor = env.table_scene.ground._objs[0].find_component_by_type(body).render_shapes[0]
        measured[f"{task.name} {scene}"] = dict(
            start=float(abs(after[0] - start.qpos).max()),
            repeats=float(abs(after[3] - after[0]).max()),
            others=[float(abs(after[i + 1] - after[i]).max()) for i in (0, 1)],
            done=bool(info["success"][0]),
            cameras=float(max(wrong)),
            seen=[np.asarray(view["rgb"][0]).tolist() for view in views],
            gripper=[gripper.lower, gripper.upper, gripper.stiffness, gripper.damping,
                     gripper.force_limit],
            markers=float(np.abs(np.reshape(markers, (-1, 7)) - start.fixtures[2:]).sum()),
            tables=[named[int(i)].name for i in ids if i and "table" in named[int(i)].name],
            pattern=floor.parts[0].material.base_color_texture is not None,
            steps=gymnasium.spec(env_id).max_episode_steps,
        )
        env.close()
print(json.dumps(measured))
"""


@pytest.fixture(scope="module")
def environments(maniskill):
    """What a process that uses the environments by itself finds."""
    ran = subprocess.run(
        [sys.executable, "-c", ENVIRONMENTS, device().kind, json.dumps(K.tolist())],
        capture_output=True, text=True, check=False, env=child_environment(),
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout.splitlines()[-1])


@pytest.mark.parametrize("scene", ["fixed", "randomized"])
@pytest.mark.parametrize("name", NAMES)
def test_environments_are_of_use_in_maniskill_alone(environments, name, scene):
    measured = environments[f"{name} {scene}"]
    assert measured["start"] < 1e-6  # float32
    assert measured["markers"] < 1e-6
    assert measured["repeats"] == 0
    assert min(measured["others"]) > 1e-3  # without a seed, each episode is another
    assert measured["steps"] == make_task(name).horizon
    assert not measured["done"]
    is_fixed = scene == "fixed"
    assert measured["tables"] == ["table-workspace" if is_fixed else "seen_table"]
    assert measured["pattern"] == is_fixed
    assert measured["cameras"] < 1e-4
    assert np.shape(measured["seen"]) == (make_task(name).views, 64, 64, 3)
    assert measured["gripper"] == [-0.03, 0.04, 3e3, 2e2, 300]


@pytest.mark.parametrize(
    ("name", "scene"),
    [("push", "fixed"), ("lift_upright", "randomized"), ("roll_ball", "randomized")],
)
def test_our_pictures_are_maniskills_but_for_triangles_that_nobody_sees(environments, name, scene):
    """A sixth of the triangles: outlines move by less than a pixel."""
    task = make_task(name)
    world, views = task.scene(scene), task.views
    start = starts(task, world, [7] * views)
    poses = sample_poses(task.cameras, views, 4)
    drawn = make_painter(world, 64).rgb(View(*start, np.tile(K, (views, 1, 1)), poses))
    apart = abs(drawn.astype(int) - np.array(environments[f"{name} {scene}"]["seen"])).max(-1)
    assert 0 < (apart > 8).mean() < 0.015
    assert apart.mean() < 1
