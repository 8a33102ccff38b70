"""Demonstrations of others as a dataset of ours: what importing any kind of file shares."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from rich.console import Console

from jaxcam.config.datasets import CollectConfig, ImportConfig
from jaxcam.config.names import TaskName
from jaxcam.data.collection import camera_windows, new_header, with_stair
from jaxcam.data.demos import Demo, Demos, read_demos
from jaxcam.data.writer import DemoWriter, discard
from jaxcam.errors import DatasetError
from jaxcam.files.locks import exclusive
from jaxcam.files.paths import home
from jaxcam.sim.task import Task
from jaxcam.sim.types import State
from jaxcam.sim.world import World


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
            raise DatasetError(f"{out} exists. Choose another --out, or delete it first.")
        discard(out)  # perhaps of another file
        header = new_header(with_stair(like), task, task.scene(config.scene))
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
