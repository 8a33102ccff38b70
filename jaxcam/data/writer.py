"""Writing demonstration files, so that a killed collector loses one episode at most.

A file is written as `<name>.part`, flushed per demonstration, and renamed when it is complete.
"""

import json
import os
from pathlib import Path
from typing import Any

import h5py

from jaxcam.data.demos import Demo, Header, read_demos, seal_of
from jaxcam.errors import DatasetError


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
        seal = seal_of(read_demos(self.part))
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
            stored = json.loads(str(self._file["data"].attrs["jaxcam"]))
        except BlockingIOError as error:
            raise DatasetError(
                f"{self.part}: in use by another process. Wait for it to finish collecting."
            ) from error
        except (OSError, KeyError) as error:
            raise DatasetError(
                f"{self.part}: an unfinished file that cannot be opened ({error}). "
                "Delete it and collect again."
            ) from error
        wrong = _differences(stored, self.header.identity())
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


def _differences(stored: dict[str, Any], wanted: dict[str, Any]) -> str:
    return ", ".join(
        f"{k}: file {stored.get(k)}, asked {v}" for k, v in wanted.items() if stored.get(k) != v
    )
