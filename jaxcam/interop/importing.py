"""Demonstrations of others as a dataset of ours: what importing any kind of file shares."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import h5py
import numpy as np
from rich.console import Console

from jaxcam.config.datasets import CollectConfig, ImportConfig
from jaxcam.config.names import TaskName
from jaxcam.data.collection import camera_windows, in_task, new_header
from jaxcam.data.demos import Demo, Demos, read_demos
from jaxcam.data.hdf5 import group_at, names_at
from jaxcam.data.splits import NO_VALIDATION
from jaxcam.data.writer import DemoWriter, discard
from jaxcam.errors import DatasetError, closest
from jaxcam.files.locks import exclusive
from jaxcam.files.paths import home
from jaxcam.sim.task import Task
from jaxcam.sim.types import State
from jaxcam.sim.world import World


def held_back(count: int) -> int:
    """Demonstrations of `count` that become validation ones: every tenth, one at least."""
    return max(count // 10, min(1, count - 1), 0)


@dataclass(frozen=True)
class Masks:
    """The lists of demonstrations that a file has under `mask`, and how they split it."""

    path: Path
    group: h5py.Group | None
    everything: list[str]
    """All demonstrations, by their number."""

    @classmethod
    def of(cls, path: Path, file: h5py.File, everything: list[str]) -> "Masks":
        """The masks of an open file."""
        return cls(path, group_at(file, "mask") if "mask" in file else None, everything)

    def has(self, key: str) -> bool:
        """Whether there is such an entry."""
        return self.group is not None and key in self.group

    def members(self, key: str) -> list[str]:
        """The demonstrations of an entry, in the file's order."""
        if self.group is None or not self.has(key):
            raise DatasetError(
                f"{self.path}: no filter key {key!r}{closest(key, self.group or [])}"
            )
        members = set(names_at(self.group, key, len(self.everything)))
        if strangers := sorted(members - set(self.everything)):
            raise DatasetError(
                f"{self.path}: mask/{key} lists {strangers[0]!r}, which the file does not have. "
                "Choose another --filter-key, or split it anew with --validation."
            )
        return [name for name in self.everything if name in members]

    def split(self, part: str | None, validation: int | None) -> tuple[list[str], list[str]]:
        """Training and validation demonstrations.

        Args:
            part: Entry that was asked for, if any. `20_demos` is split by `20_demos_train` and
                `20_demos_valid`, as robomimic's `split_train_val.py` names them; all is split by
                `train` and `valid`.
            validation: How many of the last ones are for validation; as the entries say when None.

        Raises:
            DatasetError: None is left to train on, or the entries contradict each other.
        """
        chosen = self.everything if part is None else self.members(part)
        if validation is not None:
            cut = max(len(chosen) - validation, 0)
            train, valid = chosen[:cut], chosen[cut:]
        else:
            train, valid = self._as_listed(part, chosen)
        if not train:
            raise DatasetError(
                f"{self.path}: {len(chosen)} demonstrations, {len(valid)} of them for validation: "
                "none is left to train on. Choose another --filter-key or a smaller --validation."
            )
        return train, valid

    def _as_listed(self, part: str | None, chosen: list[str]) -> tuple[list[str], list[str]]:
        stem = (part or "train").removesuffix("train")
        keys = (f"{stem}train", f"{stem}valid")
        if part is not None and stem == part:
            keys = (f"{part}_train", f"{part}_valid")
        if not (self.has(keys[0]) or self.has(keys[1])):
            keys = ("", "valid")
        train = self.members(keys[0]) if self.has(keys[0]) else chosen
        valid = self.members(keys[1]) if self.has(keys[1]) else []
        if not self.has(keys[0]):
            valid = [name for name in valid if name in train]
            train = [name for name in train if name not in valid]
        if both := [name for name in train if name in valid]:
            raise DatasetError(
                f"{self.path}: {both[0]} is in mask/{keys[0]} and in mask/{keys[1]}: it would be "
                "trained and validated on. Split the file anew with --validation."
            )
        if not valid:
            cut = len(train) - held_back(len(train))
            train, valid = train[:cut], train[cut:]
        return train, valid


def show_next(demos: Demos, works: bool, console: Console) -> None:
    """Says what an imported dataset is good for.

    Args:
        demos: The dataset.
        works: Whether any of it succeeds when its commands are replayed.
        console: To say it on.
    """
    if not works:
        console.print(
            "Do not train on it: none of its commands succeeds when replayed. Look at it with: "
            f"python -m jaxcam.check {demos.path}", soft_wrap=True,
        )  # fmt: skip
        return
    if not demos.valid:
        console.print(NO_VALIDATION)
    console.print(f"Train on it: python -m jaxcam.train --dataset {demos.path}", soft_wrap=True)


def write_dataset(
    config: ImportConfig,
    task: Task,
    demos: Iterable[Demo],
    *,
    train: int,
    valid: int,
    about: str,
    console: Console | None = None,
) -> Demos:
    """Writes demonstrations as a dataset, seen by cameras drawn as for our own.

    Args:
        config: What to import and where to.
        task: Of the demonstrations.
        demos: `train` of them, then `valid`, without cameras.
        train: Training demonstrations.
        valid: Validation demonstrations.
        about: Where they come from, for the header.
        console: For who holds the dataset's lock; silent when None.

    Returns:
        The dataset as read back.

    Raises:
        DatasetError: If it exists.
    """
    out = home(config.out or f"data/{task.name}-{config.scene}-{Path(config.file).stem}.hdf5")
    like = CollectConfig(
        task=cast(TaskName, task.name),
        scene=config.scene,
        demos=train,
        validation=valid,
        n=config.n,
        m=config.m,
    )
    with exclusive(out, console):
        if out.exists():
            raise DatasetError(
                f"{out} exists. Choose another --out, or delete it first; if this command was "
                f"stopped after it was written, see what it is good for: jaxcam replay {out}"
            )
        discard(out)  # perhaps of another file
        header = new_header(in_task(like), task, task.scene(config.scene))
        header = replace(header, versions={**header.versions, "imported": about})
        with DemoWriter(out, header) as writer:
            for i, (demo, cameras) in enumerate(zip(demos, camera_windows(header), strict=True)):
                writer.append(i, replace(demo, cameras=cameras))
            writer.finish()
    return read_demos(out)


def succeeds(demo: Demo, task: Task, scene: World) -> bool:
    """Whether the task is done in one of a demonstration's states."""
    grip = demo.world_from_grip()
    state = State(
        qpos=demo.qpos,
        qvel=demo.qvel,
        warmstart=np.zeros((len(grip), 0)),
        closed=demo.gripper,
        rest=demo.qpos[:, scene.arm],
        grip_position=grip[:, :3, 3],
        grip_rotation=grip[:, :3, :3],
        ok=np.ones(len(grip), bool),
    )
    return bool(task.success(scene, state, demo.start()).any())
