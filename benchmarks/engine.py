"""Control steps per second of the native engine against raw MuJoCo and robosuite's loop.

    python benchmarks/engine.py [--tasks lift square] [--batches 1 8 50 200] [--json]
                                [--robosuite-python PATH]

The engine moves the arm on a circle above the objects, with the gripper opening and closing: OSC
pose, 20 Hz control, 25 physics steps a control step, nothing rendered. Its ceiling is raw MuJoCo:
`mj_step` alone on as many worlds and threads, on the same model, from the states that the engine
has reached when its timing begins, the objects at rest on the table. PATH is the Python of an
environment for robosuite's own loop on Lift (see benchmarks/robosuite_loop.py), which is one
process with one environment, as robosuite runs it. Everything is measured in turn in short rounds,
so that other load on the machine falls on all alike; ratios are taken within a round, and the
medians over the rounds count.
"""

import argparse
import json
import os
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from jaxcam.sim import make_task
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command, Start, State

WARM_UP_STEPS = 10
GRASP_FROM_ABOVE = np.array([1.0, 1.0, 0.0]) * np.pi / np.sqrt(2)  # rotation vector


@dataclass
class Case:
    """One row of the table: a task at a batch size."""

    task: str
    start: Start
    scene: Scene
    engine: NativeEngine
    engine_rates: list[float] = field(default_factory=list)
    raw_rates: list[float] = field(default_factory=list)

    @property
    def batch(self) -> int:
        """Number of worlds."""
        return len(self.start.qpos)

    @property
    def ratio(self) -> float:
        """Of raw MuJoCo's rate: the median of the rounds' ratios."""
        return float(np.median(np.divide(self.engine_rates, self.raw_rates)))


def commands(batch: int, steps: int) -> list[Command]:
    """One turn in 60 steps on a circle of 6 cm, each world at its own phase."""
    phase = np.linspace(0, 2 * np.pi, batch, endpoint=False)
    made = []
    for t in range(steps):
        angle = 2 * np.pi * t / 60 + phase
        place = [0.06 * np.cos(angle), 0.06 * np.sin(angle), np.full(batch, 1.05)]
        target = np.concatenate([np.stack(place, -1), np.tile(GRASP_FROM_ABOVE, (batch, 1))], -1)
        made.append(Command(target, np.full(batch, 1.0 if (t // 20) % 2 else -1.0)))
    return made


def engine_rate(engine: NativeEngine, start: Start, steps: int) -> tuple[float, State]:
    """Control steps per second, summed over the worlds of a batch, and where the timing began."""
    state, batch = engine.reset(start), len(start.qpos)
    sequence = commands(batch, WARM_UP_STEPS + steps)
    for command in sequence[:WARM_UP_STEPS]:
        state = engine.step(state, command)
    warm = state
    began = time.perf_counter()
    for command in sequence[WARM_UP_STEPS:]:
        state = engine.step(state, command)
    seconds = time.perf_counter() - began
    if not state.ok.all():
        raise SystemExit("The physics diverged: these numbers would mean nothing.")
    return batch * steps / seconds, warm


def raw_rate(scene: Scene, state: State, steps: int, substeps: int, threads: int) -> float:
    """Control steps per second of `mj_step` alone, gravity held by the motors."""
    worlds = []
    for qpos, qvel in zip(state.qpos, state.qvel, strict=True):
        data = mujoco.MjData(scene.physics)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(scene.physics, data)
        data.ctrl[scene.arm] = data.qfrc_bias[scene.arm]
        mujoco.mj_step(scene.physics, data, nstep=substeps)
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
    parser = argparse.ArgumentParser(description="Speed of the native engine.")
    parser.add_argument("--tasks", nargs="+", default=["lift", "pick_place_can", "square"])
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 50, 200])
    parser.add_argument(
        "--steps", type=int, default=400, help="control steps a round, over a batch"
    )
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--robosuite-python", metavar="PATH")
    parser.add_argument("--json", action="store_true", help="print one JSON object as well")
    args = parser.parse_args()

    cases = []
    for name in args.tasks:
        task = make_task(name)
        scene = task.scene("randomized")
        engine = NativeEngine(scene, "osc_pose", varied=task.varied, threads=args.threads)
        cases += [Case(name, starts(task, scene, range(n)), scene, engine) for n in args.batches]
    robosuite = []
    for _ in range(args.rounds):
        for case in cases:
            steps = max(5, args.steps // case.batch)
            rate, state = engine_rate(case.engine, case.start, steps)
            case.engine_rates.append(rate)
            case.raw_rates.append(
                raw_rate(case.scene, state, steps, case.engine.substeps, args.threads)
            )
        if args.robosuite_python:
            robosuite.append(robosuite_rate(args.robosuite_python))
    report(cases, robosuite, args)


def report(cases: list[Case], robosuite: list[float], args: argparse.Namespace) -> None:
    """Prints the table and, if asked, the JSON."""
    load = os.getloadavg()[0]
    print(f"{args.threads} threads, {os.cpu_count()} cores, load average {load:.1f}, medians of")
    print(f"{args.rounds} rounds, control steps per second:")
    print(
        f"  {'task':16}{'batch':>6}{'engine':>10}{'raw mj_step':>13}{'ratio':>8}{'x robosuite':>13}"
    )
    rows = []
    for case in cases:
        row = {
            "task": case.task,
            "batch": case.batch,
            "engine": float(np.median(case.engine_rates)),
            "raw_mj_step": float(np.median(case.raw_rates)),
            "of_raw": case.ratio,
        }
        beside = ""
        if robosuite and case.task == "lift":
            row["of_robosuite"] = float(np.median(np.divide(case.engine_rates, robosuite)))
            beside = f"{row['of_robosuite']:13.1f}"
        rows.append(row)
        print(
            f"  {case.task:16}{case.batch:6}{row['engine']:10.0f}{row['raw_mj_step']:13.0f}"
            f"{row['of_raw']:8.2f}{beside}"
        )
    if robosuite:
        print(f"  robosuite's own loop, lift: {np.median(robosuite):.0f}")
    if args.json:
        print(json.dumps({"threads": args.threads, "load": load, "rows": rows}))


if __name__ == "__main__":
    main()
