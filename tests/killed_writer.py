"""A writer of tiny demonstrations that is killed again and again: no finished one may be lost.

    python tests/killed_writer.py 500    # so many kills; says how many episodes they came after

Each child is a fork that goes on with the dataset, names every episode whose `append` returned,
and is killed at a random moment. After each kill the dataset must hold all that were named.
"""

import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxcam.data.demos import Demo, Demos, Header, read_demos
from jaxcam.data.writer import DemoWriter

EPISODES = 8
NQ, NV = 16, 15


def header():
    """Of a dataset with one camera and `EPISODES` demonstrations of Lift."""
    return Header(
        task="lift", scene="fixed", n=1, m=0, seed=0, train=EPISODES, valid=0, fovy_deg=45.0,
        nq=NQ, nv=NV, world_from_camera=np.eye(4)[None], versions={"jaxcam": "0"},
    )  # fmt: skip


def tiny(seed):
    """A demonstration of a few steps whose numbers are told by its seed."""
    rng = np.random.default_rng(seed)
    steps = 5 + seed
    states = rng.random((steps + 1, 1 + NQ + NV))
    states[:, 13:17] = [1, 0, 0, 0]
    return Demo(
        seed=seed,
        nq=NQ,
        states=states,
        actions=rng.random((steps, 7)),
        eef_pos=rng.random((steps + 1, 3)),
        eef_quat=np.tile([0.0, 0, 0, 1], (steps + 1, 1)),
        gripper=np.ones(steps + 1),
        geom_size=np.full((1, 3), 0.02),
        fixtures=np.tile([0, 0, 0, 1.0, 0, 0, 0], (2, 1)),
        cameras=np.zeros(1, int),
    )


def write(path, pipe=None):
    """Goes on with the dataset; writes the index of each finished episode to a pipe."""
    with DemoWriter(path, header()) as writer:
        for i in sorted(set(range(EPISODES)) - writer.done):
            writer.append(i, tiny(i))
            if pipe is not None:
                os.write(pipe, bytes([i]))
        writer.finish()


@dataclass
class Kills:
    """What became of some kills."""

    after: list[int]
    """Episodes that were finished at each."""
    completed: int
    """Datasets that were completed in between."""


def killed(path: Path, kills: int, seed: int = 0) -> Kills:
    """Kills a writer so often, and checks after each that nothing finished is lost."""
    rng, outcome = np.random.default_rng(seed), Kills([], 0)
    finished: set[int] = set()
    started = time.monotonic()
    write(path.with_name("timed.hdf5"))
    longest = 1.2 * (time.monotonic() - started)
    while len(outcome.after) < kills:
        reads, writes = os.pipe()
        child = os.fork()
        if not child:
            try:
                write(path, writes)
            finally:
                os._exit(0)
        os.close(writes)
        # Half of the kills come soon, since whoever goes on has less to do each time.
        time.sleep(rng.uniform(0, longest if rng.random() < 0.5 else longest / EPISODES))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        with os.fdopen(reads, "rb") as named:
            finished |= set(named.read())
        if os.WIFSIGNALED(status):
            outcome.after.append(len(finished))
        if path.exists():
            demos = read_demos(path)
            require_equal(demos)
            outcome.completed += 1
            finished = set()
            path.unlink()
            continue
        with DemoWriter(path, header()) as writer:
            if not finished <= writer.done:
                raise AssertionError(f"lost {finished - writer.done} after {outcome.after[-1:]}")
    write(path)
    require_equal(read_demos(path))
    return outcome


def require_equal(demos: Demos) -> None:
    """Every episode is the one that was written."""
    for i, demo in enumerate(demos.episodes):
        for name, array in tiny(i).arrays().items():
            np.testing.assert_array_equal(demo.arrays()[name], array)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        result = killed(Path(folder) / "killed.hdf5", int(sys.argv[1]))
    counts = np.bincount(result.after, minlength=EPISODES + 1)
    print(f"{len(result.after)} kills lost no episode; {result.completed} datasets were completed")
    print(f"kills after 0 to {EPISODES} finished episodes: {counts.tolist()}")
