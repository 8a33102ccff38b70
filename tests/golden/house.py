"""What a rearrangement of the code must not change, recorded by one commit and compared by another.

    python tests/golden/house.py record    # on the old commit: writes house.json beside this file
    python tests/golden/house.py compare   # on the new one: says what differs, exit code 1 if any

It runs commands as a user would, in the `jaxcam` that the interpreter finds: a tiny collection, 40
updates of ACT and Diffusion Policy, ten rollouts each, and the report of `results/lift`. Numbers
that come from a bootstrap may differ by its noise; all others are equal. Last digits depend on the
processor, so both commits are run on one machine, and the tests of CI do not run this.
"""

import hashlib
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py

HERE = Path(__file__).parent
STORED = HERE / "house.json"
RESULTS = HERE.parents[1] / "results/lift"
NOISE = 1.0
"""Percentage points by which the ends of a bootstrap interval may differ."""
SIZE = {"demos": 4, "validation": 1, "steps": 40, "batch": 8, "pairs": 10, "videos": 0}
RUN = [*(f"--{name}={value}" for name, value in SIZE.items()), "--data-dir=data"]
RUN += ["--action-space=eef_delta"]  # as recorded


def jaxcam(folder: Path, command: str, *flags: str) -> None:
    subprocess.run([sys.executable, "-m", f"jaxcam.{command}", *flags], cwd=folder, check=True)


def weights(run: Path) -> str:
    """A hash of the names and content of the checkpoint's arrays."""
    text = (run / "checkpoints/40/manifest/metadata").read_text("utf-8")
    leaves = json.loads(text)["leaves"]
    return hashlib.sha256(json.dumps(leaves, sort_keys=True).encode()).hexdigest()


def seal(folder: Path) -> str:
    (path,) = folder.glob("*.hdf5")
    with h5py.File(path) as file:
        return str(file["data"].attrs["sha256"])


def measure() -> dict:
    """All that is compared."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record: dict = {"weights": {}, "rows": {}}
        for policy in ("act", "diffusion"):
            jaxcam(folder, "train", "--policy", policy, "--run-dir", policy, *RUN)
            record["weights"][policy] = weights(folder / policy)
            lines = (folder / policy / "eval/rows.jsonl").read_text("utf-8").splitlines()
            record["rows"][policy] = [json.loads(line) for line in lines]
        record["seal"] = seal(folder / "data")
        jaxcam(folder, "report", str(RESULTS), "--out", "report")
        record["report"] = (folder / "report/report.md").read_text("utf-8").splitlines()
    return record


INTERVAL = re.compile(r"\[([-+\d.]+), ([-+\d.]+)\]|(p|\\<|&lt;) (= |)?(0\.\d+)|= (0\.\d{3})")


def apart(old: str, new: str) -> str | None:
    """In what two lines of a report differ; None if in nothing but the noise of the bootstrap."""
    if INTERVAL.sub("[]", old) != INTERVAL.sub("[]", new):
        return "text"
    for before, after in zip(INTERVAL.finditer(old), INTERVAL.finditer(new), strict=True):
        for a, b in zip(before.groups(), after.groups(), strict=True):
            try:
                far = abs(float(a) - float(b))
            except (TypeError, ValueError):
                continue
            if far > NOISE:
                return f"{before.group()} -> {after.group()}"
    return None


def differences(old: dict, new: dict) -> list[str]:
    """What differs that must not."""
    changes = [f"weights of {k}" for k, v in old["weights"].items() if new["weights"][k] != v]
    changes += ["seal of the dataset"] if old["seal"] != new["seal"] else []
    for policy, rows in old["rows"].items():
        for a, b in zip(rows, new["rows"][policy], strict=True):
            fields = [f for f in a if a[f] != b.get(f)]  # rows may have new ones
            changes += [f"row {a['pair']} of {policy}: {fields}"] if fields else []
    if len(old["report"]) != len(new["report"]):
        changes.append(f"report: {len(old['report'])} lines -> {len(new['report'])}")
    for number, lines in enumerate(zip(old["report"], new["report"], strict=False), start=1):
        if why := apart(*lines):
            changes.append(f"report, line {number}: {why}\n  {lines[0]}\n  {lines[1]}")
    return changes


def main() -> None:
    if sys.argv[1:] == ["record"]:
        STORED.write_text(json.dumps(measure(), indent=1) + "\n")
    elif sys.argv[1:] == ["compare"]:
        changes = differences(json.loads(STORED.read_text("utf-8")), measure())
        sys.exit("\n".join(changes) if changes else print("Nothing differs."))
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main()
