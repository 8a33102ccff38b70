"""Policy chunks to commands to physics to success, for a batch of episodes.

The policy is asked once per chunk for the whole batch, each episode seen by its own cameras; the
chunk is executed open loop. Worlds that are done or have failed stay as they are.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from jaxcam.actions import decode, measured
from jaxcam.rays import invert
from jaxcam.sim.engine import Command, Engine, Start, begin
from jaxcam.sim.render import Renderer, View
from jaxcam.sim.scene import Scene
from jaxcam.sim.task import Task

Act = Callable[[dict[str, np.ndarray], int], np.ndarray]
"""`act(obs, call)`: observations of all episodes and number of the call, to chunks [B, T, A]."""


@dataclass(frozen=True)
class Rollouts:
    """What happened in a batch of episodes."""

    success: np.ndarray
    """[B] bool: success at any control step."""
    steps: np.ndarray
    """[B] control steps to success, or until the episode was cut."""
    ok: np.ndarray
    """[B] bool: physics and actions stayed finite."""
    qpos: np.ndarray = field(repr=False)
    """[T + 1, B, nq] the way there, for videos."""


def rollout(
    act: Act,
    task: Task,
    scene: Scene,
    engine: Engine,
    renderer: Renderer,
    start: Start,
    K: np.ndarray,
    world_from_camera: np.ndarray,
    space: str,
    execute: int | None = None,
    alive: np.ndarray | None = None,
    tick: Callable[[], None] = lambda: None,
) -> Rollouts:
    """Runs one episode per start until success or the task's horizon.

    Args:
        act: the policy.
        task: whose success counts.
        scene: of the episodes.
        engine: with the space's controller.
        renderer: of the scene, at the policy's resolution.
        start: [B] episodes.
        K: intrinsics [B, V, 3, 3].
        world_from_camera: camera poses [B, V, 4, 4].
        space: of the policy's actions.
        execute: steps of a chunk that are executed; the whole chunk when None.
        alive: [B] False for episodes that only fill the batch up; all when None.
        tick: called after every control step.
    """
    base_from_camera = (invert(scene.world_from_base) @ world_from_camera).astype(np.float32)
    state = engine.reset(start)
    anchor = measured(space, state, scene.arm)
    progress = begin(state, task.horizon, alive)
    trace = [np.asarray(state.qpos)[None]]
    call = 0
    while np.any(active := np.asarray(progress.active)):
        qpos, grip = np.asarray(progress.state.qpos), np.asarray(progress.state.grip_position)
        obs = {
            "image": _look(renderer, qpos, start, K, world_from_camera, active),
            "K": K.astype(np.float32),
            "base_from_camera": base_from_camera,
            "proprio": scene.proprio(qpos, grip),
        }
        chunk = np.asarray(act(obs, call))[:, :execute]
        call += 1
        is_finite = np.asarray(np.isfinite(chunk).all((1, 2)))
        # A world that is done sees black: its chunk is not used.
        progress = progress._replace(alive=progress.alive & (is_finite | ~active))
        chunk = np.where(is_finite[:, None, None], chunk, 0)
        targets, gripper = decode(space, chunk, anchor)
        progress, way = engine.play(progress, Command(targets, gripper), start, task.success, tick)
        trace.append(np.asarray(way))
        anchor = targets[:, -1]
    return Rollouts(
        success=np.asarray(progress.success),
        steps=np.asarray(progress.steps),
        ok=np.asarray(progress.state.ok & progress.alive),
        qpos=np.concatenate(trace),
    )


def _look(
    renderer: Renderer,
    qpos: np.ndarray,
    start: Start,
    K: np.ndarray,
    world_from_camera: np.ndarray,
    active: np.ndarray,
) -> np.ndarray:
    """Pictures [B, V, H, W, 3] of the active episodes; the others' are black and never used."""
    views = K.shape[1]
    rows = np.flatnonzero(active)
    pictures = np.zeros((len(active), views, renderer.height, renderer.width, 3), np.uint8)
    view = View(
        qpos=qpos[rows].repeat(views, 0),
        geom_size=np.asarray(start.geom_size)[rows].repeat(views, 0),
        fixtures=np.asarray(start.fixtures)[rows].repeat(views, 0),
        K=K[rows].reshape(-1, 3, 3),
        world_from_camera=world_from_camera[rows].reshape(-1, 4, 4),
    )
    pictures[rows] = renderer.rgb(view).reshape(len(rows), views, *pictures.shape[2:])
    return pictures
