"""Stands in for `python -m jaxcam.train` and `jaxcam.evaluate`: the same files, in no time."""

import json
import os
import signal
import sys
import time
from pathlib import Path

SAVE = 10


def append(path, row):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a") as file:
        file.write(json.dumps(row) + "\n")


def steps_saved(folder):
    return sorted(int(p.name) for p in (folder / "checkpoints").glob("*"))


def train(flags):
    folder = Path(flags["run-dir"])
    append(folder / "starts.jsonl", {"at": time.time(), "parent": os.getppid()})
    starts = len((folder / "starts.jsonl").read_text().splitlines())
    if flags["seed"] == os.environ.get("FAKE_FAILS"):
        print("ConfigError: nothing works here")
        return 2
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    first = max(steps_saved(folder), default=0)
    for step in range(first + SAVE, int(flags["steps"]) + 1, SAVE):
        time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
        append(folder / "metrics.jsonl", {"step": step, "loss": 1.0})
        (folder / "checkpoints" / str(step)).mkdir(parents=True)
        if stopped:
            return 143
        if flags["seed"] == os.environ.get("FAKE_KILLED") and starts == 1:
            os.kill(os.getpid(), signal.SIGKILL)
    evaluate(folder, [int(flags["steps"])], int(flags.get("pairs", 50)))
    return 0


def evaluate(folder, steps, pairs):
    for step in steps:
        for pair in range(pairs):
            append(folder / "eval" / "rows.jsonl",
                   {"step": step, "pair": pair, "split": "test", "status": "ok",
                    "success": pair % 2 == 0, "task": "lift"})  # fmt: skip
    return 0


def main():
    module, *words = sys.argv[1:]
    if module == "jaxcam.evaluate":
        folder = Path(words[0])
        return evaluate(folder, steps_saved(folder)[-10:-1], 50)
    return train(dict(zip([w[2:] for w in words[::2]], words[1::2], strict=True)))


sys.exit(main())
