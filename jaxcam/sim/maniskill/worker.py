"""The child process: worlds of one ManiSkill environment, and what draws them.

Started by `jaxcam.sim.maniskill.pool` as `python -m jaxcam.sim.maniskill.worker`. It answers
requests that come through a pipe, with arrays in shared memory. What is stepped is never drawn, and
what is drawn never stepped.
"""

import faulthandler
import json
import signal
import sys
import traceback
from multiprocessing.connection import Connection

import numpy as np

from jaxcam.sim.maniskill.memory import Memory, Sizes, open_memory
from jaxcam.sim.maniskill.studio import Asked, Studio
from jaxcam.sim.maniskill.worlds import CONTROL_MODE, Assignment, BatchedWorlds, SeparateWorlds


class Worker:
    """Answers requests; each is a method here.

    Args:
        to: What it is for.
        memory: Shared with the parent.
    """

    def __init__(self, to: Assignment, memory: Memory) -> None:
        self._to, self._memory = to, memory
        self._worlds = BatchedWorlds(to) if to.on_gpu else SeparateWorlds(to)
        self._studio: Studio | None = None

    def hello(self) -> dict[str, float]:
        """How far (m) fingers are told to open and close, and the steps of a second."""
        self._make_room(1)
        env = self._worlds.env
        gripper = env.agent.controllers[CONTROL_MODE].configs["gripper"]
        return {
            "open": gripper.upper,
            "closed": gripper.lower,
            "control_hz": env.control_freq,
            "substeps": env.sim_freq // env.control_freq,
        }

    def load(self, numbers: list[int]) -> None:
        """Puts worlds at the states asked, whatever they did before."""
        rows = np.array(numbers)
        self._make_room(max(numbers) + 1)
        self._worlds.load(rows, self._asked(rows))
        self._tell(rows)

    def step(self, numbers: list[int]) -> None:
        """One control step of worlds, from the states asked to the targets asked."""
        rows = np.array(numbers)
        self._make_room(max(numbers) + 1)
        asked, (there, _) = self._asked(rows), self._worlds.read(rows)
        elsewhere = (asked != there).any(-1)
        if elsewhere.any():
            self._worlds.load(rows[elsewhere], asked[elsewhere])
        self._worlds.step(rows, self._memory.targets[rows])
        self._tell(rows)

    def draw(self, count: int, height: int, width: int, layers: bool) -> list[str]:
        """Draws the first `count` views asked.

        Returns:
            Names of the segments, by their number; none unless asked for layers.
        """
        memory = self._memory
        asked = Asked(*(x[:count] for x in (memory.qpos, memory.fixtures, memory.K, memory.camera)))
        studio = self._studio
        if studio is None or not studio.suits(height, width, asked.K):
            if studio is not None:
                studio.close()
            self._studio = studio = Studio(self._to, height, width, asked.K)
        room = memory.layers(count, height, width)
        for first in range(0, count, studio.batch):
            part = slice(first, first + studio.batch)
            drawn = studio.draw(Asked(*(x[part] for x in asked)), layers=layers)
            for out, picture in zip(room, drawn, strict=False):
                out[part] = picture
            memory.beat[0] += 1
        return studio.segments() if layers else []

    def _make_room(self, width: int) -> None:
        while self._worlds.width < width:
            self._worlds.grow(width)
            self._memory.beat[0] += 1

    def _asked(self, rows: np.ndarray) -> np.ndarray:
        return np.concatenate([self._memory.qpos[rows], self._memory.qvel[rows]], -1)

    def _tell(self, rows: np.ndarray) -> None:
        memory = self._memory
        states, memory.grip[rows] = self._worlds.read(rows)
        memory.qpos_now[rows], memory.qvel_now[rows] = np.split(states, [self._to.sizes.nq], -1)
        memory.beat[0] += 1


def main() -> None:
    """The child's life: requests until the parent closes its end."""
    faulthandler.enable()  # a crash in SAPIEN says where
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    pipe, file = Connection(int(sys.argv[1])), int(sys.argv[2])
    settings = json.loads(sys.argv[3])
    to = Assignment(**{**settings, "sizes": Sizes(**settings["sizes"])})
    memory = open_memory(file, to.sizes)
    worker: Worker | None = None
    while True:
        try:
            name, *args = pipe.recv()
        except EOFError:
            return
        try:
            worker = worker or Worker(to, memory)
            pipe.send((True, getattr(worker, name)(*args)))
        except Exception:
            pipe.send((False, traceback.format_exc()))


if __name__ == "__main__":
    main()
