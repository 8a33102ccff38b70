"""MJX on this machine: steps per second, what the compiled rollouts need, demonstrations replayed.

    python benchmarks/mjx.py speed [--engines native mjx-warp mjx-jax] [--batch 64]
    python benchmarks/mjx.py program [--engines mjx-warp mjx-jax] [--rollouts 50 500 1500]
    python benchmarks/mjx.py replay DATASET... [--engines native mjx-warp] [--demos 20]

`speed` moves the arm over the table, fingers opening and closing, and compares physics steps per
CPU-second, which other processes do not change much, with raw `mj_step`. `program` lowers and
compiles a whole open-loop rollout (reset, every control step with its controller, success,
freezing) and asks XLA what it costs; it runs nothing. XLA counts the body of a loop once: FLOPs are
those of one physics step. `replay` executes expert demonstrations, open loop, from the state they
began in.
"""

import argparse
import os
import time
from pathlib import Path
from typing import get_args

import jax
import mujoco
import numpy as np

from jaxcam.config.names import TaskName
from jaxcam.data.batches import demo_actions
from jaxcam.data.demos import read_demos, starts_of
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import make_engine, make_task
from jaxcam.sim.actions import decode, measured
from jaxcam.sim.engine import Engine, OpenLoop
from jaxcam.sim.maniskill.task import ManiSkillTask
from jaxcam.sim.mujoco.mjx import MjxEngine
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command, Start, State

OPEN_LOOP = OpenLoop()


def commands(state: State, steps: int) -> Command:
    """Circles of 5 cm, each world at its own phase [B, T, ...]."""
    pose = np.concatenate([state.grip_position, rotvec_from_matrix(state.grip_rotation)], -1)
    angle = np.arange(steps)[None, :] / 8 + np.arange(len(pose))[:, None]
    target = np.repeat(pose[:, None], steps, 1)
    target[..., 0] += 0.05 * np.sin(angle)
    target[..., 1] += 0.05 * np.cos(angle)
    return Command(target, np.sign(np.sin(angle)))


def raw_rate(engine: Engine, start: Start, steps: int) -> float:
    """Steps per CPU-second of `mj_step` alone, gravity held by the motors."""
    model = engine.scene.physics
    worlds = []
    for qpos in start.qpos:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        data.ctrl[engine.scene.arm] = data.qfrc_bias[engine.scene.arm]
        worlds.append(data)
    began = time.process_time()
    for data in worlds:
        mujoco.mj_step(model, data, nstep=steps)
    return len(worlds) * steps / (time.process_time() - began)


def speed(args: argparse.Namespace) -> None:
    print(f"Physics steps/s, batch {args.batch}, {os.cpu_count()} cores, load {os.getloadavg()}")
    for name in args.tasks:
        task = make_task(name)
        scene = task.scene("randomized")
        start = starts(task, scene, range(args.batch))
        raw = None
        for which in args.engines:
            engine = make_engine(which, scene, "osc_pose", task.varied)
            raw = raw or raw_rate(engine, start, 50)
            state = engine.reset(start)
            chunk = commands(state, args.steps)
            began = time.perf_counter()
            engine.run(OPEN_LOOP, chunk, start, task.success_in(scene), args.steps)
            first = time.perf_counter() - began
            began, busy = time.perf_counter(), time.process_time()
            engine.run(OPEN_LOOP, chunk, start, task.success_in(scene), args.steps)
            seconds, busy = time.perf_counter() - began, time.process_time() - busy
            done = args.batch * args.steps * engine.substeps
            print(
                f"  {name:15} {which:9} {done / seconds:8.0f}, {done / busy:6.0f} a CPU-second, "
                f"{done / busy / raw:6.3f} of mj_step's {raw:.0f}; first call {first:.1f} s",
                flush=True,
            )


def _shape(*shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, np.float32)


def program(args: argparse.Namespace) -> None:
    for name in args.tasks:
        task = make_task(name)
        scene = task.scene("randomized")
        for which in args.engines:
            engine = make_engine(which, scene, "osc_pose", task.varied)
            assert isinstance(engine, MjxEngine)
            for count in args.rollouts:
                one = task.start(scene, 0)
                start = Start(*(_shape(count, *x.shape) for x in one))
                chunk = Command(_shape(count, task.horizon, 6), _shape(count, task.horizon))
                began = time.perf_counter()
                lowered = engine.lower(
                    OPEN_LOOP, chunk, start, task.success_in(scene), task.horizon
                )
                cost = lowered.cost_analysis() or {}
                line = f"  {name:15} {which:9} {count:5} rollouts, {task.horizon} control steps: "
                if which == "mjx-jax":  # Warp's kernels are opaque to XLA
                    line += f"{cost['flops'] / 1e9:.3f} GFLOP, "
                    line += f"{cost['bytes accessed'] / 1e9:.3f} GB touched a physics step; "
                if which == "mjx-warp" or args.compile:
                    memory = lowered.compile().memory_analysis()
                    for part in ("argument", "output", "temp"):
                        size = getattr(memory, f"{part}_size_in_bytes") / 1e6
                        line += f"{part} {size:.1f} MB, "
                print(f"{line}{time.perf_counter() - began:.0f} s", flush=True)
    print("GPU speed is unmeasured: no GPU was at hand.")


def replay(args: argparse.Namespace) -> None:
    for path in args.dataset:
        data = read_demos(Path(path))
        task, scene = data.task, data.world
        demos = data.episodes[: args.demos]
        start = starts_of(demos)
        for which in args.engines:
            engine = make_engine(which, scene, "osc_pose", task.varied)
            state = engine.reset(start)
            moves = np.zeros((len(demos), max(d.length for d in demos) + 20, 7))
            for row, demo in zip(moves, demos, strict=True):
                row[: demo.length] = demo_actions(demo, "eef_delta", scene)
                row[demo.length :, -1] = demo.actions[-1, -1]
            anchor = np.asarray(measured("eef_delta", state, scene.arm), float)
            chunk = Command(*decode("eef_delta", moves, anchor, scene.nominal_grip))
            began = time.perf_counter()
            progress, _ = engine.run(
                OPEN_LOOP, chunk, start, task.success_in(scene), moves.shape[1]
            )
            success, ok = np.asarray(progress.success), np.asarray(progress.state.ok)
            print(
                f"  {task.name:15} {which:9} {success.sum()} of {len(demos)} succeed, "
                f"{(~ok).sum()} diverged, {time.perf_counter() - began:.0f} s",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_subparsers(required=True)
    for run, engines in (
        (speed, ["native", "mjx-warp"]),
        (program, ["mjx-warp"]),
        (replay, ["native", "mjx-warp"]),
    ):
        sub = what.add_parser(run.__name__)
        sub.set_defaults(run=run)
        sub.add_argument("--engines", nargs="+", default=engines)
        if run is replay:
            sub.add_argument("dataset", nargs="+")
            sub.add_argument("--demos", type=int, default=20)
            continue
        tasks = [
            name for name in get_args(TaskName) if not isinstance(make_task(name), ManiSkillTask)
        ]
        sub.add_argument("--tasks", nargs="+", default=tasks)
        if run is program:
            sub.add_argument("--compile", action="store_true", help="mjx-jax too: takes minutes")
            sub.add_argument("--rollouts", nargs="+", type=int, default=[50, 500, 1500])
        else:
            sub.add_argument("--batch", type=int, default=64)
            sub.add_argument("--steps", type=int, default=4, help="control steps timed")
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
