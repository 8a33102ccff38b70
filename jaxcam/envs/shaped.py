"""robosuite's shaped rewards, for the tasks on its table.

They are those of robosuite 1.5.1 (`Lift.reward`, and `staged_rewards` of `PickPlace` and
`NutAssembly` with one object): success is 1 and everything before is less. What its bin and its peg
are there, our target and our peg are here, and success is our task's.
"""

import copy

import mujoco
import numpy as np

from jaxcam.config.names import TaskName
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim import make_task
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.tasks.pick_place_can import NEAR
from jaxcam.sim.tasks.square import HANDLE
from jaxcam.sim.types import Start, State
from jaxcam.sim.world import World

PADS = ("gripper0_right_finger1_pad_collision", "gripper0_right_finger2_pad_collision")
"""An object is grasped that touches both of them."""
OBJECTS: dict[str, str] = {"lift": "cube", "pick_place_can": "can", "square": "nut"}
"""What is grasped, by task."""
REACHED, GRASPED, LIFTED, OVER = 0.1, 0.35, 0.5, 0.7
"""Most that each stage gives."""
CAN_UP, NUT_UP = TABLE_TOP + 0.25, TABLE_TOP - 0.025 + 0.2
"""Heights (m) at which can and nut count as lifted: over the bin's surface, and over the middle of
the table's board, which is 5 cm thick."""


class ShapedReward:
    """The shaped reward of a task.

    Args:
        task: One of `OBJECTS`.
        world: Its world.
    """

    def __init__(self, task: TaskName, world: World) -> None:
        assert isinstance(world, Scene)  # the options have refused the other tasks
        self._task, self._world = task, world
        self._object = world.qpos_of(OBJECTS[task])
        self._model = model = copy.copy(world.physics)
        self._data = mujoco.MjData(model)
        self._varied = [model.geom(name).id for name in make_task(task).varied]
        body = model.jnt_bodyid[np.flatnonzero(model.jnt_qposadr == self._object)[0]]
        geoms = np.flatnonzero(model.geom_bodyid == body)
        self._touching = [
            {frozenset((model.geom(pad).id, int(geom))) for geom in geoms} for pad in PADS
        ]

    def __call__(
        self, state: State, start: Start, success: np.ndarray, going: np.ndarray
    ) -> np.ndarray:
        """Rewards [B] of a control step.

        Args:
            state: After it.
            start: Of the episodes.
            success: [B] those that are done.
            going: [B] those that made it; the others get 0.
        """
        rewards = np.where(going & success, 1.0, 0.0)
        rows = np.flatnonzero(going & ~success)
        qpos, grip = state.qpos[rows], state.grip_position[rows]
        sizes, fixtures = np.asarray(start.geom_size)[rows], np.asarray(start.fixtures)[rows]
        grasp = np.array([self.grasps(*one) for one in zip(qpos, sizes, strict=True)], bool)
        at = qpos[:, self._object : self._object + 3]
        if self._task == "lift":
            rewards[rows] = (_closeness(at - grip) + 0.25 * grasp) / 2.25
        elif self._task == "pick_place_can":
            aside = fixtures[:, 2, :2] - at[:, :2]
            over = np.linalg.norm(aside, axis=-1) <= NEAR
            lift = _lift(grasp, CAN_UP - at[:, 2])
            rewards[rows] = _best(_closeness(at - grip), lift, np.where(over, LIFTED, lift), aside)
        else:
            peg = self._world.qpos_of("peg")
            turned = matrix_from_quaternion(qpos[:, self._object + 3 : self._object + 7])
            handle = at + HANDLE * turned[..., 0]
            lift = _lift(grasp, NUT_UP - at[:, 2])
            aside = qpos[:, peg : peg + 2] - at[:, :2]
            rewards[rows] = _best(_closeness(handle - grip), lift, lift, aside)
        return rewards

    def grasps(self, qpos: np.ndarray, sizes: np.ndarray) -> bool:
        """Whether both finger pads touch the object.

        Args:
            qpos: Positions of a world [nq].
            sizes: Of the task's varied geoms (m) [v, 3].
        """
        model, data = self._model, self._data
        model.geom_size[self._varied] = sizes
        model.geom_rbound[self._varied] = np.linalg.norm(sizes, axis=-1)
        model.geom_aabb[self._varied, 3:] = sizes
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        contacts = {frozenset(pair) for pair in data.contact.geom.tolist()}
        return all(contacts & pairs for pairs in self._touching)


def _closeness(way: np.ndarray) -> np.ndarray:
    """From 0 to 1 at the end of ways (m) [n, 2 or 3]."""
    return 1 - np.tanh(10.0 * np.linalg.norm(way, axis=-1))


def _lift(grasp: np.ndarray, below: np.ndarray) -> np.ndarray:
    """What lifting gives [n] for objects that are so far (m) below where they are to be."""
    height = 1 - np.tanh(15.0 * np.maximum(below, 0.0))
    return np.where(grasp, GRASPED + height * (LIFTED - GRASPED), 0.0)


def _best(reach: np.ndarray, lift: np.ndarray, base: np.ndarray, aside: np.ndarray) -> np.ndarray:
    """The best of the stages [n]: reaching, grasping and lifting, and being over the goal.

    Args:
        reach: Closeness of the grip [n].
        lift: What lifting gives [n].
        base: What the last stage begins with [n].
        aside: Ways from object to goal (m) [n, 2].
    """
    hover = base + _closeness(aside) * (OVER - LIFTED)
    return np.maximum(np.maximum(REACHED * reach, lift), hover)
