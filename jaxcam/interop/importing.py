"""Demonstrations of others as a dataset of ours: what importing any kind of file shares."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.datasets import CollectConfig, ImportConfig
from jaxcam.data.collection import camera_windows, new_header
from jaxcam.data.demos import Demo, Demos, read_demos
from jaxcam.data.writer import DemoWriter
from jaxcam.errors import DatasetError
from jaxcam.files.locks import exclusive
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.runs.identity import with_task
from jaxcam.sim.task import Task
from jaxcam.sim.types import Start, State
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
        config: what to import and where to.
        task: of the demonstrations.
        demos: `train` of them, then `valid`, without cameras.
        train: training demonstrations.
        valid: validation demonstrations.
        about: where they come from, for the header.
        console: for who holds the dataset's lock; silent when None.

    Returns:
        The dataset as read back.

    Raises:
        DatasetError: if it exists.
    """
    out = Path(config.out or f"data/{task.name}-{config.scene}-{Path(config.file).stem}.hdf5")
    like = CollectConfig(
        task=task.name, scene=config.scene, demos=train, validation=valid, n=config.n, m=config.m
    )
    with exclusive(out, console):
        if out.exists():
            raise DatasetError(f"{out} exists. Choose another --out, or delete it first.")
        out.with_name(out.name + ".part").unlink(missing_ok=True)  # perhaps of another file
        header = new_header(with_task(like), task, task.scene(config.scene))
        header = replace(header, versions={**header.versions, "imported": about})
        with DemoWriter(out, header) as writer:
            for i, (demo, cameras) in enumerate(zip(demos, camera_windows(header), strict=True)):
                writer.append(i, replace(demo, cameras=cameras))
            writer.finish()
    return read_demos(out)


def succeeds(demo: Demo, task: Task, scene: World) -> bool:
    """Whether the task is done in one of a demonstration's states."""
    qpos, qvel = demo.states[:, 1 : 1 + scene.nq], demo.states[:, 1 + scene.nq :]
    state = State(
        qpos=qpos,
        qvel=qvel,
        warmstart=np.zeros((len(qpos), 0)),
        closed=demo.gripper,
        rest=qpos[:, scene.arm],
        grip_position=demo.eef_pos,
        grip_rotation=matrix_from_quaternion(np.roll(demo.eef_quat, 1, -1)),
        ok=np.ones(len(qpos), bool),
    )
    return bool(task.success(scene, state, Start(qpos[0], demo.geom_size, demo.fixtures)).any())
