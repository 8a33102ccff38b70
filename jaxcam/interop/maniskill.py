"""`python -m jaxcam.maniskill FILE.h5`: ManiSkill's trajectories as a jaxcam dataset.

The environment states in the file become states of the task's world, and its actions absolute grip
targets, whatever the control mode; cameras are drawn as for our own demonstrations. The result is
then replayed in each action space, and what does not succeed there is told with the reason.
`python -m jaxcam.replay FILE.h5` does the same with the usual settings. The layout of the files is
that of ManiSkill's `RecordEpisode` (mani_skill 3), which the official demonstrations share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from rich.console import Console

from jaxcam.config.datasets import ManiskillConfig
from jaxcam.console.progress import progress
from jaxcam.data.demos import Demo, Demos
from jaxcam.data.replay import falls_short, play, show_replayed
from jaxcam.data.splits import FIRST_SEED
from jaxcam.errors import DatasetError
from jaxcam.interop.importing import held_back, show_next, succeeds, write_dataset
from jaxcam.interop.maniskill_files import (
    check_file_size,
    open_file,
    read_demo,
    read_source,
    why_failed,
)
from jaxcam.sim import make_engine
from jaxcam.sim.actions import ACTION_SPACES, controller_of
from jaxcam.sim.maniskill.scene import SapienWorld

ASTRAY = 0.02
"""Distance (m) from where it was recorded at which a replayed object has gone another way."""


@dataclass(frozen=True)
class Imported:
    """What came of a trajectory file."""

    demos: Demos
    names: list[str]
    """Of the trajectories that became demonstrations, in their order."""
    dropped: dict[str, str]
    """Why the others did not, by name."""


def import_trajectories(config: ManiskillConfig, console: Console | None = None) -> Imported:
    """Turns a trajectory file into a dataset of ours.

    Args:
        config: What to import and how.
        console: For progress; silent when None.

    Returns:
        The dataset as read back, and what was left out of it.

    Raises:
        DatasetError: If the file is not ManiSkill's, is of another task or robot, has no
            environment states, or if the dataset exists.
        SimError: If this machine cannot run ManiSkill.
    """
    source = read_source(config)
    source.task.require()
    demos: dict[str, Demo] = {}
    dropped: dict[str, str] = {}
    with (
        open_file(source.path) as file,
        progress(console, "reading", len(source.episodes)) as advance,
    ):
        check_file_size(source, file)
        for episode in source.episodes:
            name = episode.name
            demo = read_demo(source, file, name, episode.mode, FIRST_SEED + len(demos))
            if succeeds(demo, source.task, source.scene):
                demos[name] = demo
            else:
                dropped[name] = why_failed(source, file, name)
            advance()
    if not demos:
        name, why = next(iter(dropped.items()))
        raise DatasetError(f"{source.path}: no trajectory succeeds. The first, {name}: {why}.")
    valid = held_back(len(demos)) if config.validation is None else config.validation
    train = len(demos) - valid
    if train < 1:
        raise DatasetError(
            f"{source.path}: {len(demos)} of {len(source.episodes)} trajectories succeed, of which "
            f"{valid} are for validation: none is left to train on. Choose a smaller --validation."
        )
    written = write_dataset(
        config,
        source.task,
        demos.values(),
        train=train,
        valid=valid,
        about=source.about,
        console=console,
    )
    return Imported(written, list(demos), dropped)


def run(
    config: ManiskillConfig, spaces: Sequence[str], engine: str | None, console: Console
) -> dict[str, np.ndarray]:
    """Imports a file, replays it, and tells of both.

    Args:
        config: What to import and how.
        spaces: Action spaces to replay in.
        engine: Name of the physics engine; the world's own when None.
        console: To tell on.

    Returns:
        Whether each demonstration succeeds in each space, bool [D] by name.
    """
    kept = import_trajectories(config, console)
    data, total = kept.demos, len(kept.names) + len(kept.dropped)
    console.print(f"{data.path}: {len(kept.names)} of {total} trajectories succeed.")
    for name, why in kept.dropped.items():
        console.print(f"{name}: {why}")
    replayed = show_replayed(data, spaces, engine, console)
    for space, success in replayed.items():
        for i in np.flatnonzero(~success):
            why = _why_lost(data.episodes[i], space, data, engine)
            console.print(f"{space}, {kept.names[i]}: {why}")
    show_next(data, any(success.any() for success in replayed.values()), console)
    return replayed


def _why_lost(demo: Demo, space: str, data: Demos, engine: str | None) -> str:
    """How the replay of a demonstration that fails differs from its states."""
    task, scene = data.task, cast(SapienWorld, data.world)
    stepped = make_engine(engine, scene, controller_of(space), task.varied)
    _, way = play([demo], space, task, scene, stepped)
    recorded = demo.qpos
    steps = min(len(way), len(recorded))
    for name in scene.objects:
        at = scene.qpos_of(name)
        apart = np.linalg.norm(way[:steps, 0, at : at + 3] - recorded[:steps, at : at + 3], axis=-1)
        gone = np.flatnonzero(apart > ASTRAY)
        if len(gone):
            return (
                f"from control step {gone[0]} on, the {name} is elsewhere than it was recorded, "
                f"by up to {apart.max():.2f} m"
            )
    return "goes as it was recorded, and only just misses success"


def main(config: ManiskillConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    successes = run(config, ACTION_SPACES, None, console)
    return int(falls_short(successes))
