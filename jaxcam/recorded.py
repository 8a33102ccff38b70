"""What the recorded states of a demonstration tell, without stepping them."""

import numpy as np

from jaxcam.demos import Demo
from jaxcam.rotations import matrix_from_quaternion
from jaxcam.sim.engine import Start, State
from jaxcam.sim.task import Task
from jaxcam.sim.world import World


def succeeds(demo: Demo, task: Task, scene: World) -> bool:
    """Whether the task is done in one of a demonstration's states."""
    qpos, qvel = demo.states[:, 1 : 1 + scene.nq], demo.states[:, 1 + scene.nq :]
    state = State(
        qpos=qpos,
        qvel=qvel,
        warmstart=np.zeros((len(qpos), 0)),
        closed=demo.gripper,
        rest=qpos[:, scene.arm],
        grip_position=demo.eef_pos,
        grip_rotation=matrix_from_quaternion(np.roll(demo.eef_quat, 1, -1)),
        ok=np.ones(len(qpos), bool),
    )
    return bool(task.success(scene, state, Start(qpos[0], demo.geom_size, demo.fixtures)).any())
