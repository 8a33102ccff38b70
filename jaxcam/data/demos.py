"""Demonstrations on disk: robomimic-shaped HDF5 of states, commands and camera schedules.

A file holds no pictures; they are rendered from its states (`jaxcam.data.pictures`). Layout::

    data                    attrs: total, env_args (JSON), jaxcam (JSON: task, scene, n, m, ...)
    data/demo_<i>           attrs: num_samples, seed, cameras (rows of cameras/*)
      states  [T + 1, 1 + nq + nv]   time, qpos, qvel before each action, and after the last one
      actions [T, 7]                 commanded grip pose (m, rotation vector; world), gripper sign
      errors  [T]                    whether a command errs on purpose; only where some do
      obs/robot0_eef_pos  [T + 1, 3] measured grip site (m, world)
      obs/robot0_eef_quat [T + 1, 4] the same, xyzw as robomimic has it
      obs/robot0_gripper  [T + 1]    the gripper's command in [-1 open, 1 closed]
      start/{geom_size, fixtures}    what else fixes the episode (`jaxcam.sim.types.Start`)
    cameras/world_from_camera [N, 4, 4]   OpenCV axes
    cameras/fovy_deg                      vertical field of view of all cameras
    cameras/K [N, 3, 3], distortion [N, 9]  instead, if cameras differ, see `jaxcam.data.header`
    mask/{train, valid}                   names of the demonstrations

Datasets carry Fletcher-32 checksums, and a complete file hashes of its content
(`jaxcam.data.contents`).
"""

import contextlib
import hashlib
import json
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxcam.data.contents import (
    ARRAYS,
    OLD_SEAL,
    OPTIONAL,
    SEAL,
    check_about,
    check_arrays,
    check_starts,
    seal_of_all,
)
from jaxcam.data.hdf5 import Format, format_of, open_hdf5, reading
from jaxcam.data.header import FORMAT, Header, read_camera_arrays
from jaxcam.errors import DatasetError
from jaxcam.rays import ROTATION_TOLERANCE
from jaxcam.rays.rotations import (
    matrix_from_quaternion,
    nearest_rotation,
    quaternion_from_matrix,
)
from jaxcam.sim import make_task
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start
from jaxcam.sim.world import World

ROUNDED = 1e-6
"""Largest entry of |RᵀR - I| of a camera's rotation that is left as it is."""
REMEDY = "Delete it and collect again, or copy it anew."
"""What to do with a file that is damaged."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Demo:
    """One demonstration of T control steps; its arrays are those of the file (see above)."""

    seed: int
    nq: int
    """Joint positions in a row of `states`."""
    states: np.ndarray = field(repr=False)
    actions: np.ndarray = field(repr=False)
    eef_pos: np.ndarray = field(repr=False)
    eef_quat: np.ndarray = field(repr=False)
    gripper: np.ndarray = field(repr=False)
    geom_size: np.ndarray = field(repr=False)
    fixtures: np.ndarray = field(repr=False)
    cameras: np.ndarray
    """Rows of the file's cameras that see this demonstration [n]."""
    errors: np.ndarray | None = field(default=None, repr=False)
    """Whether each command errs on purpose (`Aim.error`), bool [T]; None where none does."""

    @property
    def length(self) -> int:
        """Control steps."""
        return len(self.actions)

    @property
    def qpos(self) -> np.ndarray:
        """Joint positions before each action, and after the last one [T + 1, nq]."""
        return self.states[:, 1 : 1 + self.nq]

    @property
    def qvel(self) -> np.ndarray:
        """Joint velocities at the same times [T + 1, nv]."""
        return self.states[:, 1 + self.nq :]

    def arrays(self) -> dict[str, np.ndarray]:
        """Its arrays by their names in a file."""
        arrays = {name: getattr(self, of) for name, of in ARRAYS.items()}
        return {name: array for name, array in arrays.items() if array is not None}

    def start(self) -> Start:
        """What fixes the episode before its first step."""
        return Start(self.qpos[0], self.geom_size, self.fixtures)

    def world_from_grip(self) -> np.ndarray:
        """Measured poses of the grip site before each action, and after the last [T + 1, 4, 4]."""
        poses = np.tile(np.eye(4), (len(self.eef_pos), 1, 1))
        poses[:, :3, :3] = matrix_from_quaternion(np.roll(self.eef_quat, 1, -1))
        poses[:, :3, 3] = self.eef_pos
        return poses

    @classmethod
    def record(
        cls,
        start: Start,
        *,
        seed: int,
        qpos: np.ndarray,
        qvel: np.ndarray,
        actions: np.ndarray,
        grip_position: np.ndarray,
        grip_rotation: np.ndarray,
        gripper: np.ndarray,
    ) -> "Demo":
        """A demonstration as it is made, without cameras.

        Args:
            start: What else fixes the episode than `qpos`.
            seed: Of the episode.
            qpos: Joint positions before each action, and after the last one [T + 1, nq].
            qvel: Joint velocities at the same times [T + 1, nv].
            actions: Commanded grip poses (m, rotation vector; world) and gripper signs [T, 7].
            grip_position: Measured grip site (m, world) [T + 1, 3].
            grip_rotation: Its axes in the world, [T + 1, 3, 3].
            gripper: The gripper's command, -1 open to 1 closed, [T + 1].
        """
        time = np.arange(len(qpos))[:, None] / CONTROL_HZ
        return cls(
            seed=seed,
            nq=qpos.shape[1],
            states=np.concatenate([time, qpos, qvel], 1),
            actions=actions,
            eef_pos=grip_position,
            eef_quat=np.roll(quaternion_from_matrix(grip_rotation), -1, -1),
            gripper=gripper,
            geom_size=start.geom_size,
            fixtures=start.fixtures,
            cameras=np.empty(0, int),
        )


def starts_of(demos: Sequence[Demo]) -> Start:
    """The starts of several demonstrations of one world, stacked."""
    return Start(*(np.stack(x) for x in zip(*(demo.start() for demo in demos), strict=True)))


@dataclass(frozen=True)
class Demos:
    """A complete file, in memory: a few megabytes."""

    path: Path
    header: Header
    train: list[Demo] = field(repr=False)
    valid: list[Demo] = field(repr=False)
    fingerprint: str
    """Hash of all states, commands and cameras."""

    @property
    def episodes(self) -> list[Demo]:
        """All demonstrations in the file's order: those for training, then for validation."""
        return self.train + self.valid

    @property
    def task(self) -> Task:
        """The task that is demonstrated."""
        return make_task(self.header.task)

    @property
    def world(self) -> World:
        """The task's world in which it is."""
        return self.task.scene(self.header.scene)


def read_demos(path: Path, *, task: str | None = None, scene: str | None = None) -> Demos:
    """Reads a complete file.

    Args:
        path: Of the HDF5 file.
        task: Expected task; any when None.
        scene: Expected scene; any when None.

    Raises:
        DatasetError: If it is missing, damaged, of another task or scene, or lacks cameras.
    """
    with _open(path) as file:
        header = _read_header(path, file)
        for name, wanted, stored in (("task", task, header.task), ("scene", scene, header.scene)):
            if wanted is not None and wanted != stored:
                raise DatasetError(
                    f"{path}: dataset of {name} {stored!r}, but {wanted!r} was asked. Point "
                    "--data-dir elsewhere or collect that one: python -m jaxcam.collect "
                    f"--task {task or header.task} --scene {scene or header.scene}"
                )
        demos = [_read_demo(path, file, i, header) for i in range(header.train + header.valid)]
        check_starts(path, header.task, header.scene, demos)
        seals = {name: file["data"].attrs.get(name) for name in (OLD_SEAL, SEAL)}
        sealed = seal_of_all(file, [demo.arrays() for demo in demos])
    train, valid = demos[: header.train], demos[header.train :]
    demos_read = Demos(path, header, train, valid, fingerprint_of(header, demos))
    for name, expected in ((OLD_SEAL, seal_of(demos_read)), (SEAL, sealed)):
        if seals[name] is not None and seals[name] != expected:
            raise DatasetError(
                f"{path}: damaged: its content is not what was written ({name}). {REMEDY}"
            )
    # After the hashes: a singular value decomposition has other last digits on other machines.
    return replace(demos_read, header=_orthonormal(path, header))


def _orthonormal(path: Path, header: Header) -> Header:
    """The header with rotations that were rounded made rotations again; worse ones are kept."""
    poses = header.world_from_camera
    rotation = poses[:, :3, :3].astype(np.float64)
    error = abs(rotation.swapaxes(-1, -2) @ rotation - np.eye(3)).max((-2, -1))
    rounded = (error > ROUNDED) & (error <= ROTATION_TOLERANCE) & (np.linalg.det(rotation) > 0)
    if not rounded.any():
        return header
    _log.warning(
        "%s: rotations of %d of %d cameras are rounded (|RᵀR - I| up to %.1g): the nearest "
        "rotations are used.", path, rounded.sum(), len(poses), error[rounded].max(),
    )  # fmt: skip
    poses = poses.astype(np.float64)
    poses[rounded, :3, :3] = nearest_rotation(rotation[rounded])
    return replace(header, world_from_camera=poses)


def fingerprint_of(header: Header, demos: Sequence[Demo]) -> str:
    """Hash of states, commands, errors, starts and cameras: the name of what is made from them."""
    digest = hashlib.sha256()
    for array in header.arrays.values():
        digest.update(np.ascontiguousarray(array).tobytes())
    for demo in demos:
        arrays = (demo.states, demo.actions, demo.geom_size, demo.fixtures, demo.cameras)
        errors = [] if demo.errors is None or not demo.errors.any() else [demo.errors]
        for array in (*arrays, *errors):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def seal_of(demos: Demos) -> str:
    """The seal of version 0.1.0, which leaves `obs` and some attributes out (`OLD_SEAL`)."""
    seeds = [d.seed for d in demos.episodes]
    content = [demos.fingerprint, demos.header.identity(), seeds]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def read_unfinished(path: Path) -> tuple[Header, dict[int, Demo]]:
    """What version 0.1.0 left of a collection: the header, and the episodes that are whole.

    Raises:
        DatasetError: The file cannot be opened, or has no header.
    """
    demos = {}
    with _open(path) as file:
        header = _read_header(path, file)
        for i in range(header.train + header.valid):
            # Another kind of error would say that the whole file is damaged.
            with contextlib.suppress(DatasetError, OSError, RuntimeError, LookupError, ValueError):
                if "num_samples" in file[f"data/demo_{i}"].attrs:
                    demos[i] = _read_demo(path, file, i, header)
    return header, demos


def faults_of(path: Path) -> list[DatasetError]:
    """All that is wrong with the demonstrations of a file, one error for each that has one.

    Raises:
        DatasetError: If not even its header can be read.
    """
    faults = []
    with _open(path) as file:
        header = _read_header(path, file)
        for i in range(header.train + header.valid):
            try:
                _read_demo(path, file, i, header)
            except DatasetError as error:
                faults.append(error)
    return faults


@contextlib.contextmanager
def _open(path: Path) -> Iterator[h5py.File]:
    missing = "no such dataset. Make it with: python -m jaxcam.collect"
    with open_hdf5(path, missing=missing, remedy=REMEDY) as file, reading(path, REMEDY):
        yield file


def _read_header(path: Path, file: h5py.File) -> Header:
    try:
        about = json.loads(str(file["data"].attrs["jaxcam"]))
        version = about["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: no jaxcam header; found {sorted(file)}. {_whose(path, file)}"
        ) from error
    if version != FORMAT:
        raise DatasetError(f"{path}: format {version}, but this jaxcam reads {FORMAT}.")
    if "cameras/world_from_camera" not in file:
        raise DatasetError(f"{path}: no cameras (dataset 'cameras/world_from_camera' is missing).")
    poses = _array(str(path), file, "cameras/world_from_camera")
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or poses.dtype.kind != "f":
        kind = f"{poses.dtype} " if poses.dtype.kind != "f" else ""
        raise DatasetError(
            f"{path}: cameras/world_from_camera is {kind}{list(poses.shape)}, expected "
            "floating-point numbers [cameras, 4, 4]."
        )
    check_about(path, about)
    try:
        group: Any = file["cameras"]
        arrays = read_camera_arrays(path, group, len(poses), about.get("optics", {}))
        return Header(world_from_camera=poses, **arrays, **about)
    except TypeError as error:
        raise DatasetError(f"{path}: incomplete jaxcam header ({error}).") from error


def _array(where: str, group: h5py.Group, name: str) -> np.ndarray:
    """The whole array of that name."""
    item: Any = group[name]
    if not isinstance(item, h5py.Dataset):
        raise DatasetError(f"{where}: {name} is a group, expected an array.")
    return np.asarray(item[()])


def _whose(path: Path, file: h5py.File) -> str:
    """Whose layout a file has that is not ours, and what to do with it."""
    hints: dict[Format, str] = {
        "maniskill": f"It looks like ManiSkill's: python -m jaxcam.maniskill {path}",
        "robomimic": f"It looks like robomimic's: python -m jaxcam.robomimic {path}",
        "robosuite": "It looks like robosuite's own recording: turn it into robomimic's layout "
        "with robomimic's convert_robosuite.py, then: python -m jaxcam.robomimic FILE",
    }
    return hints.get(format_of(file), "Expected the layout in docs/data.md.")


def _read_demo(path: Path, file: h5py.File, index: int, header: Header) -> Demo:
    name = f"data/demo_{index}"
    if name not in file:
        raise DatasetError(f"{path}: {name} is missing.")
    group: Any = file[name]
    where = f"{path}: {name}"
    try:
        seed, cameras = (np.asarray(group.attrs[key]) for key in ("seed", "cameras"))
        arrays = {
            of: _array(where, group, key)
            for key, of in ARRAYS.items()
            if key in group or key not in OPTIONAL
        }
    except KeyError as error:
        raise DatasetError(f"{where}: {error}.") from error
    except OSError as error:
        raise DatasetError(
            f"{where}: checksum or read error ({error}). Copy the file anew, or leave the "
            "demonstration out."
        ) from error
    if seed.dtype.kind not in "iu" or seed.size != 1:
        raise DatasetError(f"{where}: seed is {seed.tolist()!r:.80}, expected a whole number.")
    count = len(header.world_from_camera)
    if cameras.size and (cameras.dtype.kind not in "iu" or cameras.ndim != 1):
        raise DatasetError(
            f"{where}: cameras are {cameras.dtype} {list(cameras.shape)}, expected whole numbers."
        )
    if cameras.size == 0 or cameras.min() < 0 or cameras.max() >= count:
        raise DatasetError(
            f"{where}: cameras {cameras.tolist()} are missing; the file has {count}."
        )
    check_arrays(where, arrays, nq=header.nq, nv=header.nv)
    return Demo(seed=int(seed.item()), nq=header.nq, cameras=cameras.astype(int), **arrays)
