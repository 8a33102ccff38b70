"""`python -m jaxcam.replay DATASET`: what demonstrations are worth in each action space.

Every demonstration's commands are turned into actions of a space and executed, open loop, from the
state that it began in. The paper asks for at least 99 % in each space (section V-A4).
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from jaxcam.config.datasets import ManiskillConfig, ReplayConfig
from jaxcam.console.progress import progress
from jaxcam.data.batches import demo_actions
from jaxcam.data.demos import Demo, Header, read_demos
from jaxcam.interop.maniskill_files import is_trajectories
from jaxcam.sim import make_engine, make_task
from jaxcam.sim.actions import ACTION_SPACES, controller_of, decode, measured
from jaxcam.sim.engine import Engine, OpenLoop
from jaxcam.sim.task import Task
from jaxcam.sim.types import Command, Start
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
        demos: the demonstrations.
        space: of the actions.
        task: whose success counts.
        scene: of the demonstrations.
        engine: with the space's controller.

    Returns:
        Whether each succeeded at any step of its own, bool [D], and the way there [T + 1, D, nq].
    """
    start = Start(
        qpos=np.stack([d.states[0, 1 : 1 + scene.nq] for d in demos]),
        geom_size=np.stack([d.geom_size for d in demos]),
        fixtures=np.stack([d.fixtures for d in demos]),
    )
    lengths = np.array([d.length for d in demos]) + SETTLE
    actions = [_held(demo_actions(d, space, scene), space, max(lengths)) for d in demos]
    anchor = measured(space, engine.reset(start), scene.arm)
    command = Command(*decode(space, np.stack(actions), anchor))
    progress, way = engine.run(OPEN_LOOP, command, start, task.success_in(scene), max(lengths))
    success = np.asarray(progress.success) & (np.asarray(progress.steps) <= lengths)
    return success, np.asarray(way)


def _held(actions: np.ndarray, space: str, length: int) -> np.ndarray:
    """Actions [length, A], float32 as policies learn them, that stay at the last target."""
    last = actions[-1].copy()
    if not space.endswith("abs"):
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
        demos: the demonstrations.
        task: whose success counts.
        scene: of the demonstrations.
        spaces: action spaces.
        engine: name of the physics engine; the one that makes demonstrations when None.
        tick: called with the number of demonstrations that were replayed.
    """
    engines: dict[str, Engine] = {}
    found = {}
    for space in spaces:
        controller = controller_of(space)
        if controller not in engines:
            engines[controller] = make_engine(engine, scene, controller, task.varied)
        parts = []
        for i in range(0, len(demos), BATCH):
            batch = demos[i : i + BATCH]
            parts.append(replay(batch, space, task, scene, engines[controller]))
            tick(len(batch))
        found[space] = np.concatenate(parts)
    return found


def tell(
    demos: Sequence[Demo], header: Header, spaces: Sequence[str], engine: str | None, to: Console
) -> dict[str, np.ndarray]:
    """Replays demonstrations and prints a table of how many succeed; see `replay_all`."""
    task = make_task(header.task)
    scene = task.scene(header.scene)
    with progress(to, "replaying", len(demos) * len(spaces)) as advance:
        found = replay_all(demos, task, scene, spaces, engine, advance)
    table = Table(title=f"{header.task}, {header.scene}: {len(demos)} demonstrations")
    for column in ("action space", "succeed", "rate", "fail"):
        table.add_column(column, justify="left" if column != "rate" else "right")
    for space, success in found.items():
        failed = ", ".join(f"demo_{i}" for i in np.flatnonzero(~success))
        table.add_row(space, f"{success.sum()} of {len(demos)}", f"{success.mean():.1%}", failed)
    to.print(table)
    if any(success.mean() < GATE for success in found.values()):
        to.print(f"Below {GATE:.0%}: policies of that space learn from what does not work.")
    return found


def main(config: ReplayConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    path = Path(config.dataset)
    spaces = config.action_space or ACTION_SPACES
    if is_trajectories(path):
        from jaxcam.interop.maniskill import run

        found = run(ManiskillConfig(file=config.dataset), spaces, config.engine, console)
    else:
        data = read_demos(path)
        found = tell(data.train + data.valid, data.header, spaces, config.engine, console)
    return int(any(success.mean() < GATE for success in found.values()))
