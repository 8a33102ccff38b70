"""Result packs, made without an evaluation."""

import json
from pathlib import Path

from made_runs import make_run

from jaxcam.reports.arms import Run
from jaxcam.reports.packs.manifest import PackLabel
from jaxcam.reports.packs.pack import write_pack
from jaxcam.reports.reading import read_runs
from jaxcam.results.rows import Row
from jaxcam.runs.manifests import seal, without_seal


def ours(folder, **settings):
    """Runs of image-only and late fusion on Lift, on eight pairs."""
    for way, rate in (("none", 0.25), ("late", 0.75)):
        make_run(folder / way, rate=rate, conditioning=way, **settings)
    return read_runs([folder])


def foreign(name="Pi <script>alert(1)</script>", rate=0.5, way="given", pairs=8, **settings):
    """Somebody else's policy, as it is recorded, on the same pairs as `ours`."""
    said = {"task": "lift", "scene": "randomized", "policy": name, "conditioning": way}
    rows = [
        Row(pair=p, pair_sha=f"{p:016x}", success=p < rate * pairs, status="ok", run=name, steps=50,
            azimuth_deg=10.0 * (p % 9), elevation_deg=40.0, distance=1.0, **said)
        for p in range(pairs)
    ]  # fmt: skip
    return Run(name, None, {**said, "preset": None, **settings}, None, rows)


def pack_of(folder, runs, name="", **about):
    """A pack of runs in a folder."""
    return write_pack(Path(folder), runs, "test", PackLabel(name or folder.name, **about))


def resealed(file, **changes):
    """Other values in a manifest, under a right seal."""
    content = without_seal(json.loads(file.read_text("utf-8")))
    file.write_text(json.dumps(seal(content | changes)), "utf-8")
