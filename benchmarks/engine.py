"""Control steps per second of the native engine on Lift, against raw MuJoCo and robosuite's loop.

    python benchmarks/engine.py [--batches 1 8 50 200] [--robosuite-python PATH] [--json]

Engine and robosuite move the arm on a circle above the cube, with the gripper opening and closing:
OSC pose, 20 Hz control, 25 physics steps a control step, nothing rendered. Raw MuJoCo is `mj_step`
alone on the same model, as many worlds as the largest batch on the same threads: the ceiling. PATH
is the Python of an environment for robosuite's own loop (see benchmarks/robosuite_loop.py), which
is one process with one environment, as robosuite runs it. Everything is measured in turn, round by
round; the medians over the rounds count, and ratios are taken within a round.
"""

import argparse
import json
import os
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from jaxcam.sim import make_task
from jaxcam.sim.engine import Command, Start
from jaxcam.sim.native import NativeEngine
from jaxcam.sim.scene import Scene, build_scene
from jaxcam.sim.task import starts

WARM_UP_STEPS = 3
GRASP_FROM_ABOVE = np.array([1.0, 1.0, 0.0]) * np.pi / np.sqrt(2)  # rotation vector


def commands(batch: int, steps: int) -> list[Command]:
    """One turn in 60 steps on a circle of 6 cm, each world at its own phase."""
    phase = np.linspace(0, 2 * np.pi, batch, endpoint=False)
    made = []
    for t in range(steps):
        angle = 2 * np.pi * t / 60 + phase
        place = [0.06 * np.cos(angle), 0.06 * np.sin(angle), np.full(batch, 0.95)]
        target = np.concatenate([np.stack(place, -1), np.tile(GRASP_FROM_ABOVE, (batch, 1))], -1)
        made.append(Command(target, np.full(batch, 1.0 if (t // 20) % 2 else -1.0)))
    return made


def engine_rate(engine: NativeEngine, start: Start, steps: int) -> float:
    """Control steps per second, summed over the worlds of a batch."""
    state, batch = engine.reset(start), len(start.qpos)
    sequence = commands(batch, WARM_UP_STEPS + steps)
    for command in sequence[:WARM_UP_STEPS]:
        state = engine.step(state, command)
    began = time.perf_counter()
    for command in sequence[WARM_UP_STEPS:]:
        state = engine.step(state, command)
    seconds = time.perf_counter() - began
    if not state.ok.all():
        raise SystemExit("The physics diverged: these numbers would mean nothing.")
    return batch * steps / seconds


def raw_rate(scene: Scene, start: Start, steps: int, substeps: int, threads: int) -> float:
    """Control steps per second of `mj_step` alone: worlds at rest, gravity held by the motors."""
    worlds = []
    for qpos in start.qpos:
        data = mujoco.MjData(scene.physics)
        data.qpos[:] = qpos
        mujoco.mj_forward(scene.physics, data)
        data.ctrl[scene.arm] = data.qfrc_bias[scene.arm]
        worlds.append(data)

    def run(share: list[mujoco.MjData]) -> None:
        for data in share:
            mujoco.mj_step(scene.physics, data, nstep=steps * substeps)

    with ThreadPoolExecutor(threads) as pool:
        shares = [worlds[i::threads] for i in range(threads)]
        began = time.perf_counter()
        list(pool.map(run, shares))
        return len(worlds) * steps / (time.perf_counter() - began)


def robosuite_rate(python: str) -> float:
    """Control steps per second of robosuite's own loop, in its own environment."""
    script = Path(__file__).with_name("robosuite_loop.py")
    command = [python, str(script), "--steps", "200", "--repeats", "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{python} could not run {script.name}:\n{done.stderr}")
    return float(json.loads(done.stdout.strip().splitlines()[-1])["steps_per_second"])


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of the native engine on Lift.")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 50, 200])
    parser.add_argument("--steps", type=int, default=2000, help="control steps timed, over a batch")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--robosuite-python", metavar="PATH")
    parser.add_argument("--json", action="store_true", help="print one JSON object as well")
    args = parser.parse_args()

    task = make_task("lift")
    scene = build_scene(task.objects(), "randomized")
    engine = NativeEngine(scene, "osc_pose", varied=task.varied, threads=args.threads)
    many = {batch: starts(task, scene, range(batch)) for batch in args.batches}
    largest = max(args.batches)
    rates: dict[str, list[float]] = {}
    for _ in range(args.rounds):
        row = {
            f"native engine, batch {batch}": engine_rate(
                engine, start, max(10, args.steps // batch)
            )
            for batch, start in many.items()
        }
        row["raw mj_step"] = raw_rate(
            scene, many[largest], max(10, args.steps // largest), engine.substeps, args.threads
        )
        if args.robosuite_python:
            row["robosuite's loop"] = robosuite_rate(args.robosuite_python)
        for name, rate in row.items():
            rates.setdefault(name, []).append(rate)
    report(rates, args)


def report(rates: dict[str, list[float]], args: argparse.Namespace) -> None:
    """Prints the table and, if asked, the JSON."""

    def times(over: str) -> dict[str, float]:
        """How many times faster than `over` each is: medians of the rounds' ratios."""
        under = np.array(rates[over])
        return {n: float(np.median(np.array(r) / under)) for n, r in rates.items()}

    columns = {"of raw mj_step": times("raw mj_step")}
    if "robosuite's loop" in rates:
        columns["x robosuite"] = times("robosuite's loop")
    cores, load = os.cpu_count(), os.getloadavg()[0]
    print(f"Lift, {args.threads} threads, {cores} cores, load average {load:.1f}:")
    print(f"  {'':26} {'control steps/s':>16}" + "".join(f"{c:>16}" for c in columns))
    for name, values in rates.items():
        cells = "".join(f"{ratio[name]:16.2f}" for ratio in columns.values())
        print(f"  {name:26} {np.median(values):16.0f}{cells}")
    if args.json:
        found: dict[str, Any] = {
            "what": "control steps per second of Lift, medians over rounds",
            "threads": args.threads,
            "rates": {n: float(np.median(r)) for n, r in rates.items()},
            "ratios": columns,
        }
        print(json.dumps(found))


if __name__ == "__main__":
    main()
