"""50 vector environments against the rollouts of `evaluate`, in control steps a second.

    python benchmarks/gym.py [--task lift] [--envs 50] [--steps 48] [--resolution 84] [--repeats 3]

Both step the same pairs by the same actions and look as often, so what differs is Gymnasium's
side: infos, copies of observations, and that episodes are looked at when they end. Once with a
chunk of 16 actions between looks, as policies that predict chunks are evaluated, and once, for a
quarter of the steps, with a look at every step. They take turns, and the median of the ratios of
neighbours is what counts: on a machine with other work only those mean something.
"""

import argparse
import time
from collections.abc import Callable
from statistics import median

import gymnasium
import numpy as np

from jaxcam.config.train import TrainConfig
from jaxcam.envs import env_id
from jaxcam.evaluation.evaluator import Evaluator
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_task
from jaxcam.sim.rollout import Agent, Episodes, rollout

CHUNK = 16


def evaluation(
    args: argparse.Namespace, actions: np.ndarray, steps: int
) -> Callable[[], np.ndarray]:
    """A function that runs the pairs as an evaluation does, and returns where they end."""
    config = resolve(TrainConfig(task=args.task, resolution=args.resolution), accelerator=False)
    evaluator = Evaluator(config, args.envs, args.engine)
    evaluator.task.horizon = steps  # type: ignore[misc]
    pairs = evaluator.pairs("test", range(args.envs))
    K = intrinsics(evaluator.task.fovy_deg, args.resolution)
    views = (*pairs.cameras.shape[:2], 3, 3)
    episodes = Episodes(pairs.start, np.broadcast_to(K, views), pairs.cameras)
    agent = Agent(lambda *_: actions, "eef_delta")

    def run() -> np.ndarray:
        done = rollout(agent, evaluator.task, evaluator.engine, evaluator.renderer, episodes)
        return done.qpos[-1]

    return run


def environments(
    args: argparse.Namespace, actions: np.ndarray, steps: int
) -> Callable[[], np.ndarray]:
    """A function that runs the same pairs as vector environments."""
    envs = gymnasium.make_vec(
        env_id(args.task), num_envs=args.envs, resolution=args.resolution, engine=args.engine,
        horizon=steps, chunk=actions.shape[1], autoreset_mode="Disabled",
    )  # fmt: skip

    def run() -> np.ndarray:
        envs.reset(options={"pair": 0})
        over = np.zeros(args.envs, bool)
        while not over.all():
            *_, terminated, truncated, _ = envs.step(actions)
            over = terminated | truncated
        return envs.unwrapped.batch.now.progress.state.qpos  # type: ignore[attr-defined]

    return run


def main() -> None:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--task", default="lift")
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--envs", type=int, default=50)
    parser.add_argument("--steps", type=int, default=48)
    parser.add_argument("--resolution", type=int, default=84)
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    make_task(args.task).require()
    for chunk, steps in ((CHUNK, args.steps), (1, args.steps // 4)):
        drawn = np.random.default_rng(0).uniform(-0.01, 0.01, (args.envs, chunk, 7))
        runs = evaluation(args, drawn, steps), environments(args, drawn, steps)
        ends = [run() for run in runs]  # compiles, too
        same = np.array_equal(*ends)
        speeds = []
        for _ in range(args.repeats):
            times = []
            for run in runs:
                began = time.perf_counter()
                run()
                times.append(time.perf_counter() - began)
            speeds.append([args.envs * steps / t for t in times])
            print(f"  evaluate {speeds[-1][0]:.0f}, environments {speeds[-1][1]:.0f}", flush=True)
        ratio = median(ours / theirs for theirs, ours in speeds)
        print(
            f"{args.task}, {args.envs} at {args.resolution} pixels, a look every {chunk} steps: "
            f"{ratio:.0%} of evaluate's control steps a second, "
            f"{'the same' if same else 'ANOTHER'} end"
        )


if __name__ == "__main__":
    main()
