"""The arm's model: what its links look like, and where they are at given joint angles.

MuJoCo reads MJCF and URDF alike. What no joint moves (the base, a pedestal) is left out: it is the
same in all pictures. The base frame is that of the body in which the first moving body sits.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from jaxcam.errors import ConfigError, closest
from jaxcam.files.paths import read_text
from jaxcam.robot.calibration.projection import pose_of

PANDA = "panda"
"""The arm that comes with the package: Franka's Panda with its gripper, of robosuite's models."""
GRID = 0.003
"""Details of surfaces that are finer than this (m) go: a fifth of a pixel."""
_FINE = 24
"""Faces around a cylinder, a capsule or a sphere."""


@dataclass(frozen=True)
class LinkSurface:
    """The surface of a link that a joint moves."""

    body: int
    """Its number in the model."""
    vertices: np.ndarray = field(repr=False)
    """In the link's axes (m), [n, 3]; none twice."""
    faces: np.ndarray = field(repr=False)
    """Vertices of triangles, seen from outside counter-clockwise, [m, 3]."""


class ArmModel:
    """An arm: its moving links, and where they are.

    Args:
        model: MuJoCo's.
        base: Name of the body whose frame is the base's; the world's when empty.
        arm: Names of its joints, from the base on.
        fingers: Names of the joints of its fingers; those without a name here stay at zero.
        known: Whether it is known how far the fingers are open; else they are left out.

    Raises:
        ConfigError: A name is unknown, or nothing is moved by these joints.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        base: str,
        arm: Sequence[str],
        fingers: Sequence[str] = (),
        *,
        known: bool = True,
    ) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        names = [model.joint(i).name for i in range(model.njnt)]
        for name in (*arm, *fingers):
            if name not in names:
                raise ConfigError(f"The robot has no joint {name!r}{closest(name, names)}.")
        self._arm = np.array([model.joint(name).qposadr[0] for name in arm], int)
        self._fingers = np.array([model.joint(name).qposadr[0] for name in fingers], int)
        self._ranges = np.array([model.joint(name).range for name in fingers]).reshape(-1, 2)
        self._base = model.body(base).id if base else 0
        moved = _moved_by(model, {int(model.joint(name).bodyid[0]) for name in arm})
        if not known:
            moved -= _moved_by(model, {int(model.joint(name).bodyid[0]) for name in fingers})
        self.parts = [part for body in sorted(moved) if (part := _part(model, body)) is not None]
        """Of the moving links."""
        if not self.parts:
            raise ConfigError(
                "The robot's joints move nothing that can be seen: no mesh, no shape."
            )

    @property
    def joints(self) -> int:
        """Joints of the arm."""
        return len(self._arm)

    def poses(self, angles: np.ndarray, opening: np.ndarray | None = None) -> np.ndarray:
        """Poses of the parts in the base frame, float64 [T, parts, 4, 4].

        Args:
            angles: Of the joints (rad), [T, joints].
            opening: Of the gripper, from 0 closed to 1 open, [T]; half open when None.
        """
        model, data = self._model, self._data
        bodies = np.array([part.body for part in self.parts])
        result = np.empty((len(angles), len(bodies), 4, 4))
        share = np.full(len(angles), 0.5) if opening is None else np.clip(opening, 0, 1)
        far = np.where(
            abs(self._ranges[:, 0]) > abs(self._ranges[:, 1]),
            self._ranges[:, 0],
            self._ranges[:, 1],
        )
        for t, row in enumerate(angles):
            data.qpos[:] = model.qpos0
            data.qpos[self._arm] = row
            data.qpos[self._fingers] = share[t] * far
            mujoco.mj_kinematics(model, data)
            base = pose_of(data.xmat[self._base].reshape(3, 3), data.xpos[self._base])
            links = pose_of(data.xmat[bodies].reshape(-1, 3, 3), data.xpos[bodies])
            result[t] = np.linalg.inv(base) @ links
        return result


def load_arm(robot: str, *, fingers: bool = True) -> ArmModel:
    """The model of an arm.

    Args:
        robot: `panda`, or an MJCF or URDF file.
        fingers: Whether it is known how far they are open; else they are not looked at. Of a file,
            all joints that turn are the arm's, and all that slide are fingers.

    Raises:
        ConfigError: There is no such file, MuJoCo cannot read it, or a name is unknown.
    """
    if robot == PANDA:
        from jaxcam.sim import make_task
        from jaxcam.sim.mujoco.scene import Scene

        scene = make_task("lift").scene("fixed")
        assert isinstance(scene, Scene)
        arm = [f"robot0_joint{i}" for i in range(1, 8)]
        slides = [f"gripper0_right_finger_joint{i}" for i in (1, 2)]
        return ArmModel(scene.visual, "robot0_base", arm, slides, known=fingers)
    path = Path(robot).expanduser()
    if not path.is_file():
        raise ConfigError(
            f"--robot {robot}: no such file. Expected {PANDA}, or an MJCF (.xml) or URDF file."
        )
    try:
        model = _spec(path).compile()
    except (ValueError, OSError) as error:
        raise ConfigError(f"--robot {path}: MuJoCo cannot read it: {error}") from error
    kinds = {model.joint(i).name: int(model.joint(i).type[0]) for i in range(model.njnt)}
    hinges = [name for name, kind in kinds.items() if kind == mujoco.mjtJoint.mjJNT_HINGE]
    slides = [name for name, kind in kinds.items() if kind == mujoco.mjtJoint.mjJNT_SLIDE]
    if not hinges:
        raise ConfigError(f"--robot {path}: no joint that turns.")
    return ArmModel(model, "", hinges, slides, known=fingers)


def _spec(path: Path) -> mujoco.MjSpec:
    """A robot's file as it is, what is only seen included, which MuJoCo leaves out of a URDF."""
    if path.suffix.lower() != ".urdf":
        return mujoco.MjSpec.from_file(str(path))
    text = read_text(path)
    if "<mujoco" not in text:
        kept = '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco>'
        text = re.sub(r"(<robot\b[^>]*>)", lambda tag: tag[1] + kept, text, count=1)
    spec = mujoco.MjSpec.from_string(text)
    spec.modelfiledir = str(path.parent)
    return spec


def _moved_by(model: mujoco.MjModel, bodies: set[int]) -> set[int]:
    """Bodies that are moved with some: themselves and all that hangs on them."""
    moved = set()
    for body in range(1, model.nbody):
        up = body
        while up and up not in bodies:
            up = int(model.body_parentid[up])
        if up:
            moved.add(body)
    return moved


def _part(model: mujoco.MjModel, body: int) -> LinkSurface | None:
    """The surface of a body: of its visual shapes if there are such, else of all."""
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    visual = [g for g in geoms if not model.geom_contype[g] and not model.geom_conaffinity[g]]
    vertices, faces, first = [], [], 0
    for geom in visual or geoms:
        shape = _shape(model, geom)
        if shape is None:
            continue
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        vertices.append(shape[0] @ rotation.reshape(3, 3).T + model.geom_pos[geom])
        faces.append(shape[1] + first)
        first += len(shape[0])
    if not vertices:
        return None
    return _welded(body, np.concatenate(vertices), np.concatenate(faces))


def _welded(body: int, vertices: np.ndarray, faces: np.ndarray) -> LinkSurface:
    """A part without details finer than `GRID`, whose triangles share their vertices."""
    _, index = np.unique(np.round(vertices / GRID), axis=0, return_inverse=True)
    index = index.reshape(-1)
    count = np.bincount(index)
    middles = np.stack([np.bincount(index, column) / count for column in vertices.T], -1)
    faces = index[faces]
    faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]
    _, once = np.unique(np.sort(faces, 1), axis=0, return_index=True)
    return LinkSurface(body, middles, faces[once])


def _shape(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices and faces of a geom in its own axes; None where it has no surface of its own."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]]
        return vertices.astype(float), model.mesh_face[f : f + model.mesh_facenum[mesh]].astype(int)
    ends = np.array([[0, 0, -1.0], [0, 0, 1]])
    around = np.linspace(0, 2 * np.pi, _FINE, endpoint=False)
    ring = np.stack([np.cos(around), np.sin(around), 0 * around], -1)
    up = np.linspace(-np.pi / 2, np.pi / 2, _FINE // 2 + 1)[:, None, None]
    ball = (ring * np.cos(up) + [0, 0, 1] * np.sin(up)).reshape(-1, 3)
    if kind == kinds.mjGEOM_BOX:
        return _hull(size * np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3))
    if kind == kinds.mjGEOM_SPHERE:
        return _hull(size[0] * ball)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return _hull(size * ball)
    if kind == kinds.mjGEOM_CYLINDER:
        return _hull((size[0] * ring + size[1] * ends[:, None]).reshape(-1, 3))
    if kind == kinds.mjGEOM_CAPSULE:
        return _hull((size[0] * ball + size[1] * ends[:, None]).reshape(-1, 3))
    return None


def _hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The convex hull of points around zero [n, 3]: vertices and faces that look outwards."""
    faces = ConvexHull(points).simplices
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = (across * corners.mean(1)).sum(-1) < 0
    return points, np.where(inwards[:, None], faces[:, ::-1], faces)
