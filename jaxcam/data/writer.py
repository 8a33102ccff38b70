"""Writing demonstration files, so that whatever ends the writer, finished episodes are kept.

What is collected grows in a folder, `<name>.part`: `header.npz`, and `demo_<i>.npz` for each
finished episode, each written whole under another name first. HDF5 comes last: the file is made in
memory, since its library loses files that it was killed over and crashes on full disks, and its
bytes are written, read back and given their name.
"""

import contextlib
import io
import json
import logging
import os
import re
import shutil
import zipfile
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
    seal_of_all,
)
from jaxcam.data.demos import (
    Demo,
    Demos,
    fingerprint_of,
    read_demos,
    read_unfinished,
    seal_of,
)
from jaxcam.data.header import Header
from jaxcam.errors import DatasetError
from jaxcam.files.locks import InUseError, NamedLock

HEADER, LOCK, WHOLE = "header.npz", "lock", "whole.hdf5"
"""Files in the folder of an unfinished dataset beside those of its episodes."""
_FILES = r"(?:header\.npz|demo_\d+\.npz|whole\.hdf5)"
_TORN = re.compile(rf"\.{_FILES}\.\d+")
_OURS = re.compile(rf"{_FILES}|{_TORN.pattern}|{LOCK}")
_UNREADABLE = (OSError, EOFError, KeyError, ValueError, TypeError, zipfile.BadZipFile)
"""What reading a damaged `.npz` raises."""

_log = logging.getLogger(__name__)


def unfinished(path: Path) -> Path:
    """The folder in which a dataset grows until it is complete."""
    return path.with_name(path.name + ".part")


def discard(path: Path) -> None:
    """Deletes what a writer left of a dataset that it did not finish; what others put there stays.

    Args:
        path: Of the dataset.

    Raises:
        DatasetError: A file in the place of an unfinished dataset is none, or another process
            writes it.
    """
    part = unfinished(path)
    for old in (_old(part), part):
        if old.is_file():
            _unfinished_of_0_1(old)
            old.unlink()
    if who := NamedLock(part / LOCK).held_by():
        raise DatasetError(f"{part}: in use by another process ({who}). Wait for it to finish.")
    if part.is_dir():
        for file in part.iterdir():
            if _OURS.fullmatch(file.name):
                file.unlink()
        if not any(part.iterdir()):
            part.rmdir()


class DemoWriter:
    """Keeps demonstrations in `<path>.part` and makes `path` of them when all are there.

    Args:
        path: Of the dataset. What an earlier writer kept of it is gone on with.
        header: What the dataset says of itself.

    Raises:
        DatasetError: Another process writes it, what is there is of other settings or cannot be
            read, or the folder cannot be written to.
    """

    def __init__(self, path: Path, header: Header) -> None:
        self.path, self.part, self.header = path, unfinished(path), header
        self._demos: dict[int, Demo] = {}
        self._lock = NamedLock(self.part / LOCK)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if self.part.is_file():  # as 0.1.0 left it
                self._require_same(_unfinished_of_0_1(self.part)[0])
                os.replace(self.part, _old(self.part))
            self.part.mkdir(exist_ok=True)
            self._lock.take()
            try:
                self._resume()
            except BaseException:
                self._lock.free()
                raise
        except InUseError as error:
            raise DatasetError(
                f"{self.part}: in use by another process ({error.holder}). Wait for it to finish "
                "collecting."
            ) from error
        except OSError as error:
            raise DatasetError(
                f"Cannot write to {path.parent}: {error.strerror or error}. Choose another "
                "--data-dir, or make room or get permission."
            ) from error

    def __enter__(self) -> "DemoWriter":
        return self

    def __exit__(self, *exc: object) -> None:
        self._lock.free()

    @property
    def done(self) -> set[int]:
        """Indices of the demonstrations that are on disk."""
        return set(self._demos)

    def append(self, index: int, demo: Demo) -> None:
        """Writes one demonstration: once this returns it survives whatever happens next.

        Raises:
            DatasetError: It has numbers that cannot be, or there is no room for it.
        """
        arrays: dict[str, Any] = {ARRAYS[name]: array for name, array in demo.arrays().items()}
        where = f"{self.path}: data/demo_{index}"
        check_arrays(where, arrays, nq=self.header.nq, nv=self.header.nv)
        content = io.BytesIO()
        np.savez(content, seed=demo.seed, cameras=demo.cameras, **arrays)
        self._write(self.part / f"demo_{index}.npz", content.getvalue())
        self._demos[index] = demo

    def finish(self) -> Path:
        """Makes the file of what was kept, seals it, reads it back and gives it its name.

        Raises:
            DatasetError: Demonstrations are missing, or there is no room.
        """
        total = self.header.train + self.header.valid
        missing = set(range(total)) - self.done
        if missing:
            raise DatasetError(f"{self.part}: demonstrations {sorted(missing)[:5]}... are missing.")
        whole = self.part / WHOLE
        self._write(whole, _file_of(self.header, [self._demos[i] for i in range(total)]))
        read_demos(whole)
        os.replace(whole, self.path)
        self._lock.free()
        with contextlib.suppress(OSError, DatasetError):  # the dataset is complete all the same
            discard(self.path)
        return self.path

    def _write(self, path: Path, content: bytes) -> None:
        """Writes a file of the folder, whole or not at all."""
        free = shutil.disk_usage(self.part).free
        new = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            if free < len(content):
                raise OSError(0, f"{len(content) / 1e6:.3g} MB are needed, {free / 1e6:.3g} free")
            with open(new, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(new, path)
        except OSError as error:
            new.unlink(missing_ok=True)
            raise DatasetError(
                f"{path}: cannot be written: {error.strerror or error}. What was collected is "
                "kept; make room and repeat."
            ) from error

    def _resume(self) -> None:
        """Takes over what is in the folder, or begins it."""
        for file in self.part.iterdir():
            if _TORN.fullmatch(file.name):
                file.unlink()
        old = _old(self.part)
        header, demos = _unfinished_of_0_1(old) if old.exists() else (self.header, {})
        if (self.part / HEADER).exists():
            header = _read_header(self.part / HEADER)
        self._require_same(header)
        self.header = header
        if not (self.part / HEADER).exists():
            about = json.dumps({**header.identity(), "versions": header.versions})
            content = io.BytesIO()
            arrays: dict[str, Any] = {"about": about, **header.arrays}
            np.savez(content, **arrays)
            self._write(self.part / HEADER, content.getvalue())
        for file in self.part.glob("demo_*.npz"):
            if name := re.fullmatch(r"demo_(\d+)", file.stem, re.ASCII):
                try:
                    self._demos[int(name[1])] = _read_episode(file, header)
                except (*_UNREADABLE, DatasetError) as error:
                    _log.warning("%s: damaged (%s); it is collected again.", file, error)
        for index, demo in demos.items():
            self.append(index, demo)
        old.unlink(missing_ok=True)

    def _require_same(self, stored: Header) -> None:
        kept, wanted = stored.identity(), self.header.identity()
        wrong = [f"{k}: file {kept[k]}, asked {v}" for k, v in wanted.items() if kept[k] != v]
        if wrong:
            raise DatasetError(
                f"{self.part}: an unfinished dataset of other settings ({', '.join(wrong)}). "
                "Finish it with its own settings, or delete it."
            )


def _old(part: Path) -> Path:
    """Where an unfinished file of version 0.1.0 waits until its episodes are taken over."""
    return part.with_name(part.name + ".old")


def _unfinished_of_0_1(path: Path) -> tuple[Header, dict[int, Demo]]:
    try:
        return read_unfinished(path)
    except DatasetError as error:
        if isinstance(error.__cause__, BlockingIOError):
            raise DatasetError(
                f"{path}: in use by another process. Wait for it to finish collecting."
            ) from error
        raise DatasetError(
            f"{path}: an unfinished file that cannot be opened ({error}). Delete it and collect "
            "again."
        ) from error


def _read_header(path: Path) -> Header:
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            check_about(path, about)
            return Header(**about, **{name: file[name] for name in file.files if name != "about"})
    except _UNREADABLE as error:
        raise DatasetError(
            f"{path}: an unfinished dataset that cannot be read ({error}). Delete the folder "
            f"{path.parent.name} and collect again."
        ) from error


def _read_episode(path: Path, header: Header) -> Demo:
    with np.load(path, allow_pickle=False) as file:
        names = (name for name in ARRAYS.values() if name in file or name not in OPTIONAL)
        arrays = {name: file[name] for name in names}
        seed, cameras = int(file["seed"]), file["cameras"]
    check_arrays(str(path), arrays, nq=header.nq, nv=header.nv)
    return Demo(seed=seed, nq=header.nq, cameras=cameras, **arrays)


def _file_of(header: Header, demos: list[Demo]) -> bytes:
    """The bytes of a complete HDF5 file."""
    train, valid = demos[: header.train], demos[header.train :]
    with h5py.File("whole", "w", driver="core", backing_store=False, block_size=2**20) as file:
        data: Any = file.create_group("data")
        env = {"env_name": header.task, "type": 1, "env_kwargs": {"scene": header.scene}}
        about = {**header.identity(), "versions": header.versions}
        total = sum(demo.length for demo in demos)
        data.attrs.update(total=total, env_args=json.dumps(env), jaxcam=json.dumps(about))
        cameras = file.create_group("cameras")
        for key, array in header.arrays.items():
            cameras.create_dataset(key, data=array, fletcher32=True)
        if header.K is None:  # else there is none of all cameras
            cameras.attrs["fovy_deg"] = header.fovy_deg
        names = [f"demo_{i}" for i in range(len(demos))]
        mask = file.create_group("mask")
        mask.create_dataset("train", data=names[: header.train], dtype=h5py.string_dtype())
        mask.create_dataset("valid", data=names[header.train :], dtype=h5py.string_dtype())
        for name, demo in zip(names, demos, strict=True):
            group = data.create_group(name)
            for key, array in demo.arrays().items():
                group.create_dataset(key, data=array, fletcher32=True)
            group.attrs.update(num_samples=demo.length, seed=demo.seed, cameras=demo.cameras)
        made = Demos(Path("whole"), header, train, valid, fingerprint_of(header, demos))
        data.attrs[OLD_SEAL] = seal_of(made)
        data.attrs[SEAL] = seal_of_all(file, [demo.arrays() for demo in demos])
        file.flush()
        return file.id.get_file_image()
