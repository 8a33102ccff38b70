"""What a demonstration file holds: names of its arrays, what is possible in them, and their seal.

The file's own checksums notice damage on the disk; the seal, that somebody changed what is read. A
file without a seal (another's, or one that was edited on purpose) is read as long as its numbers
can be those of an episode.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.sim import make_task
from jaxcam.sim.world import scene_name

ARRAYS: Mapping[str, str] = {
    "states": "states",
    "actions": "actions",
    "obs/robot0_eef_pos": "eef_pos",
    "obs/robot0_eef_quat": "eef_quat",
    "obs/robot0_gripper": "gripper",
    "start/geom_size": "geom_size",
    "start/fixtures": "fixtures",
    "errors": "errors",
}
"""Paths of a demonstration's arrays in its group, and their fields of `Demo`."""
OPTIONAL = frozenset({"errors"})
"""Those, of either name, that not all demonstrations have: only some err on purpose."""
SEAL = "sha256_of_all"
"""Attribute of `data` with the hash of everything that is read (`seal_of_all`)."""
OLD_SEAL = "sha256"
"""Attribute of `data` with the hash of states, commands, starts, cameras, seeds and settings, which
is all that version 0.1.0 sealed; of errors, too, where there are."""
FAR = 1e4
"""Size beyond which no number (m, rad, s, and their rates) is an episode's."""
UNIT = 1e-3
"""How far the length of a quaternion may be from one."""
JOINTS = 9
"""Joint positions of arm and fingers; the poses (xyz, wxyz) of the objects follow them."""

MOST = 10**6
"""Demonstrations, cameras and numbers of a state that a header may speak of."""

_COUNTS = ("n", "m", "train", "valid", "nq", "nv")
_TEXTS = ("task", "scene")
_ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "data": ("total", "env_args", "jaxcam"),
    "cameras": ("fovy_deg",),
}
_DATASETS = ("cameras/world_from_camera", "mask/train", "mask/valid")
_WHERE_THERE = ("cameras/K", "cameras/distortion")
"""Datasets that only files have whose cameras differ in these."""
_OF_DEMOS = ("num_samples", "seed", "cameras")


class HasStart(Protocol):
    """What has sizes and fixtures: a demonstration."""

    @property
    def geom_size(self) -> np.ndarray:
        """Sizes (m) of the task's varied geoms [v, 3]."""
        ...

    @property
    def fixtures(self) -> np.ndarray:
        """Poses of what is seen and never touched [2 + markers, 7]."""
        ...


def seal_of_all(file: h5py.File, arrays: list[Mapping[str, np.ndarray]]) -> str:
    """Hash of every array and attribute of a file that anything reads.

    Args:
        file: Open for reading; its attributes, cameras and masks are read.
        arrays: Of each demonstration by their names (keys of `ARRAYS`), as the file has them.
    """
    digest = hashlib.sha256()
    for group, names in _ATTRIBUTES.items():
        _add_attributes(digest, file, group, names)
    for name in _DATASETS:
        item: Any = file.get(name)
        _add(digest, name, None if item is None else item[()])
    for name in (name for name in _WHERE_THERE if name in file):
        item = file[name]
        _add(digest, name, item[()])
    for i, demo in enumerate(arrays):
        _add_attributes(digest, file, f"data/demo_{i}", _OF_DEMOS)
        for name, array in demo.items():
            _add(digest, f"demo_{i}/{name}", array)
    return digest.hexdigest()


def _add_attributes(digest: Any, file: h5py.File, group: str, names: tuple[str, ...]) -> None:
    attributes: Any = file[group].attrs if group in file else {}
    for name in names:
        _add(digest, f"{group}:{name}", attributes.get(name))


def _add(digest: Any, name: str, value: Any) -> None:
    """Adds a named value; numbers with their type and shape, texts as they are."""
    array = np.asarray(value)
    if array.dtype.kind in "OSUT":
        text = [x.decode() if isinstance(x, bytes) else str(x) for x in array.ravel()]
        kind, content = "text", json.dumps(text).encode()
    else:
        kind, content = array.dtype.newbyteorder("<").str, _little_endian(array).tobytes()
    digest.update(json.dumps([name, kind, list(array.shape), len(content)]).encode())
    digest.update(content)


def _little_endian(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, array.dtype.newbyteorder("<"))


def check_about(path: Path, about: Mapping[str, Any]) -> None:
    """Refuses settings of a file's header that are of another kind, or cannot be.

    Args:
        path: Of the file, for messages.
        about: The header's JSON.

    Raises:
        DatasetError: Naming the first setting that is wrong.
    """
    for name, value in about.items():
        if name in _COUNTS:
            possible = type(value) is int and 0 <= value <= MOST
            wanted = f"a whole number up to {MOST}"
        elif name in _TEXTS:
            possible, wanted = isinstance(value, str), "text"
        elif name == "seed":
            possible, wanted = type(value) is int, "a whole number"
        elif name == "fovy_deg":
            possible, wanted = type(value) in (int, float), "a number"
        elif name in ("versions", "optics"):
            texts = value.values() if isinstance(value, dict) else [None]
            possible, wanted = all(isinstance(x, str) for x in texts), f"names with {name}"
        else:
            continue
        if not possible:
            raise DatasetError(f"{path}: header: {name} is {value!r:.80}, expected {wanted}.")
    if not about.get("train", 1) + about.get("valid", 0):
        raise DatasetError(f"{path}: header: no demonstrations (train and valid are 0).")


def check_arrays(where: str, arrays: Mapping[str, np.ndarray], *, nq: int, nv: int) -> None:
    """Refuses a demonstration without steps, of other shapes, or with numbers that cannot be.

    Args:
        where: File and demonstration, for messages.
        arrays: Its arrays by their fields of `Demo`.
        nq: Joint positions of a state.
        nv: Joint velocities of a state.

    Raises:
        DatasetError: Naming the array, and where it can the step.
    """
    steps = len(arrays["actions"]) if arrays["actions"].ndim else 0
    states = len(arrays["states"]) if arrays["states"].ndim else 0
    if steps == 0 or states != steps + 1:
        raise DatasetError(f"{where}: {steps} actions need {steps + 1} states, got {states}.")
    rows = steps + 1
    shapes: dict[str, tuple[int | None, ...]] = {
        "states": (rows, 1 + nq + nv),
        "actions": (steps, 7),
        "eef_pos": (rows, 3),
        "eef_quat": (rows, 4),
        "gripper": (rows,),
        "geom_size": (None, 3),
        "fixtures": (None, 7),
        "errors": (steps,),
    }
    for name, array in arrays.items():
        shape = shapes[name]
        if len(array.shape) != len(shape) or any(
            wanted not in (None, got) for wanted, got in zip(shape, array.shape, strict=True)
        ):
            asked = str(["any" if x is None else x for x in shape]).replace("'", "")
            raise DatasetError(f"{where}: {name} is {list(array.shape)}, expected {asked}.")
        if name == "errors":
            _check_errors(where, array)
        else:
            _check_numbers(where, name, array)
    _check_possible(where, arrays, nq, nv)


def check_starts(path: Path, task: str, scene: str, starts: Iterable[HasStart]) -> None:
    """Refuses a file of no known task or scene, and starts that are of another task.

    Args:
        path: Of the file, for messages.
        task: Name of the task.
        scene: Name of the scene.
        starts: Demonstrations in the file's order.

    Raises:
        DatasetError: Naming the demonstration.
    """
    try:
        scene_name(scene)
        known = make_task(task)
    except ConfigError as error:
        raise DatasetError(f"{path}: header: {error}") from error
    counts = {"geom_size": len(known.varied), "fixtures": 2 + len(known.markers)}
    for i, start in enumerate(starts):
        for name, got in (("geom_size", start.geom_size), ("fixtures", start.fixtures)):
            if len(got) != counts[name]:
                raise DatasetError(
                    f"{path}: data/demo_{i}: {name} has {len(got)} rows, but in {task} it has "
                    f"{counts[name]}."
                )


def _check_errors(where: str, array: np.ndarray) -> None:
    if array.dtype.kind != "b":
        raise DatasetError(f"{where}: errors is {array.dtype}, expected true or false.")
    if array.all():
        raise DatasetError(
            f"{where}: all {array.size} steps are errors, so nothing is left to imitate. Leave "
            "the demonstration out."
        )


def _check_numbers(where: str, name: str, array: np.ndarray) -> None:
    if array.dtype.kind != "f":
        raise DatasetError(
            f"{where}: {name} is {array.dtype}, expected floating-point numbers. Record it again, "
            "or convert it from what it was rounded from."
        )
    _refuse(where, f"non-finite {name}", ~np.isfinite(array))
    _refuse(where, f"{name} beyond {FAR:g}", abs(array) > FAR)


def _check_possible(where: str, arrays: Mapping[str, np.ndarray], nq: int, nv: int) -> None:
    """Refuses sizes that are not positive, quaternions that are none, grippers out of range."""
    _refuse(where, "geom_size that is not positive", arrays["geom_size"] <= 0)
    _refuse(where, "gripper beyond -1 to 1", abs(arrays["gripper"]) > 1 + UNIT)
    quaternions = {"eef_quat": arrays["eef_quat"], "fixtures": arrays["fixtures"][:, 3:]}
    objects = nq - nv
    if objects > 0 and nq == JOINTS + 7 * objects:
        poses = arrays["states"][:, 1 + JOINTS : 1 + nq].reshape(-1, objects, 7)
        quaternions["states"] = poses[..., 3:]
    for name, quaternion in quaternions.items():
        length = np.linalg.norm(quaternion, axis=-1)
        _refuse(where, f"{name} whose quaternions have not length 1", abs(length - 1) > UNIT)


def _refuse(where: str, what: str, wrong: np.ndarray) -> None:
    bad = np.argwhere(wrong)
    if len(bad):
        raise DatasetError(
            f"{where}: {what}: {len(bad)} of {wrong.size} numbers, the first at step {bad[0, 0]}. "
            "Leave the demonstration out, or record it again."
        )
