"""Does a training survive SIGKILL at any moment, and a flipped byte anywhere in a checkpoint?

Trains a small ACT once without interruption, then once more with kills at random moments, each
followed by the same command. After every kill all checkpoints that are there must hold what the
uninterrupted run saved at their step, and none that was seen before may be missing. Then one byte
is flipped at each of many random places of the last checkpoints, every byte being as likely.

    python benchmarks/survive.py --kills 30 --flips 30

Needs the usual installation; about 30 starts of `python -m jaxcam.train`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from jaxcam.files.jsonl import read_jsonl
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.digests import DamagedError, read_all

STEPS, SAVE_EVERY = 800, 4
FLAGS = {
    "demos": 4, "validation": 2, "resolution": 24, "batch": 2, "pairs": 1, "log_every": 2,
    "eval_every": 100, "steps": STEPS, "save_every": SAVE_EVERY, "keep": STEPS,
}  # fmt: skip


class Training:
    """A run of `python -m jaxcam.train` in a folder of its own."""

    def __init__(self, folder: Path, data: Path) -> None:
        self.folder = folder
        words = [x for k, v in FLAGS.items() for x in ("--" + k.replace("_", "-"), str(v))]
        self._command = [
            sys.executable, "-m", "jaxcam.train", *words, "--data-dir", str(data),
            "--run-dir", str(folder),
        ]  # fmt: skip
        self._log = folder.with_suffix(".log")
        # The uninterrupted run compiles; the others start sooner.
        self._environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(data / "compiled")}

    def start(self) -> subprocess.Popen[bytes]:
        """The command, begun."""
        with open(self._log, "ab") as log:
            return subprocess.Popen(
                self._command, stdout=log, stderr=subprocess.STDOUT, env=self._environment
            )

    def digests(self, steps: Iterable[int]) -> dict[int, dict[str, list]]:
        """What checkpoints hold; `DamagedError` if one is not what was written."""
        places = {step: self.folder / "checkpoints" / str(step) for step in steps}
        return {step: read_all(place)[0]["leaves"] for step, place in places.items()}

    def words(self) -> str:
        """All that was printed."""
        return self._log.read_text(errors="replace")


def kill_at_random(training: Training, kills: int, whole: dict, rng: np.random.Generator) -> None:
    """Kills a training so often, looking at its checkpoints each time, and lets it end."""
    known: set[int] = set()
    began = time.monotonic()
    process = training.start()
    for number in range(1, kills + 1):
        first = max(known, default=0)
        # Half of the moments are anywhere in a start, half while updates and saves go on.
        if rng.random() < 0.5:
            time.sleep(rng.uniform(0, 20))
        else:
            while process.poll() is None and max(checkpoint_steps(training.folder), default=0) <= (
                first
            ):
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.7))
        if process.poll() is not None:
            sys.exit(f"ended before kill {number}: {training.words()[-2000:]}")
        process.kill()
        process.wait()
        there = set(checkpoint_steps(training.folder))
        digests = training.digests(there - known)  # `DamagedError` ends this
        wrong = [step for step, leaves in digests.items() if leaves != whole[step]]
        lost = sorted(known - there)
        half = len(list((training.folder / "checkpoints").glob("*tmp*")))
        print(f"kill {number:2}: {len(there)} checkpoints, newest {max(there, default=0)}, "
              f"{half} half-written, {len(wrong)} wrong, {len(lost)} lost "
              f"({time.monotonic() - began:.0f} s)", flush=True)  # fmt: skip
        if wrong or lost:
            sys.exit(f"wrong: {wrong}, lost: {lost}")
        known = there
        process = training.start()
    if process.wait():
        sys.exit(f"failed after the last kill: {training.words()[-2000:]}")


def flip_bytes(training: Training, flips: int, rng: np.random.Generator) -> int:
    """How many of so many flipped bytes are noticed; each is flipped back."""
    folders = [training.folder / "checkpoints" / str(s) for s in checkpoint_steps(training.folder)]
    files = [p for folder in folders[-10:] for p in sorted(folder.rglob("*")) if p.is_file()]
    sizes = np.array([p.stat().st_size for p in files])
    noticed = 0
    for _ in range(flips):
        file = files[rng.choice(len(files), p=sizes / sizes.sum())]
        folder = next(f for f in folders if f in file.parents)
        data = file.read_bytes()
        place, bit = rng.integers(len(data)), 1 << rng.integers(8)
        file.write_bytes(data[:place] + bytes([data[place] ^ bit]) + data[place + 1 :])
        try:
            read_all(folder)
            print(f"NOT NOTICED: byte {place} of {file.relative_to(training.folder)}")
        except DamagedError:
            noticed += 1
        file.write_bytes(data)
    return noticed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--flips", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = Training(folder / "whole", folder / "data")
        if whole.start().wait():
            sys.exit(whole.words()[-2000:])
        expected = whole.digests(checkpoint_steps(whole.folder))
        print(f"uninterrupted: {len(expected)} checkpoints", flush=True)
        killed = Training(folder / "killed", folder / "data")
        kill_at_random(killed, args.kills, expected, rng)
        same = killed.digests(checkpoint_steps(killed.folder)) == expected
        rows = [[{k: v for k, v in row.items() if k != "seconds"} for row in
                 read_jsonl(run.folder / "metrics.jsonl")] for run in (whole, killed)]  # fmt: skip
        damaged = (killed.folder / "damaged").exists()
        print(f"after {args.kills} kills: all {len(expected)} checkpoints bit-equal: {same}; "
              f"metrics equal: {rows[0] == rows[1]}; any set aside as damaged: {damaged}; "
              f"starts: {(killed.folder / 'command.txt').read_text().count(chr(10))}")  # fmt: skip
        noticed = flip_bytes(killed, args.flips, rng)
        print(f"flipped bytes noticed: {noticed} of {args.flips}")
        print(json.dumps({"kills": args.kills, "bit_equal": same, "flips": args.flips,
                          "noticed": noticed}))  # fmt: skip
    sys.exit(0 if same and rows[0] == rows[1] and noticed == args.flips else 1)


if __name__ == "__main__":
    main()
