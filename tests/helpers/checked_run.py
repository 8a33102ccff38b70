"""A run's folder as the doctor gets it: two checkpoints, metrics and an evaluation, all small."""

import json
from dataclasses import replace

import jax
from conftest import TINY

from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.runs.identity import resolve
from jaxcam.training.checkpoint import Checkpoints
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state, make_optimizer

CONFIG = resolve(TrainConfig(**TINY, steps=6, save_every=1, pairs=3), accelerator=False)


def save_checkpoints(folder, fingerprint, steps=(1, 2)):
    def init(key):
        return {"w": jax.random.normal(key, (64, 5))}

    side = make_side(
        CONFIG, settings=CONFIG, spec=CONFIG, stats={}, data=f"{fingerprint}-84px-eef_delta"
    )
    state = init_state(init, make_optimizer(CONFIG), jax.random.key(0))
    with Checkpoints(folder / "checkpoints") as checkpoints:
        for step in steps:
            checkpoints.save(replace(state, step=jax.numpy.int32(step)), side)


def row(step, pair, **values):
    return {
        "step": step, "split": "test", "pair": pair, "success": True, "status": "ok", "width": 50,
        "engine": "native", "ensemble": 0.0, **values,
    }  # fmt: skip


def write(file, rows):
    file.write_text("".join(json.dumps(r) + "\n" for r in rows))


def make_run(folder, demos):
    """A run folder after 2 of 6 updates, evaluated once, started where its dataset is."""
    folder.mkdir(parents=True)
    config = replace(CONFIG, data_dir=str(demos.path.parent))
    (folder / "config.json").write_text(to_json(config))
    save_checkpoints(folder, demos.fingerprint)
    write(folder / "metrics.jsonl", [{"step": s, "loss": 3.0 - s, "skipped": 0.0} for s in (1, 2)])
    (folder / "eval").mkdir()
    write(folder / "eval" / "rows.jsonl", [row(2, pair) for pair in range(3)])
    return folder


def flip(run):
    files = [p for p in (run / "checkpoints" / "2" / "params").rglob("*") if p.parent.name == "d"]
    file = max(files, key=lambda p: p.stat().st_size)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x10
    file.write_bytes(content)
