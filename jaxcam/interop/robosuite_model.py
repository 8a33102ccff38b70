"""What a robosuite demonstration says of its world: its MuJoCo model.

States are arrays in the order of the model that recorded them, and robosuite's versions differ in
names, tables and where the robot stands. `Origin` maps states onto a scene of ours by the joints'
names and the pose of the robot's base. The model is text that anybody may have written: only its
bodies, joints and shapes are read, and MuJoCo opens no file for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from jaxcam.errors import DatasetError
from jaxcam.rays import invert
from jaxcam.rays.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from jaxcam.sim.mujoco.scene import TABLE_TOP, Scene

TABLE_TOLERANCE = 0.002
"""Largest difference (m) of the table's height against the robot that a replay forgives."""
GRIP_TOLERANCE = 0.001
"""Largest distance (m) between the grip site in the recorded model and in the scene."""
MOST_ELEMENTS, DEEPEST = 20_000, 200
"""Elements of a model, and how many inside each other: robosuite's have 300, and 20."""
_BODIES = {"worldbody", "body", "frame", "inertial", "joint", "freejoint", "geom", "site"} | {
    "camera",
    "light",
}
_OF_FILES = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)


@dataclass(frozen=True)
class ObjectNames:
    """What a recorded world calls what a scene of ours has.

    Attributes:
        moved: Their names of our objects, where these are others.
        shown: Their names of what is seen and never touched, by our row of `fixtures`: 0 is the
            table, 1 the room, then come the task's markers. Where a recording moves them, each
            hangs on a free joint that ours does not have.
    """

    moved: Mapping[str, str] = field(default_factory=dict)
    shown: Mapping[int, str] = field(default_factory=dict)

    def joint(self, ours: str) -> str:
        """Their name of a joint of ours."""
        body = ours.removesuffix("_joint0")
        return f"{self.moved[body]}_joint0" if body in self.moved else ours


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
    _shown: Mapping[int, int] = field(repr=False)

    def fixtures(self, state: np.ndarray, usual: np.ndarray, rows: Sequence[int]) -> np.ndarray:
        """Poses (xyz, wxyz) [k, 7] of what is seen, as far as a recorded state has them.

        Args:
            state: The first one.
            usual: Poses to begin with. They keep their heights: a recorded sheet lies on a table,
                and a recorded ghost hangs in the air.
            rows: Those that may be moved and turned about the vertical.
        """
        poses = usual.copy()
        for row in rows:
            if (at := self._shown.get(row)) is None:
                continue
            pose = state[1 + at : 1 + at + 7]
            rotation = self.world_from_theirs[:3, :3]
            place = rotation @ pose[:3] + self.world_from_theirs[:3, 3]
            ahead = (rotation @ matrix_from_quaternion(pose[3:]))[:, 0]
            half = np.arctan2(ahead[1], ahead[0]) / 2
            poses[row, :2] = place[:2]
            poses[row, 3:] = np.cos(half), 0, 0, np.sin(half)
        return poses

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


def read_origin(
    xml: str,
    state: np.ndarray,
    scene: Scene,
    varied: Sequence[str],
    names: ObjectNames | None = None,
) -> Origin:
    """Maps a demonstration's own model onto a scene.

    Args:
        xml: Its MJCF; the meshes that it names need not exist here.
        state: One of its states, to hold both models against each other.
        scene: Where it shall be replayed.
        varied: Geoms of the scene whose sizes come from the model.
        names: What the recorded world calls things; as ours when None.

    Raises:
        DatasetError: If the model is not one of this scene's robot, joints and table.
    """
    model, names = _kinematics_of(xml), names or ObjectNames()
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
    joints, shown = _match_joints(model, scene.physics, names)
    origin = Origin(
        nq=model.nq,
        nv=model.nv,
        world_from_theirs=world_from_theirs,
        theirs_from_controller=frame,
        geom_size=np.reshape([model.geom_size[_named(model, "geom", g)] for g in varied], (-1, 3)),
        _qpos=_addresses(joints, "qposadr"),
        _qvel=_addresses(joints, "dofadr"),
        _free=np.array(
            [(ours.qposadr[0], ours.dofadr[0]) for ours, _ in joints if len(ours.qpos0) == 7], int
        ).reshape(-1, 2),
        _shown=shown,
    )
    _check_table(model, data, world_from_theirs)
    _check_grip(model, data, scene, origin, state)
    return origin


class _Bounded(ElementTree.TreeBuilder):
    """Builds the tree of an XML text, unless it is far beyond a robot on a table."""

    depth = count = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self.depth, self.count = self.depth + 1, self.count + 1
        if self.depth > DEEPEST or self.count > MOST_ELEMENTS:
            raise DatasetError(
                f"model_file has over {MOST_ELEMENTS} elements, or {DEEPEST} inside each other. It "
                "is no model of a robot on a table."
            )
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self.depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str, system: str) -> None:
        raise DatasetError("model_file declares a document type, which no MJCF has.")


def _kinematics_of(xml: str) -> mujoco.MjModel:
    """The model without its meshes and colours, which lie on the machine that recorded it."""
    try:
        spec = mujoco.MjSpec.from_string(_bodies_of(xml))
        for geom in list(spec.geoms):
            if geom.meshname or geom.hfieldname or geom.type in _OF_FILES:
                spec.delete(geom)
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-6  # only poses are asked of it
        return spec.compile()
    except (ValueError, ElementTree.ParseError, mujoco.FatalError) as error:
        raise DatasetError(f"model_file is no MJCF that this MuJoCo reads: {error}.") from error


def _bodies_of(xml: str) -> str:
    """A model reduced to bodies, joints and shapes: nothing that names files or grows.

    Raises:
        DatasetError: An element is not known to be one of these, or there are too many.
    """
    root = ElementTree.fromstring(xml, ElementTree.XMLParser(target=_Bounded()))
    for part in list(root):
        if part.tag in ("include", "extension"):
            raise _not_allowed(part.tag)
        if part.tag not in ("compiler", "default", "worldbody"):
            root.remove(part)
            continue
        for element in part.iter():
            if part.tag == "worldbody" and element.tag not in _BODIES:
                raise _not_allowed(element.tag)
            if element.tag in ("include", "plugin") or "plugin" in element.attrib:
                raise _not_allowed(element.tag)
            element.attrib.pop("material", None)
            for child in [c for c in element if c.tag in ("camera", "light")]:
                element.remove(child)
    return ElementTree.tostring(root, encoding="unicode")


def _not_allowed(tag: str) -> DatasetError:
    return DatasetError(
        f"model_file has an element {tag!r}. Only plain bodies are read of a recorded model, as "
        "robosuite writes them: nothing that reads files, loads code or makes copies."
    )


def _named(model: mujoco.MjModel, kind: str, name: str) -> int:
    """The id of robosuite's `name`, which up to 1.4 had no arm in a gripper's names."""
    for known in (name, name.replace("gripper0_right_", "gripper0_")):
        number = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), known)
        if number >= 0:
            return number
    raise DatasetError(
        f"no {kind} {name!r} in its model_file. Only robosuite's single Panda on its table can be "
        "imported."
    )


def _match_joints(
    theirs: mujoco.MjModel, ours: mujoco.MjModel, names: ObjectNames
) -> tuple[list[tuple[Any, Any]], dict[int, int]]:
    """Each joint of ours with theirs, and where in their qpos is what is only seen, by its row."""
    pairs = [
        (ours.joint(i), theirs.joint(_named(theirs, "joint", names.joint(ours.joint(i).name))))
        for i in range(ours.njnt)
    ]
    known = {theirs.joint(i).name: theirs.joint(i) for i in range(theirs.njnt)}
    shown = {
        row: int(joint.qposadr[0])
        for row, name in names.shown.items()
        if (joint := known.get(f"{name}_joint0")) is not None
        and joint.type[0] == mujoco.mjtJoint.mjJNT_FREE
    }
    if len(pairs) + len(shown) != theirs.njnt or any(a.type[0] != b.type[0] for a, b in pairs):
        raise DatasetError(
            f"joints {[theirs.joint(i).name for i in range(theirs.njnt)]}, but the scene has "
            f"{[a.name for a, _ in pairs]}. It is another task's or another robot's."
        )
    return pairs, shown


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
    if not abs(height - TABLE_TOP) <= TABLE_TOLERANCE:
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
    ours = grip_path(scene, origin.carry(state[None])[0]).position[0]
    if not (apart := float(np.linalg.norm(theirs[:3] - ours))) <= GRIP_TOLERANCE:
        raise DatasetError(
            f"its gripper is {apart:.3f} m from where the scene's robot has it with the same "
            "joint angles. It is another arm or gripper than robosuite's Panda."
        )


@dataclass(frozen=True)
class GripPath:
    """The grip site in the scene's world, a row for each recorded state."""

    position: np.ndarray
    """(m) [T, 3]."""
    rotation: np.ndarray
    """Its axes [T, 3, 3]."""


def grip_path(scene: Scene, qpos: np.ndarray) -> GripPath:
    """Where the grip is in states [T, nq]."""
    model, data = scene.physics, mujoco.MjData(scene.physics)
    path = GripPath(np.empty((len(qpos), 3)), np.empty((len(qpos), 3, 3)))
    for t, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        path.position[t] = data.site_xpos[scene.grip_site]
        path.rotation[t] = data.site_xmat[scene.grip_site].reshape(3, 3)
    return path
