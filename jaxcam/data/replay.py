"""What demonstrations are worth in each action space.

Every demonstration's commands are turned into actions of a space and executed, open loop, from the
state that it began in. The paper asks for at least 99 % in each space (section V-A4).
"""

from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from jaxcam.console.progress import progress
from jaxcam.data.batches import demo_actions
from jaxcam.data.demos import Demo, Demos, starts_of
from jaxcam.sim import make_engine
from jaxcam.sim.actions import ACTION_SPACES, controller_of, decode, is_absolute, measured
from jaxcam.sim.engine import Engine, OpenLoop
from jaxcam.sim.task import Task
from jaxcam.sim.types import Command
from jaxcam.sim.world import World

GATE = 0.99
"""Share of demonstrations that must succeed when replayed (paper, section V-A4)."""
SETTLE = 20
"""Control steps for which the last command is kept: the authors' recordings end 20 steps after
success, ours at the expert's last aim."""
BATCH = 50
OPEN_LOOP = OpenLoop()


def replay(
    demos: Sequence[Demo], space: str, task: Task, scene: World, engine: Engine
) -> np.ndarray:
    """Whether each demonstration succeeds at any step of its own, bool [D]; see `play`."""
    return play(demos, space, task, scene, engine)[0]


def play(
    demos: Sequence[Demo], space: str, task: Task, scene: World, engine: Engine
) -> tuple[np.ndarray, np.ndarray]:
    """Executes demonstrations side by side in one action space.

    Args:
        demos: The demonstrations.
        space: Of the actions.
        task: Whose success counts.
        scene: Of the demonstrations.
        engine: With the space's controller.

    Returns:
        Whether each succeeded at any step of its own, bool [D], and the way there [T + 1, D, nq].
    """
    start = starts_of(demos)
    lengths = np.array([d.length for d in demos]) + SETTLE
    actions = [_held(demo_actions(d, space, scene), space, max(lengths)) for d in demos]
    anchor = measured(space, engine.reset(start), scene.arm)
    command = Command(*decode(space, np.stack(actions), anchor, scene.nominal_grip))
    progress, way = engine.run(OPEN_LOOP, command, start, task.success_in(scene), max(lengths))
    success = np.asarray(progress.success) & (np.asarray(progress.steps) <= lengths)
    return success, np.asarray(way)


def _held(actions: np.ndarray, space: str, length: int) -> np.ndarray:
    """Actions [length, A], float32 as policies learn them, that stay at the last target."""
    last = actions[-1].copy()
    if not is_absolute(space):
        last[:-1] = 0
    held = np.concatenate([actions, np.tile(last, (length - len(actions), 1))])
    return held.astype(np.float32)


def replay_all(
    demos: Sequence[Demo],
    task: Task,
    scene: World,
    spaces: Sequence[str] = ACTION_SPACES,
    engine: str | None = None,
    tick: Callable[[int], None] = lambda count: None,
) -> dict[str, np.ndarray]:
    """Whether each demonstration succeeds in each space, bool [D] by name.

    Args:
        demos: The demonstrations.
        task: Whose success counts.
        scene: Of the demonstrations.
        spaces: Action spaces.
        engine: Name of the physics engine; the one that makes demonstrations when None.
        tick: Called with the number of demonstrations that were replayed.
    """
    engines: dict[str, Engine] = {}
    replayed = {}
    for space in spaces:
        controller = controller_of(space)
        if controller not in engines:
            engines[controller] = make_engine(engine, scene, controller, task.varied)
        parts = []
        for i in range(0, len(demos), BATCH):
            batch = demos[i : i + BATCH]
            parts.append(replay(batch, space, task, scene, engines[controller]))
            tick(len(batch))
        replayed[space] = np.concatenate(parts)
    return replayed


def show_replayed(
    demos: Demos, spaces: Sequence[str], engine: str | None, to: Console
) -> dict[str, np.ndarray]:
    """Replays a dataset and prints a table of how many succeed; see `replay_all`."""
    episodes, header = demos.episodes, demos.header
    job, total = f"replaying {header.task}", len(episodes) * len(spaces)
    with progress(to, "replaying", total, job=job) as advance:
        replayed = replay_all(episodes, demos.task, demos.world, spaces, engine, advance)
    table = Table(title=f"{header.task}, {header.scene}: {len(episodes)} demonstrations")
    for column in ("action space", "succeed", "rate", "fail"):
        table.add_column(column, justify="left" if column != "rate" else "right")
    for space, success in replayed.items():
        failed = ", ".join(f"demo_{i}" for i in np.flatnonzero(~success))
        table.add_row(space, f"{success.sum()} of {len(episodes)}", f"{success.mean():.1%}", failed)
    to.print(table)
    if falls_short(replayed):
        to.print(f"Below {GATE:.0%}: policies of that space learn from what does not work.")
    return replayed


def falls_short(replayed: dict[str, np.ndarray]) -> bool:
    """Whether fewer than `GATE` of the demonstrations succeed in some space; see `replay_all`."""
    return any(success.mean() < GATE for success in replayed.values())
