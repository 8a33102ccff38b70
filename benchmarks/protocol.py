"""The paper's protocol as one command, killed on the way: cost, memory, lost or doubled rows.

    python benchmarks/protocol.py RUN RUN RUN --out FOLDER [--kills 2]

Copies trained runs without their evaluations to FOLDER/runs, starts `python -m jaxcam.evaluate RUN…
--protocol paper` on the copies, kills it (SIGKILL) after equal shares of the rows and starts it
again, until every rollout has its row. It samples the clock, the rows on disk and the process's
memory once a second, fits a line to the clock over the rows, and writes `samples.csv`, `cost.json`
and `cost.png` to FOLDER. It fails if a row is missing or is there twice.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
import time
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from jaxcam.reports.style import BLUE, GREY, VERMILION, save, styled
from jaxcam.results.protocol import protocol_of
from jaxcam.runs.rollouts import read_rows, rows_file


class Sample(NamedTuple):
    """What was seen at one moment."""

    seconds: float
    rows: int
    megabytes: float
    """Resident memory of the process."""
    process: int
    """How many were killed before it."""


def rows_of(runs: list[Path]) -> list[tuple[str | None, int, int]]:
    """Run, checkpoint and pair of every row on disk."""
    rows = [row for run in runs for row in read_rows(rows_file(run))]
    return [(row.run, row.step, row.pair) for row in rows]


def resident(pid: int) -> float:
    """Resident memory of a process in MB; 0 when it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    return sum(int(s.split()[1]) / 1024 for s in status.splitlines() if s.startswith("VmRSS"))


def run_once(
    runs: list[Path], samples: list[Sample], began: float, stop_at: int, kills: int, log: Path
) -> None:
    """One process, killed when there are so many rows; samples are appended."""
    command = [sys.executable, "-m", "jaxcam.evaluate", *map(str, runs), "--protocol", "paper"]
    with log.open("a") as output:
        child = subprocess.Popen(command, stdout=output, stderr=output)
        while child.poll() is None:
            count = len(rows_of(runs))
            samples.append(Sample(time.time() - began, count, resident(child.pid), kills))
            if count >= stop_at:
                time.sleep(3)  # into the next batch, so that there is work to lose
                child.kill()
            time.sleep(1)
        if child.wait() > 0:
            raise SystemExit(f"The evaluation failed; see {log}.")
    samples.append(Sample(time.time() - began, len(rows_of(runs)), 0.0, kills))


@styled
def draw(samples: list[Sample], fit: np.ndarray, path: Path) -> None:
    """The clock and the memory over the rows."""
    rows, minutes = np.array([s.rows for s in samples]), np.array([s.seconds / 60 for s in samples])
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    clock, memory = figure.subplots(1, 2)
    clock.plot(rows, minutes, color=BLUE)
    ends = np.array([rows.min(), rows.max()])
    clock.plot(ends, np.polyval(fit, ends) / 60, color=GREY, linestyle="--", label="line fitted")
    kills = [i for i in range(1, len(samples)) if samples[i].process > samples[i - 1].process]
    clock.plot(rows[kills], minutes[kills], "x", color=VERMILION, label="killed and started again")
    clock.set(xlabel="rollouts on disk", ylabel="minutes", title="Cost")
    clock.legend()
    alive = [s for s in samples if s.megabytes]
    memory.plot([s.rows for s in alive], [s.megabytes / 1024 for s in alive], color=BLUE)
    memory.set(xlabel="rollouts on disk", ylabel="GB resident", title="Memory", ylim=(0, None))
    save(figure, path)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kills", type=int, default=2)
    args = parser.parse_args()
    runs = [args.out / "runs" / run.name for run in args.runs]
    for source, run in zip(args.runs, runs, strict=True):
        shutil.copytree(source, run, ignore=shutil.ignore_patterns("eval", "videos", "lock"))
    config = json.loads((runs[0] / "config.json").read_text())
    protocol = protocol_of(config["policy"])
    want = len(runs) * protocol.checkpoints * protocol.pairs

    samples: list[Sample] = []
    began = time.time()
    for kill in range(args.kills + 1):
        share = want * (kill + 1) // (args.kills + 1)
        last = kill == args.kills
        stop_at = sys.maxsize if last else share
        run_once(runs, samples, began, stop_at, kill, args.out / "log.txt")

    times = Counter(rows_of(runs))
    doubled = sum(n > 1 for n in times.values())
    with (args.out / "samples.csv").open("w", newline="") as file:
        csv.writer(file).writerows([Sample._fields, *samples])
    grown = [s for a, s in pairwise(samples) if s.rows > a.rows]
    rows, seconds = (np.array([getattr(s, name) for s in grown]) for name in ("rows", "seconds"))
    fit = np.polyfit(rows, seconds, 1)
    residual = seconds - np.polyval(fit, rows)
    last = [s.megabytes for s in samples if s.process == args.kills and s.megabytes]
    cost = {
        "rows": len(times),
        "lost": want - len(times),
        "doubled": doubled,
        "kills": args.kills,
        "minutes": samples[-1].seconds / 60,
        "seconds_a_rollout": fit[0],
        "r_squared": 1 - residual.var() / seconds.var(),
        "largest_deviation_seconds": np.abs(residual).max(),
        "megabytes_after_a_quarter_of_the_last_process": last[len(last) // 4],
        "megabytes_at_its_end": last[-1],
    }
    (args.out / "cost.json").write_text(json.dumps(cost, indent=2, default=float) + "\n")
    draw(samples, fit, args.out / "cost.png")
    print(json.dumps(cost, indent=2, default=float))
    if doubled or len(times) != want:
        raise SystemExit("Rows were lost or doubled.")


if __name__ == "__main__":
    main()
