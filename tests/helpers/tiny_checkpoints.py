"""A state that trains in milliseconds, and its checkpoints, whole and damaged."""

import dataclasses
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxcam.config.train import TrainConfig
from jaxcam.runs.identity import resolve
from jaxcam.training.side import make_side
from jaxcam.training.state import Update, init_state, make_train_chunk

CONFIG = resolve(TrainConfig(steps=6, save_every=1), accelerator=False)
ROOT = jax.random.key(0)
TX = optax.masked(optax.adamw(1e-2), True)
STATS = {"action_mean": np.array([0.1, 1 / 3, -2e-9], np.float32), "n": np.int64(7)}


@dataclasses.dataclass(frozen=True)
class Settings:
    """Stands for a policy's settings and its sizes."""

    width: int = 4
    sizes: tuple[tuple[int, ...], ...] = ((1, 2), (3,))


def init(key):
    return {"w": jax.random.normal(key, (64, 5)), "deep": {"0": {"b": jnp.zeros(5)}}}


def loss(params, batch, key):
    out = batch["x"] @ params["w"] + params["deep"]["0"]["b"] + jax.random.normal(key)
    return jnp.mean(out**2), {}


CHUNK = make_train_chunk(Update(loss, TX, ema=0.9))
SIDE = make_side(CONFIG, settings=Settings(), spec=Settings(width=9), stats=STATS, data="abc")


def fresh(*, ema=True):
    return init_state(init, TX, ROOT, ema=ema)


def train(state, last):
    for step in range(int(state.step), last):
        x = np.random.default_rng(step).normal(size=(1, 8, 64)).astype(np.float32)
        state, _ = CHUNK(state, {"x": x}, ROOT)
    return state


def template():
    return jax.eval_shape(fresh)


def assert_same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)


def data_files(run, step, item):
    files = [p for p in (run / "checkpoints" / str(step) / item).rglob("*") if p.parent.name == "d"]
    assert files
    return sorted(files, key=lambda p: p.stat().st_size)


def flip_byte(path, where=0.5):
    data = bytearray(path.read_bytes())
    data[int(len(data) * where)] ^= 0x10
    path.write_bytes(data)


def damage_flip(run):
    flip_byte(data_files(run, 3, "params")[-1])


def damage_flip_optimizer(run):
    flip_byte(data_files(run, 3, "train")[-1], 0.7)


def damage_truncate(run):
    file = data_files(run, 3, "params")[-1]
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def damage_missing_item(run):
    shutil.rmtree(run / "checkpoints" / "3" / "params")


def damage_side(run):
    file = run / "checkpoints" / "3" / "manifest" / "metadata"
    text = file.read_text()
    assert '"seed": 0' in text
    file.write_text(text.replace('"seed": 0', '"seed": 8'))


def damage_manifest(run):
    flip_byte(run / "checkpoints" / "3" / "manifest" / "metadata", 0.0)


def damage_digests(run):
    flip_byte(run / "checkpoints" / "3" / "files.json", 0.3)


def damage_digests_torn(run):
    file = run / "checkpoints" / "3" / "files.json"
    file.write_text(file.read_text()[:-9])


def damage_file_gone(run):
    next((run / "checkpoints" / "3" / "train").rglob("_METADATA")).unlink()


def damage_no_manifest(run):
    shutil.rmtree(run / "checkpoints" / "3" / "manifest")


def damage_wrong_step(run):
    shutil.rmtree(run / "checkpoints" / "3")
    shutil.copytree(run / "checkpoints" / "1", run / "checkpoints" / "3")


DAMAGES = [v for k, v in globals().items() if k.startswith("damage_")]
