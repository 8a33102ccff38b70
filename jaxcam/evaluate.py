"""`python -m jaxcam.evaluate RUN`: success on (initial state, camera pose) pairs never seen.

Pairs are numbered; pair i has the same start and the same cameras for every policy, seed and
checkpoint (paper, section IV-C). Every rollout is one row of `RUN/eval/rows.jsonl`.
"""

from jaxcam.config import EvaluateConfig, TrainConfig
from jaxcam.fields import cli

if __name__ == "__main__":
    cli(EvaluateConfig)  # --help and bad flags are answered before the slow imports

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.tree_util import Partial
from rich.console import Console

from jaxcam.actions import controller_of
from jaxcam.checkpoint import load_policy_inputs
from jaxcam.errors import run_main
from jaxcam.frames import intrinsics
from jaxcam.html import write_report
from jaxcam.models import Policy, rebuild_policy
from jaxcam.plots import write_plots
from jaxcam.progress import progress
from jaxcam.rays import Camera, sample_poses, spherical
from jaxcam.rundir import append_jsonl, read_jsonl
from jaxcam.sim import engine_name, make_engine, make_task
from jaxcam.sim.rollout import Rollouts, rollout
from jaxcam.sim.task import starts
from jaxcam.sim.world import View
from jaxcam.stats import Estimate, latest_rows, success_rate
from jaxcam.video import grid, write_video

SPLITS = {"test": (1_000_000, 23), "validation": (2_000_000, 5)}
"""First episode seed and camera seed of each set of pairs. `test` has the authors' released test
cameras; settings are chosen on `validation`."""
ATTEMPTS = 2
"""Times that a pair is run whose rollout ends in an error of the physics or the policy."""
VIDEO_PIXELS = 160
VIDEO_STRIDE = 2
"""Control steps per frame of a video."""

Row = dict[str, Any]
USUAL: Row = {"engine": "native", "ensemble": 0.0}
"""What rows lack that were written before there was a choice."""


class Evaluator:
    """Runs pairs of one task, scene and action space; the compiled parts are made once.

    Args:
        config: of the runs whose policies are evaluated.
        width: rollouts simulated at once. Policies see batches of exactly this many, since the
            width can change a result's last digits; it is kept in each row.
        engine: that simulates them; `config.engine` when None.
        ensemble: rate of temporal ensembling, 0 is off; `config.ensemble` when None.
    """

    def __init__(
        self,
        config: TrainConfig,
        width: int = 50,
        engine: str | None = None,
        ensemble: float | None = None,
    ) -> None:
        self.config, self.width = config, width
        self.ensemble = config.ensemble if ensemble is None else ensemble
        self.task = make_task(config.task)
        self.task.require()
        self.scene = self.task.scene(config.scene)
        self.engine_name = engine_name(engine or config.engine, self.scene)
        varied = self.task.varied
        controller = controller_of(config.action_space)
        self.engine = make_engine(self.engine_name, self.scene, controller, varied)
        self.renderer = self.scene.painter(config.resolution, varied=varied)

    def run(
        self,
        policy: Policy,
        params: Any,
        split: str,
        pairs: Sequence[int],
        *,
        step: int,
        run: str,
        tick: Callable[[], None] = lambda: None,
    ) -> tuple[list[Row], Rollouts]:
        """Runs at most `width` pairs at once.

        Args:
            policy: the policy.
            params: its parameters.
            split: which pairs: `test` or `validation`.
            pairs: their numbers.
            step: of the checkpoint, for the rows.
            run: name of the run, for the rows.
            tick: called after every control step.

        Returns:
            One row per pair, and the rollouts.
        """
        config, task, spec = self.config, self.task, policy.spec
        # Always worlds for `width`: neither policy nor compiled physics sees another size.
        filled = [*pairs, *[pairs[-1]] * (self.width - len(pairs))]
        seed, cameras = self._pairs(split, filled)
        act = Partial(_Acting(policy.act), params, jax.random.key(config.seed))
        start = starts(task, self.scene, [seed + p for p in filled])
        K = np.broadcast_to(
            intrinsics(task.fovy_deg, config.resolution), (*cameras.shape[:2], 3, 3)
        )
        ahead = spec.chunk - spec.obs_steps + 1  # steps that a chunk reaches into the future
        done = rollout(
            act,
            task,
            self.scene,
            self.engine,
            self.renderer,
            start,
            K,
            cameras,
            config.action_space,
            ahead if self.ensemble else policy.execute,
            np.arange(self.width) < len(pairs),
            tick,
            spec.obs_steps,
            self.ensemble,
        )
        azimuth, elevation, distance = (
            np.asarray(x) for x in spherical(cameras[:, 0], np.array(task.cameras.centre))
        )
        return [
            {
                "task": config.task,
                "scene": config.scene,
                "run": run,
                "policy": config.policy,
                "conditioning": config.conditioning,
                "seed": config.seed,
                "step": step,
                "split": split,
                "pair": pair,
                "success": bool(done.success[i]),
                "status": "ok" if done.ok[i] else "error",
                "steps": int(done.steps[i]),
                "azimuth_deg": float(np.rad2deg(azimuth[i])),
                "elevation_deg": float(np.rad2deg(elevation[i])),
                "distance": float(distance[i]),
                "camera": cameras[i].tolist(),
                "renderer": self.scene.look,
                "engine": self.engine_name,
                "ensemble": self.ensemble,
                "width": self.width,
                "episode_seed": seed + pair,
            }
            for i, pair in enumerate(pairs)
        ], done

    def clips(self, done: Rollouts, split: str, pairs: Sequence[int]) -> list[np.ndarray]:
        """Videos of rollouts as their first camera saw them, uint8 [T, H, W, 3] each."""
        task = self.task
        seed, cameras = self._pairs(split, pairs)
        renderer = self.scene.painter(VIDEO_PIXELS, varied=task.varied)
        start = starts(task, self.scene, [seed + p for p in pairs])
        K = intrinsics(task.fovy_deg, VIDEO_PIXELS)
        clips = []
        for i in range(len(pairs)):
            qpos = done.qpos[: done.steps[i] + 1 : VIDEO_STRIDE, i]
            several = (len(qpos), 1, 1)
            view = View(
                qpos=qpos,
                geom_size=np.tile(start.geom_size[i], several),
                fixtures=np.tile(start.fixtures[i], several),
                K=np.tile(K, several),
                world_from_camera=np.tile(cameras[i, 0], several),
            )
            clips.append(renderer.rgb(view))
        return clips

    def sight(self, split: str, pair: int) -> tuple[np.ndarray, np.ndarray]:
        """What a policy sees at a pair's start: picture uint8 [H, W, 3] and ray-map [H, W, 6]."""
        seed, cameras = self._pairs(split, [pair])
        start = starts(self.task, self.scene, [seed + pair])
        K = intrinsics(self.task.fovy_deg, self.config.resolution)[None]
        view = View(start.qpos, start.geom_size, start.fixtures, K, cameras[:, 0])
        size = self.config.resolution
        camera = Camera(K[0], cameras[0, 0], size, size)
        rays = camera.in_frame(np.linalg.inv(self.scene.world_from_base)).plucker()
        return self.renderer.rgb(view)[0], np.asarray(rays)

    def _pairs(self, split: str, pairs: Sequence[int]) -> tuple[int, np.ndarray]:
        """First episode seed, and cameras [B, V, 4, 4]: pair p has poses V p to V p + V - 1."""
        first, camera_seed = SPLITS[split]
        views = self.config.views
        poses = sample_poses(self.task.cameras, views * (max(pairs) + 1), camera_seed)
        return first, poses.reshape(-1, views, 4, 4)[list(pairs)]


@dataclass(frozen=True)
class _Acting:
    """A policy's `act` with chance of its own for every call."""

    act: Callable[..., jax.Array]

    def __call__(self, params: Any, root: jax.Array, obs: Any, number: jax.Array) -> jax.Array:
        return jax.jit(self.act)(params, obs, jax.random.fold_in(root, number))


def evaluate(
    evaluator: Evaluator,
    policy: Policy,
    params: Any,
    folder: Path,
    *,
    step: int,
    split: str = "test",
    pairs: int = 50,
    videos: int = 0,
    console: Console | None = None,
) -> Estimate:
    """Runs the pairs of a checkpoint that have no row yet, and writes rows, and a video.

    A rollout that ends in an error is run once more; then it is counted, and told, as an error.

    Args:
        evaluator: of the run's task.
        policy: the policy.
        params: the checkpoint's parameters.
        folder: of the run.
        step: of the checkpoint.
        split: which pairs.
        pairs: how many, from number 0.
        videos: rollouts shown in a video; only those that are run now can be.
        console: for progress.

    Returns:
        The success rate over the pairs, with its interval.
    """
    file = folder / "eval" / "rows.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)

    same = {
        "step": step,
        "split": split,
        "width": evaluator.width,
        "engine": evaluator.engine_name,
        "ensemble": evaluator.ensemble,
    }

    def rows_so_far() -> list[Row]:
        rows = [USUAL | r for r in read_jsonl(file)]
        return [r for r in rows if r["pair"] < pairs and all(r[k] == same[k] for k in same)]

    def to_run() -> list[int]:
        tries = Counter(r["pair"] for r in rows_so_far())
        done = {r["pair"] for r in rows_so_far() if r["status"] == "ok"}
        return [p for p in range(pairs) if p not in done and tries[p] < ATTEMPTS]

    horizon = evaluator.task.horizon
    batches = -(-len(to_run()) // evaluator.width)
    with progress(console, "evaluating", horizon * batches) as advance:
        while some := to_run()[: evaluator.width]:
            steps = 0

            def tick() -> None:
                nonlocal steps
                steps += 1
                advance()

            rows, done = evaluator.run(
                policy, params, split, some, step=step, run=folder.name, tick=tick
            )
            advance(horizon - steps)
            append_jsonl(file, *rows, fsync=True)
            if videos:
                shown, videos = some[:videos], 0
                film = grid(evaluator.clips(done, split, shown), rows=rows[: len(shown)])
                (folder / "videos").mkdir(exist_ok=True)
                write_video(folder / "videos" / f"{split}-{step:06d}.mp4", film, fps=10)
    return success_rate(latest_rows(rows_so_far()))


def main() -> None:
    """The command line."""
    config = cli(EvaluateConfig)
    console = Console()
    inputs = load_policy_inputs(config.run, config.step)
    policy = rebuild_policy(inputs)
    evaluator = Evaluator(inputs.config, config.width, config.engine, config.ensemble)
    folder = Path(config.run)
    estimate = evaluate(
        evaluator,
        policy,
        inputs.params,
        folder,
        step=inputs.step,
        split=config.split,
        pairs=config.pairs,
        videos=config.videos,
        console=console,
    )
    rows = [
        r
        for r in latest_rows(read_jsonl(folder / "eval" / "rows.jsonl"))
        if (r["step"], r["split"]) == (inputs.step, config.split)
    ]
    write_plots(folder / "plots", read_jsonl(folder / "metrics.jsonl"), rows)
    console.print(
        f"Success on {config.pairs} {config.split} pairs at step {inputs.step}: {estimate}"
    )
    console.print(f"Report: {write_report(folder)}")


if __name__ == "__main__":
    run_main(main)
