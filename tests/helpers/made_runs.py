"""Folders of finished runs, made without training."""

import json

import numpy as np

from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.reports.arms import group
from jaxcam.reports.reading import read_runs
from jaxcam.reports.studies import STUDIES
from jaxcam.runs.identity import resolve

BY_FIELD = {study.field: study for study in STUDIES}


def make_run(folder, *, rate=0.5, checkpoints=1, pairs=8, split="test", rows=(), **settings):
    """The folder of a finished run with pairs that succeed up to the rate."""
    config = resolve(TrainConfig(**{"preset": "laptop", **settings}), accelerator=False)
    named = {k: getattr(config, k) for k in ("task", "scene", "policy", "conditioning", "seed")}
    angles = np.random.default_rng(0).uniform((-90, 30), (90, 60), (pairs, 2))
    written = [
        {
            **named,
            "run": folder.name,
            "step": config.steps - k * config.save_every,
            "split": split,
            "pair": p,
            "pair_sha": f"{p:016x}",
            "success": p < rate * pairs,
            "status": "ok",
            "steps": 70,
            "azimuth_deg": angles[p, 0],
            "elevation_deg": angles[p, 1],
            "distance": 1.0,
            "engine": "native",
            "width": 50,
        }
        for k in range(checkpoints)
        for p in range(pairs)
    ]
    (folder / "eval").mkdir(parents=True)
    (folder / "config.json").write_text(to_json(config))
    (folder / "metrics.jsonl").write_text(
        json.dumps({"step": config.steps, "seconds": 3600}) + "\n"
    )
    lines = "".join(json.dumps(row) + "\n" for row in [*written, *rows])
    (folder / "eval" / "rows.jsonl").write_text(lines)
    return folder


def arms_of(folder):
    return group(read_runs([folder]))


def make_studies(folder):
    """Runs of the paper's figures on scenes, encodings and numbers of cameras."""
    for way in ("none", "late"):
        twin = {"model": ("twin_of=late",)} if way == "none" else {}
        for scene in ("fixed", "randomized"):
            make_run(folder / f"{scene}-{way}", scene=scene, conditioning=way, **twin)
        for n in (3, 30):
            make_run(folder / f"n{n}-{way}", n=n, m=0, conditioning=way, steps=2000, **twin)
    make_run(folder / "token", conditioning="token")
