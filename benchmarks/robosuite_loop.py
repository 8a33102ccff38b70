"""Control steps per second of robosuite's own Lift environment, as a baseline for our engine.

robosuite's environments need an older MuJoCo and an older NumPy than jaxcam, so run this in an
environment of its own::

    python3.11 -m venv robosuite-env
    robosuite-env/bin/pip install robosuite==1.5.2 mujoco==3.9.0
    robosuite-env/bin/python benchmarks/robosuite_loop.py --steps 400 --repeats 7 > loop.json

One environment, one process, as robosuite runs it: Panda, OSC pose with absolute world targets,
20 Hz control, 25 physics substeps a control step, no cameras and no rendering. The target glides on
a circle above the cube and the gripper opens and closes. Numba's functions are compiled before the
clock starts. The report on standard output is one JSON object; ``steps_per_second`` is the median
over the repeats. Time spent in resets is left out: it would only flatter a comparison.
"""

import argparse
import json
import os
import platform
import statistics
import time
from typing import Any

import mujoco
import numpy as np
import robosuite
from robosuite.controllers import load_composite_controller_config

WARM_UP_STEPS = 20
DOWN_ROTVEC = np.array([1.0, 1.0, 0.0]) * np.pi / np.sqrt(2)  # grasp from above


def make_env(horizon: int) -> Any:
    """Lift with absolute world-frame OSC and nothing to render."""
    config: Any = load_composite_controller_config(robot="Panda")
    config["body_parts"]["right"].update(input_type="absolute", input_ref_frame="world")
    return robosuite.make(
        "Lift",
        robots="Panda",
        controller_configs=config,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=20,
        horizon=horizon,
        seed=0,
    )


def actions(steps: int) -> np.ndarray:
    """A circle of 6 cm radius above the cube, one turn in 60 steps, toggling the gripper."""
    t = np.arange(steps)
    angle = 2 * np.pi * t / 60
    position = np.stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), np.full(steps, 0.95)], axis=-1)
    gripper = np.where((t // 20) % 2 == 0, -1.0, 1.0)
    rotation = np.broadcast_to(DOWN_ROTVEC, (steps, 3))
    return np.concatenate([position, rotation, gripper[:, None]], axis=-1)


def measure(steps: int, repeats: int) -> list[float]:
    """Control steps per second of every repeat, each one episode after a reset."""
    env = make_env(horizon=steps + WARM_UP_STEPS + 1)
    sequence = actions(steps + WARM_UP_STEPS)
    rates = []
    for _ in range(repeats):
        env.reset()
        for action in sequence[:WARM_UP_STEPS]:
            env.step(action)
        start = time.perf_counter()
        for action in sequence[WARM_UP_STEPS:]:
            env.step(action)
        rates.append(steps / (time.perf_counter() - start))
    return rates


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description="Speed of robosuite's own Lift loop.")
    parser.add_argument("--steps", type=int, default=400, help="timed control steps a repeat")
    parser.add_argument("--repeats", type=int, default=7, help="repeats; the median counts")
    args = parser.parse_args()
    if args.steps < 1 or args.repeats < 1:
        parser.error("--steps and --repeats must be at least 1")
    rates = measure(args.steps, args.repeats)
    report = {
        "what": "robosuite Lift, OSC_POSE absolute, one environment, no rendering",
        "steps_per_second": round(statistics.median(rates), 1),
        "repeats": [round(rate, 1) for rate in rates],
        "steps": args.steps,
        "robosuite": robosuite.__version__,
        "mujoco": mujoco.__version__,
        "python": platform.python_version(),
        "cpu_count": os.cpu_count(),
        "load_average": round(os.getloadavg()[0], 2),
    }
    print(json.dumps(report))


if __name__ == "__main__":
    main()
