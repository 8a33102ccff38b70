"""Demonstrations on disk: robomimic-shaped HDF5 of states, commands and camera schedules.

A file holds no pictures; they are rendered from its states (`jaxcam.frames`). Layout::

    data                    attrs: total, env_args (JSON), jaxcam (JSON: task, scene, n, m, ...)
    data/demo_<i>           attrs: num_samples, seed, cameras (rows of cameras/*)
      states  [T + 1, 1 + nq + nv]   time, qpos, qvel before each action, and after the last one
      actions [T, 7]                 commanded grip pose (m, rotation vector; world), gripper sign
      obs/robot0_eef_pos  [T + 1, 3] measured grip site (m, world)
      obs/robot0_eef_quat [T + 1, 4] the same, xyzw as robomimic has it
      obs/robot0_gripper  [T + 1]    the gripper's command in [-1 open, 1 closed]
      start/{geom_size, fixtures}    what else fixes the episode (`jaxcam.sim.engine.Start`)
    cameras/world_from_camera [N, 4, 4]   OpenCV axes
    cameras/fovy_deg                      vertical field of view
    mask/{train, valid}                   names of the demonstrations

Datasets carry Fletcher-32 checksums. A file is written as `<name>.part`, flushed per
demonstration, and renamed when it is complete, so a killed collector loses one episode at most.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxcam.errors import DatasetError

FORMAT = 1
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Demo:
    """One demonstration of T control steps."""

    seed: int
    states: np.ndarray = field(repr=False)
    actions: np.ndarray = field(repr=False)
    eef_pos: np.ndarray = field(repr=False)
    eef_quat: np.ndarray = field(repr=False)
    gripper: np.ndarray = field(repr=False)
    geom_size: np.ndarray = field(repr=False)
    fixtures: np.ndarray = field(repr=False)
    cameras: np.ndarray
    """Rows of the file's cameras that see this demonstration [n]."""

    @property
    def length(self) -> int:
        """Control steps."""
        return len(self.actions)

    def qpos(self, nq: int) -> np.ndarray:
        """Joint positions [T + 1, nq]."""
        return self.states[:, 1 : 1 + nq]


@dataclass(frozen=True)
class Header:
    """What a file says of itself."""

    task: str
    scene: str
    n: int
    m: int
    seed: int
    train: int
    """Training demonstrations that the complete file has."""
    valid: int
    """Validation demonstrations that the complete file has."""
    fovy_deg: float
    nq: int
    nv: int
    world_from_camera: np.ndarray = field(repr=False)
    """All cameras [N, 4, 4]: the schedule's, then one held-out camera per validation demo."""
    versions: dict[str, str] = field(default_factory=dict)
    format: int = FORMAT

    def identity(self) -> dict[str, Any]:
        """What two files must share to be parts of one dataset."""
        keys = (
            "task",
            "scene",
            "n",
            "m",
            "seed",
            "train",
            "valid",
            "fovy_deg",
            "nq",
            "nv",
            "format",
        )
        return {k: getattr(self, k) for k in keys}


@dataclass(frozen=True)
class Demos:
    """A complete file, in memory: a few megabytes."""

    path: Path
    header: Header
    train: list[Demo] = field(repr=False)
    valid: list[Demo] = field(repr=False)
    fingerprint: str
    """Hash of all states, commands and cameras."""


class DemoWriter:
    """Appends demonstrations to `<path>.part` and turns it into `path` when all are there."""

    def __init__(self, path: Path, header: Header) -> None:
        self.path, self.part = path, path.with_name(path.name + ".part")
        self.header = header
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if self.part.exists():
                self._resume()
            else:
                self._create()
        except OSError as error:
            raise DatasetError(
                f"Cannot write to {path.parent}: {error.strerror or error}. Choose another "
                "--data-dir, or make room or get permission."
            ) from error

    def __enter__(self) -> "DemoWriter":
        return self

    def __exit__(self, *exc: object) -> None:
        self._file.close()

    @property
    def done(self) -> set[int]:
        """Indices of the demonstrations that are on disk."""
        data: Any = self._file["data"]
        return {int(name.removeprefix("demo_")) for name in data}

    def append(self, index: int, demo: Demo) -> None:
        """Writes one demonstration and flushes: it survives whatever happens next."""
        data: Any = self._file["data"]
        group = data.create_group(f"demo_{index}")
        arrays = {
            "states": demo.states,
            "actions": demo.actions,
            "obs/robot0_eef_pos": demo.eef_pos,
            "obs/robot0_eef_quat": demo.eef_quat,
            "obs/robot0_gripper": demo.gripper,
            "start/geom_size": demo.geom_size,
            "start/fixtures": demo.fixtures,
        }
        for name, array in arrays.items():
            group.create_dataset(name, data=array, fletcher32=True)
        group.attrs.update(num_samples=demo.length, seed=demo.seed, cameras=demo.cameras)
        data.attrs["total"] = int(data.attrs["total"]) + demo.length
        self._file.flush()

    def finish(self) -> Path:
        """Reads the file back, seals it with a hash of its content and gives it its name."""
        missing = set(range(self.header.train + self.header.valid)) - self.done
        if missing:
            raise DatasetError(f"{self.part}: demonstrations {sorted(missing)[:5]}... are missing.")
        self._file.close()
        seal = _seal(read_demos(self.part))
        with h5py.File(self.part, "r+") as file:
            file["data"].attrs["sha256"] = seal
        os.replace(self.part, self.path)
        return self.path

    def _create(self) -> None:
        header = self.header
        self._file = h5py.File(self.part, "w")
        data = self._file.create_group("data")
        env = {"env_name": header.task, "type": 1, "env_kwargs": {"scene": header.scene}}
        about = {**header.identity(), "versions": header.versions}
        data.attrs.update(total=0, env_args=json.dumps(env), jaxcam=json.dumps(about))
        cameras = self._file.create_group("cameras")
        cameras.create_dataset("world_from_camera", data=header.world_from_camera, fletcher32=True)
        cameras.attrs["fovy_deg"] = header.fovy_deg
        names = [f"demo_{i}" for i in range(header.train + header.valid)]
        mask = self._file.create_group("mask")
        mask.create_dataset("train", data=names[: header.train], dtype=h5py.string_dtype())
        mask.create_dataset("valid", data=names[header.train :], dtype=h5py.string_dtype())
        self._file.flush()

    def _resume(self) -> None:
        try:
            self._file = h5py.File(self.part, "r+")
            found = json.loads(str(self._file["data"].attrs["jaxcam"]))
        except BlockingIOError as error:
            raise DatasetError(
                f"{self.part}: in use by another process. Wait for it to finish collecting."
            ) from error
        except (OSError, KeyError) as error:
            raise DatasetError(
                f"{self.part}: an unfinished file that cannot be opened ({error}). "
                "Delete it and collect again."
            ) from error
        wrong = _differences(found, self.header.identity())
        if wrong:
            self._file.close()
            raise DatasetError(
                f"{self.part}: an unfinished file of other settings ({wrong}). Finish it with its "
                "own settings, or delete it."
            )
        data: Any = self._file["data"]
        for name in list(data):
            if "num_samples" not in data[name].attrs:
                del data[name]


def _differences(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    return ", ".join(
        f"{k}: file {found.get(k)}, asked {v}" for k, v in wanted.items() if found.get(k) != v
    )


def read_demos(path: Path, *, task: str | None = None, scene: str | None = None) -> Demos:
    """Reads a complete file.

    Args:
        path: of the HDF5 file.
        task: expected task; any when None.
        scene: expected scene; any when None.

    Raises:
        DatasetError: if it is missing, damaged, of another task or scene, or lacks cameras.
    """
    with _open(path) as file:
        header = _read_header(path, file)
        for name, wanted, found in (("task", task, header.task), ("scene", scene, header.scene)):
            if wanted is not None and wanted != found:
                raise DatasetError(
                    f"{path}: dataset of {name} {found!r}, but {wanted!r} was asked. Point "
                    "--data-dir elsewhere or collect that one: python -m jaxcam.collect "
                    f"--task {task or header.task} --scene {scene or header.scene}"
                )
        digest = hashlib.sha256(np.ascontiguousarray(header.world_from_camera).tobytes())
        demos = [_read_demo(path, file, i, header) for i in range(header.train + header.valid)]
        seal = file["data"].attrs.get("sha256")
    for demo in demos:
        for array in (demo.states, demo.actions, demo.geom_size, demo.fixtures, demo.cameras):
            digest.update(np.ascontiguousarray(array).tobytes())
    found = Demos(
        path, header, demos[: header.train], demos[header.train :], digest.hexdigest()[:16]
    )
    if seal is not None and seal != _seal(found):
        raise DatasetError(
            f"{path}: damaged: its content is not what was written. Delete it and collect again, "
            "or copy it anew."
        )
    return found


def _seal(demos: Demos) -> str:
    """Hash of all that is read of a file; checksums see arrays, but attributes have none."""
    seeds = [d.seed for d in demos.train + demos.valid]
    content = [demos.fingerprint, demos.header.identity(), seeds]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


@contextlib.contextmanager
def _open(path: Path) -> Iterator[h5py.File]:
    if not path.exists():
        raise DatasetError(f"{path}: no such dataset. Make it with: python -m jaxcam.collect")
    try:
        with h5py.File(path, "r") as file:
            yield file
    except DatasetError:
        raise
    except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
        # HDF5's library reports damage in all of these ways.
        head = path.read_bytes()[:8]
        if head != _HDF5_SIGNATURE:
            raise DatasetError(f"{path}: not an HDF5 file; it starts with {head!r}.") from error
        raise DatasetError(
            f"{path}: damaged or truncated ({path.stat().st_size} bytes; {error}). Delete it and "
            "collect again, or copy it anew."
        ) from error


def _read_header(path: Path, file: h5py.File) -> Header:
    try:
        about = json.loads(str(file["data"].attrs["jaxcam"]))
        found = about["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path}: no jaxcam header; found {sorted(file)}. Expected the layout in "
            "jaxcam/demos.py."
        ) from error
    if found != FORMAT:
        raise DatasetError(f"{path}: format {found}, but this jaxcam reads {FORMAT}.")
    if "cameras/world_from_camera" not in file:
        raise DatasetError(f"{path}: no cameras (dataset 'cameras/world_from_camera' is missing).")
    poses: Any = file["cameras/world_from_camera"]
    try:
        return Header(world_from_camera=poses[:], **about)
    except TypeError as error:
        raise DatasetError(f"{path}: incomplete jaxcam header ({error}).") from error


def _read_demo(path: Path, file: h5py.File, index: int, header: Header) -> Demo:
    name = f"data/demo_{index}"
    if name not in file:
        raise DatasetError(f"{path}: {name} is missing.")
    group: Any = file[name]
    try:
        demo = Demo(
            seed=int(group.attrs["seed"]),
            states=group["states"][:],
            actions=group["actions"][:],
            eef_pos=group["obs/robot0_eef_pos"][:],
            eef_quat=group["obs/robot0_eef_quat"][:],
            gripper=group["obs/robot0_gripper"][:],
            geom_size=group["start/geom_size"][:],
            fixtures=group["start/fixtures"][:],
            cameras=np.asarray(group.attrs["cameras"], int),
        )
    except KeyError as error:
        raise DatasetError(f"{path}: {name}: {error}.") from error
    except OSError as error:
        raise DatasetError(f"{path}: {name}: checksum or read error ({error}).") from error
    cameras = len(header.world_from_camera)
    if demo.cameras.size == 0 or demo.cameras.min() < 0 or demo.cameras.max() >= cameras:
        raise DatasetError(
            f"{path}: {name}: cameras {demo.cameras.tolist()} are missing; the file has {cameras}."
        )
    if not (np.isfinite(demo.states).all() and np.isfinite(demo.actions).all()):
        raise DatasetError(f"{path}: {name}: non-finite states or actions.")
    if demo.length == 0 or len(demo.states) != demo.length + 1:
        raise DatasetError(
            f"{path}: {name}: {demo.length} actions need {demo.length + 1} states, got "
            f"{len(demo.states)}."
        )
    return demo
