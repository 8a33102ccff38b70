"""Control steps per second of the ManiSkill bridge, against ManiSkill itself.

    python benchmarks/maniskill.py [--task push] [--worlds 8] [--children 2] [--chunk 16]
                                   [--size 128] [--steps 16] [--rounds 5]

Worlds follow a circle above the table with the OSC pose controller. Counted are control steps of
all worlds together: with a picture of each world at every step, and with one per chunk, as a policy
that executes whole chunks asks for them. ManiSkill's own loop is one environment, `env.step` with
one RGB camera of the same size, in a process of its own. All are measured in turn, round by round,
so that other load on the machine falls on all alike; ratios are taken within a round and the median
over the rounds counts. What each takes of the processors' time is told as well.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxcam.rays import sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import make_task
from jaxcam.sim.maniskill import machine
from jaxcam.sim.maniskill.engine import SapienEngine
from jaxcam.sim.maniskill.pool import Pool
from jaxcam.sim.maniskill.render import SapienPainter
from jaxcam.sim.maniskill.scene import scene_of
from jaxcam.sim.maniskill.task import ManiSkillTask
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command, Start, State, View

OWN = """
import sys, time, gymnasium, torch, jaxcam.sim.maniskill.envs
env = gymnasium.make(sys.argv[1], scene="randomized", resolution=int(sys.argv[2]), obs_mode="rgb",
                     sim_backend="physx_cpu", render_backend=sys.argv[3],
                     control_mode="pd_joint_pos")
env.reset(seed=0)
action = torch.zeros(8)
action[:7] = env.unwrapped.agent.robot.get_qpos()[0, :7]
env.step(action)
for line in sys.stdin:
    steps = int(line)
    began, busy = time.perf_counter(), time.process_time()
    for _ in range(steps):
        env.step(action)
    print(steps / (time.perf_counter() - began), steps / (time.process_time() - busy), flush=True)
"""


class Case:
    """Worlds of a task in a number of child processes."""

    def __init__(self, task: ManiSkillTask, args: argparse.Namespace, children: int) -> None:
        world = scene_of(task, "randomized")
        self._pool = Pool(world, most=children)
        self._engine = SapienEngine(world, "osc_pose", pool=self._pool)
        self._painter = SapienPainter(world, args.size, pool=self._pool)
        self._start: Start = starts(task, world, range(args.worlds))
        self._state: State = self._engine.reset(self._start)
        K = intrinsics(task.fovy_deg, args.size)
        self._K = np.repeat(K[None], args.worlds, 0)
        self._cameras = sample_poses(task.cameras, args.worlds, 1)
        self.run(2, 1)  # compiles the shaders

    def run(self, steps: int, period: int) -> tuple[float, float]:
        """Control steps per second of all worlds, and per second of processor time in children.

        Args:
            steps: Of each world.
            period: Steps between pictures.
        """
        self._state = self._engine.reset(self._start)
        middle = self._state.grip_position
        axes = rotvec_from_matrix(self._state.grip_rotation)
        began, busy = time.perf_counter(), self._busy()
        for t in range(steps):
            if t % period == 0:
                self._draw()
            aside = 0.05 * np.array([np.cos(t / 5) - 1, np.sin(t / 5), 0.4])
            pose = np.concatenate([middle + aside, axes], -1)
            self._state = self._engine.step(self._state, Command(pose, np.ones(len(pose))))
        done = steps * len(middle)
        return done / (time.perf_counter() - began), done / (self._busy() - busy)

    def _draw(self) -> None:
        start, state = self._start, self._state
        view = View(state.qpos, start.geom_size, start.fixtures, self._K, self._cameras)
        self._painter.rgb(view)

    def _busy(self) -> float:
        """Processor time (s) of the children so far."""
        ticks = 0
        for child in self._pool.children(10**6):
            if child.pid:
                fields = Path(f"/proc/{child.pid}/stat").read_text().rpartition(")")[2].split()
                ticks += int(fields[11]) + int(fields[12])
        return ticks / 100


def own(task: ManiSkillTask, size: int) -> Callable[[int], tuple[float, float]]:
    """ManiSkill's loop as a function of a number of steps; rates as `Case.run` gives them."""
    args = (task.env, str(size), machine.device().kind)
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", OWN, *args], text=True,
        env=machine.child_environment(),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert process.stdin is not None
    assert process.stdout is not None
    asked, answers = process.stdin, process.stdout

    def run(steps: int) -> tuple[float, float]:
        asked.write(f"{steps}\n")
        asked.flush()
        rate, busy = answers.readline().split()
        return float(rate), float(busy)

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--task", default="push")
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--children", type=int, default=2)
    parser.add_argument("--chunk", type=int, default=16)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--steps", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    task = make_task(args.task)
    if not isinstance(task, ManiSkillTask):
        parser.error(f"{args.task} is not one of ManiSkill's tasks")
    task.require()
    one, several = Case(task, args, 1), Case(task, args, args.children)
    reference = own(task, args.size)
    chunks = args.chunk * max(1, args.steps // args.chunk)
    programs: dict[str, Callable[[], tuple[float, float]]] = {
        "ManiSkill, a picture a step": lambda: reference(args.steps),
        "one child, a picture a step": lambda: one.run(args.steps, 1),
        f"{args.children} children, a picture a step": lambda: several.run(args.steps, 1),
        "one child, a picture a chunk": lambda: one.run(chunks, args.chunk),
        f"{args.children} children, a picture a chunk": lambda: several.run(chunks, args.chunk),
    }
    rates: dict[str, list[tuple[float, float]]] = {name: [] for name in programs}
    for _ in range(args.rounds):
        for name, program in programs.items():
            rates[name].append(program())
    print(f"{args.task}, {args.worlds} worlds, {args.size} px, {machine.device().name}")
    print(f"{'control steps':34} {'per s':>8} {'per CPU s':>10} {'x first':>8}")
    first = np.array(rates[next(iter(rates))])[:, 0]
    for name, measured in rates.items():
        rate, busy = np.array(measured).T
        print(
            f"{name:34} {np.median(rate):8.1f} {np.median(busy):10.1f} "
            f"{np.median(rate / first):8.2f}"
        )
    for kind in ("step", "chunk"):
        many = np.array(rates[f"{args.children} children, a picture a {kind}"])[:, 0]
        ratio = np.median(many / np.array(rates[f"one child, a picture a {kind}"])[:, 0])
        print(f"{args.children} children over one, a picture a {kind}: {ratio:.2f} times")


if __name__ == "__main__":
    main()
