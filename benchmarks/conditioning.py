"""Does knowing the camera help? Both arms, several seeds, the same held-out pairs.

    python benchmarks/conditioning.py --seeds 0 1 2 --pairs 200

Trains every (conditioning, seed) with `python -m jaxcam.train` and the preset's own budget, one
run after the other; runs that are complete are kept, so it can be stopped and started again.
Writes `results/<task>-<scene>/`: the rows of all rollouts, a figure, and a table with the paired
difference.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from jaxcam.files.jsonl import append_jsonl, read_jsonl
from jaxcam.reports.run_figures import comparison, save
from jaxcam.results.stats import latest_rows, paired_difference, success_rate

KEPT = ("task", "scene", "policy", "conditioning", "seed", "step", "split", "pair", "success",
        "status", "steps", "azimuth_deg", "elevation_deg", "distance", "renderer", "width",
        "episode_seed")  # fmt: skip


def train(arm: str, seed: int, args: argparse.Namespace, extra: list[str]) -> tuple[Path, float]:
    """Trains and evaluates one run; returns its folder and the seconds this took."""
    folder = Path(args.runs) / f"{args.task}-{args.scene}-{arm}-{seed}"
    command = [sys.executable, "-m", "jaxcam.train", "--task", args.task, "--scene", args.scene,
               "--seed", str(seed), "--pairs", str(args.pairs), "--conditioning", arm,
               "--data-dir", args.data_dir, "--run-dir", str(folder), *extra]  # fmt: skip
    print("$", " ".join(["python", *command[1:]]), flush=True)
    began = time.perf_counter()
    subprocess.run(command, check=True)
    return folder, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--arms", nargs="+", default=["keypoints", "none"], help="last: baseline")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--task", default="lift")
    parser.add_argument("--scene", default="randomized")
    parser.add_argument("--data-dir", default="data")
    parser.add_argument("--runs", default="runs/conditioning")
    parser.add_argument("--results", default="results")
    args, extra = parser.parse_known_args()

    rows: dict[str, list[dict]] = {arm: [] for arm in args.arms}
    minutes: dict[str, list[float]] = {arm: [] for arm in args.arms}
    for seed in args.seeds:
        for arm in args.arms:
            folder, seconds = train(arm, seed, args, extra)
            minutes[arm].append(seconds / 60)
            last = latest_rows(read_jsonl(folder / "eval" / "rows.jsonl"))
            final = max(r["step"] for r in last)
            rows[arm] += [r for r in last if r["step"] == final and r["pair"] < args.pairs]
            write(args, rows, minutes)


def write(args: argparse.Namespace, rows: dict[str, list[dict]], minutes: dict) -> None:
    """Writes what is there so far."""
    out = Path(args.results) / f"{args.task}-{args.scene}"
    out.mkdir(parents=True, exist_ok=True)
    (out / "rows.jsonl").unlink(missing_ok=True)
    for some in rows.values():
        append_jsonl(out / "rows.jsonl", *({k: r[k] for k in KEPT if k in r} for r in some))
    baseline = args.arms[-1]
    lines = [
        f"`python benchmarks/conditioning.py --arms {' '.join(args.arms)} --seeds "
        f"{' '.join(map(str, args.seeds))} --pairs {args.pairs}`",
        "",
        f"| conditioning | seeds | success on {args.pairs} held-out pairs | each seed | minutes |",
        "|---|---|---|---|---|",
    ]
    for arm, some in rows.items():
        if not some:
            continue
        seeds = sorted({r["seed"] for r in some})
        each = [100 * success_rate(r for r in some if r["seed"] == s).value for s in seeds]
        each, took = (", ".join(f"{x:.1f}" for x in xs) for xs in (each, minutes[arm]))
        lines.append(f"| {arm} | {len(seeds)} | {success_rate(some)} | {each} | {took} |")
    for arm in args.arms[:-1]:
        if rows[arm] and rows[baseline]:
            lines += [
                "",
                f"{arm} against {baseline}: {paired_difference(rows[arm], rows[baseline])}",
            ]
    (out / "table.md").write_text("\n".join(lines) + "\n")
    (out / "summary.json").write_text(
        json.dumps({"minutes": minutes, "args": vars(args)}, indent=1)
    )
    full = {arm: some for arm, some in rows.items() if some}
    if len(full) > 1:
        save(comparison(full, baseline=baseline), out / "comparison.png")
    print("\n".join(lines), flush=True)


if __name__ == "__main__":
    main()
