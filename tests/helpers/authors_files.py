"""Files as the paper's authors record them: CanRand and SquareRand, in robomimic's layout.

Episodes are those of our expert. The models are put together of robosuite's parts as the authors'
environments do it: their names, the order of their joints, a ghost and two sheets on free joints,
and a peg whose parts hang together.
"""

import json

import h5py
import mujoco
import numpy as np
from robomimic_files import recorded

from jaxcam.data.collection import run_expert
from jaxcam.rays import invert
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import make_engine, make_task

NAMES = {"pick_place_can": "CanRand", "square": "SquareRand"}
OBJECTS = {"can": "Can", "nut": "Square", "peg": "Peg"}
SHEETS = {"pick_place_can": ("plane", "floor_plane"), "square": ("table_plane", "floor_plane")}
SCALES = np.repeat([0.5, 2.0], 3)
"""What an action of 1 stands for in OSC_POSE (m, rad): our expert aims further than theirs."""


def model_of(task):
    """The MJCF of the authors' environment."""
    import robosuite.models as models
    from robosuite.models.objects import (
        BoxObject,
        CanObject,
        CompositeBodyObject,
        CylinderObject,
        SquareNutObject,
    )

    robot = models.robots.Panda()
    robot.add_base(models.bases.robot_base_factory(robot.default_base, idn=0))
    robot.add_gripper(models.grippers.PandaGripper(idn="0_right"))
    robot.set_base_xpos(np.asarray(robot.base_xpos_offset["table"](0.8), float))
    arena = models.arenas.TableArena(
        table_full_size=(0.8, 0.8, 0.05), table_offset=np.array((0.0, 0.0, 0.8))
    )
    arena.set_origin([0, 0, 0])
    sheets = [BoxObject(name=name, size=[0.4, 0.4, 0.001]) for name in SHEETS[task]]
    if task == "pick_place_can":
        things = [CanObject(name="VisualCan"), CanObject(name="Can")]
    else:
        parts = [
            CylinderObject(name="PegCyl", size=[0.012, 0.05], joints=None, density=2000.0),
            BoxObject(name="PegBase", size=[0.06, 0.06, 0.005], joints=None, density=2000.0),
        ]
        places = [[0.0, 0.0, 0.055], [0.0, 0.0, 0.0]]
        peg = CompositeBodyObject(
            name="Peg", objects=parts, object_locations=places, joints="default"
        )
        things = [SquareNutObject(name="Square"), peg]
    whole = models.tasks.ManipulationTask(
        mujoco_arena=arena, mujoco_robots=[robot], mujoco_objects=[*things, *sheets]
    )
    return whole.get_xml()


def flat_states(xml, demo, scene, task):
    """The states of a demonstration in the order of the authors' model; all else stands still."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = np.eye(4)
    base[:3, :3] = data.body("robot0_base").xmat.reshape(3, 3)
    base[:3, 3] = data.body("robot0_base").xpos
    theirs_from_world = base @ invert(scene.world_from_base)
    np.testing.assert_allclose(theirs_from_world[:3, :3], np.eye(3), atol=1e-9)
    shift = theirs_from_world[:3, 3]
    qpos, qvel = np.zeros((len(demo.qpos), model.nq)), np.zeros((len(demo.qpos), model.nv))
    for i in range(scene.physics.njnt):
        ours = scene.physics.joint(i)
        body = ours.name.removesuffix("_joint0")
        theirs = model.joint(ours.name.replace(body, OBJECTS.get(body, body)))
        width = len(ours.qpos0)
        there = theirs.qposadr[0] + np.arange(width)
        qpos[:, there] = demo.qpos[:, ours.qposadr[0] + np.arange(width)]
        if width == 7:
            qpos[:, there[:3]] += shift
        speeds = np.arange(len(ours.damping))
        qvel[:, theirs.dofadr[0] + speeds] = demo.qvel[:, ours.dofadr[0] + speeds]
    start = demo.start()
    poses = dict(zip((*SHEETS[task], "VisualCan"), start.fixtures, strict=False))
    for name, pose in poses.items():
        at = model.joint(f"{name}_joint0").qposadr[0]
        qpos[:, at : at + 7] = pose
        qpos[:, at : at + 3] += shift
        qpos[:, at + 2] += 0.01  # the ghost hangs as high as the can falls from
    return np.column_stack([np.arange(len(qpos)) / 20, qpos, qvel])


def deltas_of(demo, scene):
    """OSC_POSE deltas in the axes of the base [T, 7], the last one zero."""
    axes = scene.world_from_base[:3, :3]
    targets, rotations = demo.actions, demo.world_from_grip()[:, :3, :3]
    place = (targets[:, :3] - demo.eef_pos[:-1]) @ axes
    turn = matrix_from_rotvec(targets[:, 3:6]) @ rotations[:-1].mT
    moves = np.column_stack([place, rotvec_from_matrix(axes.T @ turn @ axes)]) / SCALES
    assert np.abs(moves).max() <= 1
    actions = np.column_stack([moves, targets[:, 6]])
    return np.concatenate([actions, np.zeros((1, 7))])


def write_authors_file(path, task, seeds=(142, 143), actions="eef_delta"):
    """A file of the authors' layout, and the demonstrations in it.

    Seeds are not those that an import would give, so that nothing fits by chance.
    """
    thing = make_task(task)
    scene = thing.scene("randomized")
    engine = make_engine(None, scene, "osc_pose", thing.varied)
    demos = [demo for demo in run_expert(thing, scene, engine, list(seeds)) if demo]
    xml = model_of(task)
    settings = recorded("1.5")["env_args"] | {"env_name": NAMES[task]}
    arm = settings["env_kwargs"]["controller_configs"]["body_parts"]["right"]
    arm |= {"output_max": SCALES.tolist(), "output_min": (-SCALES).tolist()}
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = sum(demo.length + 1 for demo in demos)
        data.attrs["env_args"] = json.dumps(settings)
        data.attrs["action_space"] = actions
        for i, demo in enumerate(demos):
            group = data.create_group(f"demo_{i}")
            group.attrs["num_samples"] = demo.length + 1
            group.attrs["model_file"] = xml
            group["states"] = flat_states(xml, demo, scene, task)
            group.attrs["starting_abs_action"] = demo.actions[0]
            moves = deltas_of(demo, scene)
            if actions == "joint_abs":
                after = np.concatenate([demo.qpos[1:], demo.qpos[-1:]])[:, scene.arm]
                moves = np.column_stack([after, moves[:, 6]])
            group["actions"] = moves
    return demos
