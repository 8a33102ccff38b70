"""What a robosuite demonstration says of itself: its MuJoCo model and its controller.

States are arrays in the order of the model that recorded them, and robosuite's versions differ in
names, tables and where the robot stands. `Origin` maps states onto a scene of ours by the joints'
names and the pose of the robot's base; `Controller` turns the actions of robosuite's OSC_POSE into
absolute targets (control laws of robosuite 1.4.1 and 1.5.2, `controllers/.../osc.py`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.rays import invert
from jaxcam.rays.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
    rotvec_from_matrix,
)
from jaxcam.sim.controllers import OSC_KP
from jaxcam.sim.mujoco.scene import TABLE_TOP, Scene

TABLE_TOLERANCE = 0.002
"""Largest difference (m) of the table's height against the robot that a replay forgives."""
GRIP_TOLERANCE = 0.001
"""Largest distance (m) between the grip site in the recorded model and in the scene."""


@dataclass(frozen=True)
class Origin:
    """The model that a demonstration was recorded with, mapped onto a scene."""

    nq: int
    nv: int
    world_from_theirs: np.ndarray
    """From the recorded world to the scene's, the robots' bases put together [4, 4]."""
    theirs_from_controller: np.ndarray
    """Frame of robosuite 1.5's "base" actions in the recorded world [4, 4]."""
    geom_size: np.ndarray
    """Sizes (m) of the task's varied geoms [v, 3]."""
    _qpos: np.ndarray = field(repr=False)
    _qvel: np.ndarray = field(repr=False)
    _free: np.ndarray = field(repr=False)

    def carry(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The scene's qpos [T, nq] and qvel [T, nv] of recorded states [T, 1 + nq + nv]."""
        qpos = states[:, 1 + self._qpos]
        qvel = states[:, 1 + self.nq + self._qvel]
        rotation, position = self.world_from_theirs[:3, :3], self.world_from_theirs[:3, 3]
        for q, v in self._free:
            qpos[:, q : q + 3] = qpos[:, q : q + 3] @ rotation.T + position
            turned = rotation @ matrix_from_quaternion(qpos[:, q + 3 : q + 7])
            qpos[:, q + 3 : q + 7] = quaternion_from_matrix(turned)
            qvel[:, v : v + 3] = qvel[:, v : v + 3] @ rotation.T  # turning is in the body's axes
        return qpos, qvel


def read_origin(xml: str, state: np.ndarray, scene: Scene, varied: Sequence[str]) -> Origin:
    """Maps a demonstration's own model onto a scene.

    Args:
        xml: Its MJCF; the meshes that it names need not exist here.
        state: One of its states, to hold both models against each other.
        scene: Where it shall be replayed.
        varied: Geoms of the scene whose sizes come from the model.

    Raises:
        DatasetError: If the model is not one of this scene's robot, joints and table.
    """
    model = _kinematics_of(xml)
    size = 1 + model.nq + model.nv
    if len(state) != size:
        raise DatasetError(
            f"states of {len(state)} numbers, but its model_file has {size} (time, {model.nq} "
            f"qpos, {model.nv} qvel). They do not belong together."
        )
    data = mujoco.MjData(model)
    data.qpos[:] = state[1 : 1 + model.nq]
    mujoco.mj_kinematics(model, data)
    base = _named(model, "body", "robot0_base")
    theirs_from_base = _pose(data.xpos[base], data.xmat[base])
    world_from_theirs = scene.world_from_base @ invert(theirs_from_base)
    frame = theirs_from_base
    if (site := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "robot0_right_center")) >= 0:
        frame = _pose(data.site_xpos[site], data.site_xmat[site])
    joints = _match_joints(model, scene.physics)
    origin = Origin(
        nq=model.nq,
        nv=model.nv,
        world_from_theirs=world_from_theirs,
        theirs_from_controller=frame,
        geom_size=np.array([model.geom_size[_named(model, "geom", g)] for g in varied]),
        _qpos=_addresses(joints, "qposadr"),
        _qvel=_addresses(joints, "dofadr"),
        _free=np.array(
            [(ours.qposadr[0], ours.dofadr[0]) for ours, _ in joints if len(ours.qpos0) == 7], int
        ).reshape(-1, 2),
    )
    _check_table(model, data, world_from_theirs)
    _check_grip(model, data, scene, origin, state)
    return origin


def _kinematics_of(xml: str) -> mujoco.MjModel:
    """The model without its meshes and colours, which lie on the machine that recorded it."""
    try:
        spec = mujoco.MjSpec.from_string(xml)
        for geom in list(spec.geoms):
            geom.material = ""
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                spec.delete(geom)
        for assets in (spec.meshes, spec.materials, spec.textures):
            for asset in list(assets):
                spec.delete(asset)
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-6  # only poses are asked of it
        return spec.compile()
    except ValueError as error:
        raise DatasetError(f"model_file is no MJCF that this MuJoCo reads: {error}.") from error


def _named(model: mujoco.MjModel, kind: str, name: str) -> int:
    """The id of robosuite's `name`, which up to 1.4 had no arm in a gripper's names."""
    for known in (name, name.replace("gripper0_right_", "gripper0_")):
        found = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), known)
        if found >= 0:
            return found
    raise DatasetError(
        f"no {kind} {name!r} in its model_file. Only robosuite's single Panda on its table can be "
        "imported."
    )


def _match_joints(theirs: mujoco.MjModel, ours: mujoco.MjModel) -> list[tuple[Any, Any]]:
    """Each joint of ours with theirs of the same name."""
    pairs = [
        (ours.joint(i), theirs.joint(_named(theirs, "joint", ours.joint(i).name)))
        for i in range(ours.njnt)
    ]
    if len(pairs) != theirs.njnt or any(a.type[0] != b.type[0] for a, b in pairs):
        raise DatasetError(
            f"joints {[theirs.joint(i).name for i in range(theirs.njnt)]}, but the scene has "
            f"{[a.name for a, _ in pairs]}. It is another task's or another robot's."
        )
    return pairs


def _addresses(joints: list[tuple[Any, Any]], kind: str) -> np.ndarray:
    """For each number of ours, in order, which of theirs it is."""
    sizes = [len(a.qpos0) if kind == "qposadr" else len(a.damping) for a, _ in joints]
    return np.concatenate(
        [getattr(b, kind)[0] + np.arange(n) for (_, b), n in zip(joints, sizes, strict=True)]
    )


def _pose(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


def _check_table(model: mujoco.MjModel, data: mujoco.MjData, world_from_theirs: np.ndarray) -> None:
    table = _named(model, "geom", "table_collision")
    top = data.geom_xpos[table] + [0, 0, model.geom_size[table, 2]]
    height = float((world_from_theirs[:3, :3] @ top + world_from_theirs[:3, 3])[2])
    if abs(height - TABLE_TOP) > TABLE_TOLERANCE:
        raise DatasetError(
            f"the table's top is {height - TABLE_TOP:+.3f} m off the scene's against the robot's "
            f"base; at most {TABLE_TOLERANCE} m was expected. Its objects would hover or sink."
        )


def _check_grip(
    model: mujoco.MjModel, data: mujoco.MjData, scene: Scene, origin: Origin, state: np.ndarray
) -> None:
    """Both models must put the gripper in the same place, or it is another robot."""
    site = _named(model, "site", "gripper0_right_grip_site")
    theirs = origin.world_from_theirs @ np.append(data.site_xpos[site], 1)
    position, _ = grip_poses(scene, origin.carry(state[None])[0])
    if (apart := float(np.linalg.norm(theirs[:3] - position[0]))) > GRIP_TOLERANCE:
        raise DatasetError(
            f"its gripper is {apart:.3f} m from where the scene's robot has it with the same "
            "joint angles. It is another arm or gripper than robosuite's Panda."
        )


def grip_poses(scene: Scene, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions [T, 3] and axes [T, 3, 3] of the grip site in the world."""
    data = mujoco.MjData(scene.physics)
    positions, rotations = np.empty((len(qpos), 3)), np.empty((len(qpos), 3, 3))
    for t, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(scene.physics, data)
        positions[t] = data.site_xpos[scene.grip_site]
        rotations[t] = data.site_xmat[scene.grip_site].reshape(3, 3)
    return positions, rotations


@dataclass(frozen=True)
class Controller:
    """The OSC_POSE controller that a file's actions were given to."""

    input_range: np.ndarray
    """Smallest and largest action [2, 6]."""
    output_range: np.ndarray
    """What these stand for (m, rad) [2, 6]."""
    is_delta: bool
    in_base: bool
    """Whether actions are in the axes of the robot's base or in the world's."""
    keeps_rotation: bool
    """Whether a rotation of zero keeps the orientation asked for last, as in robosuite 1.4."""

    def targets(
        self, actions: np.ndarray, origin: Origin, position: np.ndarray, rotation: np.ndarray
    ) -> np.ndarray:
        """Absolute targets (m, rotation vector; the scene's world) [T, 6].

        Args:
            actions: Of the arm [T, 6].
            origin: Of the demonstration.
            position: Measured grip site (m; the scene's world) [T, 3].
            rotation: Its axes [T, 3, 3].
        """
        frame = origin.world_from_theirs.copy()
        if self.in_base:
            frame = frame @ origin.theirs_from_controller
        axes = frame[:3, :3]
        if not self.is_delta:
            goal = axes @ matrix_from_rotvec(actions[:, 3:])
            place = actions[:, :3] @ axes.T + frame[:3, 3]
            return np.concatenate([place, rotvec_from_matrix(goal)], -1)
        (low, high), (least, most) = self.input_range, self.output_range
        share = (np.clip(actions, low, high) - low) / (high - low)
        moves = least + share * (most - least)
        turn = axes @ matrix_from_rotvec(moves[:, 3:]) @ axes.T
        goal = turn @ rotation
        if self.keeps_rotation:
            kept = rotation[0]
            for t, still in enumerate(np.isclose(moves[:, 3:], 0, rtol=0, atol=1e-12).all(-1)):
                kept = goal[t] = kept if still else goal[t]
        return np.concatenate([position + moves[:, :3] @ axes.T, rotvec_from_matrix(goal)], -1)


def read_controller(settings: Mapping[str, Any] | Sequence[Any]) -> Controller:
    """Reads `controller_configs` of robosuite 1.4 (one arm's) or 1.5 (of body parts).

    Raises:
        DatasetError: If the actions are no OSC_POSE targets that ours would follow alike.
    """
    part: Any = settings[0] if isinstance(settings, Sequence) and settings else settings
    is_composite = isinstance(part, Mapping) and "body_parts" in part
    if is_composite:
        parts = part["body_parts"]
        part = parts.get("arms", parts).get("right", {})
    if not isinstance(part, Mapping):
        raise DatasetError("env_args names no controller.")
    damping = part.get("damping_ratio", part.get("damping", 1))
    found = {
        "type": part.get("type"),
        "impedance_mode": part.get("impedance_mode", "fixed"),
        "kp": part.get("kp", OSC_KP),
        "damping_ratio": damping,
    }
    wanted = {"type": "OSC_POSE", "impedance_mode": "fixed", "kp": OSC_KP, "damping_ratio": 1}
    wrong = [k for k, v in wanted.items() if not np.all(np.asarray(found[k]) == v)]
    if wrong:
        raise DatasetError(
            "its actions were given to a controller of "
            + ", ".join(f"{k} {found[k]!r} (expected {wanted[k]!r})" for k in wrong)
            + "."
        )
    return Controller(
        input_range=_range(part, "input", 1.0),
        output_range=_range(part, "output", [0.05, 0.05, 0.05, 0.5, 0.5, 0.5]),
        is_delta=part.get("input_type", "delta") == "delta" and part.get("control_delta", True),
        in_base=is_composite and part.get("input_ref_frame", "base") == "base",
        keeps_rotation=not is_composite,
    )


def _range(part: Mapping[str, Any], which: str, most: Any) -> np.ndarray:
    high = np.broadcast_to(np.asarray(part.get(f"{which}_max", most), float), 6)
    low = np.broadcast_to(np.asarray(part.get(f"{which}_min", np.negative(most)), float), 6)
    return np.stack([low, high])
