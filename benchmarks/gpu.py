"""A GPU, checked and timed in eight minutes: what no CPU can show of this code.

    python benchmarks/gpu.py [--out gpu.json] [--sections rays physics ...] [--sizes full|toy]
                             [--peak TFLOPS]

Each section is a process of its own with so many seconds; one that fails, hangs or runs out of
memory is told of with what it had measured until then, and the others go on.

    rays       ray-maps a second, and the share of the memory's bandwidth that writing them takes
    physics    control steps a second of mjx-warp, three tasks, 50 to 4096 worlds
    pictures   pictures a second at 84 and 256 pixels
    rollouts   1500 rollouts of Lift with ACT `paper` (untrained), pictures at 256 pixels
    act, diffusion, smolvla
               train steps of the preset `paper` in bfloat16, and their share of the card's peak
    parity     rays, rollouts and losses against the CPU

Operations of a train step are XLA's count of the program before it is compiled, its layers written
out: what the mathematics asks for, without layers that are computed again to save memory. The peak
is the card's of dense bfloat16, from the table below by its name, or --peak. Each section's last
row is the most memory that XLA held in it; what Warp holds beside it is not in that number.

What is printed is a table; --out has the same as JSON, with the card, its driver and the versions.
--sizes toy goes through all of it in a minute or two on a CPU, where the times mean nothing.
"""

import argparse
import json
import math
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

SECONDS = 480
"""In all; a toy's sizes have no limit, since a CPU may be slow and busy."""
SECTIONS = {"rays": 30, "physics": 120, "pictures": 40, "rollouts": 90, "act": 30, "diffusion": 45,
            "smolvla": 70, "parity": 55}  # fmt: skip
"""Each with the seconds that it has."""
TOY = 900
"""Those of each section at a toy's sizes."""
PEAK = {"B200": 2250, "H200": 989, "H100 PCIe": 756, "H100": 989, "A100": 312, "L40S": 362,
        "L4": 121, "A10G": 70, "A10": 125, "A6000": 155, "RTX 4090": 165,
        "RTX 3090": 71}  # fmt: skip
"""Dense bfloat16 (TFLOP/s, float32 sums) by what is in a card's name, from its maker's data
sheets; the first that fits counts."""
GRACE = 5.0
"""Seconds between asking a section to end and ending it."""


@dataclass(frozen=True)
class Section:
    """What came of a section."""

    name: str
    seconds: float
    rows: list[dict[str, Any]]
    problem: str = ""
    """Why there is no more; empty if all is there."""


def run_section(name: str, words: list[str], seconds: float) -> Section:
    """Runs a section in a process of its own; its rows as far as it got."""
    script = Path(__file__).with_name("gpu_sections.py")
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            [sys.executable, str(script), name, *words],
            stdout=out, stderr=errors, start_new_session=True,
        )  # fmt: skip
        problem = ""
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired:
            problem = f"stopped after its {seconds:.0f} s"
            code = _end(process)
        out.seek(0)
        errors.seek(0)
        if code and not problem:
            said = [line.strip() for line in errors.read().splitlines() if line.strip()]
            problem = f"ended with {code}: {said[-1][:300] if said else 'no message'}"
        rows = list[dict[str, Any]]()
        for line in out.read().splitlines():
            if line.startswith("{") and line.endswith("}"):  # the last one may be cut
                rows.append(json.loads(line))
    return Section(name, time.perf_counter() - began, rows, problem)


def _end(process: subprocess.Popen[bytes]) -> int:
    """Ends a process with all that it began."""
    os.killpg(process.pid, signal.SIGTERM)
    try:
        return process.wait(GRACE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        return process.wait()


def machine() -> dict[str, Any]:
    """The card and the versions that numbers are of; asked in another process, which leaves it."""
    code = (
        "import jax, json; d = jax.devices()[0]; "
        "print(json.dumps({'card': d.device_kind, 'platform': d.platform, "
        "'devices': jax.device_count()}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    if done.returncode:
        raise SystemExit(f"JAX does not start here:\n{done.stderr[-2000:]}")
    packages = ("jax", "jaxlib", "flax", "mujoco", "mujoco-mjx", "warp-lang", "jaxcam")
    return {
        **json.loads(done.stdout.strip().splitlines()[-1]),
        "driver": _driver(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
    }


def _driver() -> str:
    """The NVIDIA driver's version; empty without one."""
    try:
        asked = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
        done = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip().splitlines()[0] if done.returncode == 0 and done.stdout else ""


def peak_of(card: str) -> float | None:
    """A card's peak in bfloat16 (TFLOP/s), if its name is known."""
    return next((float(peak) for name, peak in PEAK.items() if name in card), None)


def table(sections: list[Section]) -> str:
    """What was measured, a line a number."""
    lines = [f"{'':10} {'what':44} {'value':>14}  unit"]
    for section in sections:
        for row in section.rows:
            value = row["value"]
            text = f"{value:,.4g}" if isinstance(value, float) else str(value)
            note = f"  ({row['note']})" if row.get("note") else ""
            lines.append(f"{section.name:10} {row['what']:44} {text:>14}  {row['unit']}{note}")
        if section.problem:
            lines.append(f"{section.name:10} {section.problem}")
    return "\n".join(lines)


def main() -> int:
    """The command line; its exit code is 1 if a section failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sections", nargs="+", choices=[*SECTIONS], default=[*SECTIONS])
    parser.add_argument("--sizes", choices=("full", "toy"), default="full")
    parser.add_argument("--peak", type=float, metavar="TFLOPS", help="dense bfloat16, of the card")
    parser.add_argument("--out", type=Path, metavar="FILE", help="JSON to write")
    args = parser.parse_args()
    about = machine()
    if about["platform"] == "cpu" and args.sizes == "full":
        parser.error("JAX sees no GPU here. On a CPU this runs with --sizes toy.")
    peak = args.peak or peak_of(about["card"])
    print(f"{about['card']}, driver {about['driver'] or '-'}, jax {about['versions']['jax']}, "
          f"Python {about['python']}", flush=True)  # fmt: skip
    if peak is None:
        print("The card's peak is not known here: shares of it need --peak.", flush=True)
    words = ["--sizes", args.sizes, *(["--peak", str(peak)] if peak else [])]
    began, done = time.perf_counter(), list[Section]()
    for name in args.sections:
        left = (SECONDS if args.sizes == "full" else math.inf) - (time.perf_counter() - began)
        if left < GRACE:
            done.append(Section(name, 0.0, [], f"not begun: the {SECONDS} s were over"))
            continue
        own = SECTIONS[name] if args.sizes == "full" else TOY
        done.append(run_section(name, words, min(own, left)))
        print(f"  {name}: {done[-1].seconds:.0f} s {done[-1].problem}", flush=True)
    print(table(done))
    whole = {
        "machine": about,
        "sizes": args.sizes,
        "peak_tflops": peak,
        "seconds": time.perf_counter() - began,
        "sections": [vars(section) for section in done],
    }
    if args.out:
        args.out.write_text(json.dumps(whole, indent=2) + "\n")
    return int(any(section.problem for section in done))


if __name__ == "__main__":
    sys.exit(main())
