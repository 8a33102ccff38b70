"""The contact sheet of the documentation: what the cameras of each task see.

    python benchmarks/contact_sheet.py [--out docs/contact_sheet.png]

Three rows a task: the fixed scene from the test cameras; the randomised scene, a new episode in
each tile; one demonstration of the scripted expert in time, from one camera.
"""

import argparse
from pathlib import Path

import matplotlib.image
import numpy as np

from jaxcam.config.names import SceneName, names_of
from jaxcam.data.collection import run_expert
from jaxcam.data.splits import SPLITS
from jaxcam.rays import sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_task
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.render import Renderer
from jaxcam.sim.task import Task, starts
from jaxcam.sim.types import View

COLUMNS, TILE, GAP = 6, 184, 6
TEST_CAMERAS, FIRST_EPISODE = SPLITS["test"].cameras, 7
TASKS = ("lift", "pick_place_can", "square")


def episodes(task: Task, name: str) -> np.ndarray:
    """Starts of episodes, each from a camera of its own; the fixed scene's is one start."""
    scene = task.scene(name)
    seeds = [FIRST_EPISODE + i * (name == "randomized") for i in range(COLUMNS)]
    start = starts(task, scene, seeds)
    K = np.tile(intrinsics(task.fovy_deg, TILE), (COLUMNS, 1, 1))
    cameras = sample_poses(task.cameras, COLUMNS, TEST_CAMERAS)
    view = View(start.qpos, start.geom_size, start.fixtures, K, cameras)
    return Renderer(scene, TILE, varied=task.varied, samples=2, batch=COLUMNS).rgb(view)


def demonstration(task: Task, camera: int) -> np.ndarray:
    """An expert's episode at equal times, from one camera."""
    scene = task.scene("randomized")
    engine = NativeEngine(scene, "osc_pose", varied=task.varied)
    demo = run_expert(task, scene, engine, [FIRST_EPISODE])[0]
    if demo is None:
        raise SystemExit(f"The expert failed in episode {FIRST_EPISODE}; choose another.")
    times = np.linspace(0, demo.length, COLUMNS).round().astype(int)
    pose = sample_poses(task.cameras, camera + 1, TEST_CAMERAS)[camera]
    view = View(
        qpos=demo.qpos[times],
        geom_size=np.repeat(demo.geom_size[None], COLUMNS, 0),
        fixtures=np.repeat(demo.fixtures[None], COLUMNS, 0),
        K=np.tile(intrinsics(task.fovy_deg, TILE), (COLUMNS, 1, 1)),
        world_from_camera=np.repeat(pose[None], COLUMNS, 0),
    )
    return Renderer(scene, TILE, varied=task.varied, samples=2, batch=COLUMNS).rgb(view)


def sheet(rows: list[np.ndarray]) -> np.ndarray:
    """Rows of tiles on white."""
    height = len(rows) * (TILE + GAP) - GAP
    page = np.full((height, COLUMNS * (TILE + GAP) - GAP, 3), 255, np.uint8)
    for i, row in enumerate(rows):
        for j, tile in enumerate(row):
            top, left = i * (TILE + GAP), j * (TILE + GAP)
            page[top : top + TILE, left : left + TILE] = tile
    return page


def main() -> None:
    parser = argparse.ArgumentParser(description="Draws the documentation's contact sheet.")
    parser.add_argument("--out", type=Path, default=Path("docs/contact_sheet.png"))
    parser.add_argument("--camera", type=int, default=10, help="test camera of the demonstrations")
    args = parser.parse_args()
    rows = []
    for name in TASKS:
        task = make_task(name)
        rows += [episodes(task, scene) for scene in names_of(SceneName)]
        rows.append(demonstration(task, args.camera))
    matplotlib.image.imsave(args.out, sheet(rows))
    print(f"{args.out}: {args.out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
