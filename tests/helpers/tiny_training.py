"""A training that takes no time: random demonstrations and a linear policy.

Tests that need other devices or several processes run it as a script.
"""

import dataclasses
import json
import signal
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.config.conditions import Conditions
from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import Dataset
from jaxcam.data.pairs import Pairs
from jaxcam.data.pictures import Pictures
from jaxcam.data.samples import Layout
from jaxcam.devices import check_same, copied, data_mesh, is_first, joined, shard
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.evaluator import Acting, Candidate
from jaxcam.interrupts import Interrupt
from jaxcam.models import Policy, PolicySpec
from jaxcam.results.rows import Row
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.sim.rollout import Rollouts
from jaxcam.sim.task import Start
from jaxcam.training.loop import Trainer

TRAIN, VALID, STEPS, CAMERAS, PIXELS, CHUNK = 4, 2, 12, 3, 16, 2
SPEC = PolicySpec(action_dim=2, proprio_dim=3, views=1, height=PIXELS, width=PIXELS, chunk=CHUNK)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings of the linear policy."""

    noise: float = 0.1


def dataset():
    """Four training and two validation demonstrations of noise."""
    rng, count = np.random.default_rng(0), TRAIN + VALID
    poses = np.tile(np.eye(4, dtype=np.float32), (count * CAMERAS, 1, 1))
    layout = Layout(np.full(count, STEPS), np.full(count, CAMERAS))
    pictures = rng.integers(0, 256, (layout.total, PIXELS, PIXELS, 3), np.uint8)

    def values(size):
        return rng.normal(size=(count, STEPS, size)).astype(np.float32)

    return Dataset(
        pictures=Pictures(pictures, layout, np.ones(layout.total, bool)),
        K=np.tile(np.diag([20.0, 20, 1]).astype(np.float32), (len(poses), 1, 1)),
        base_from_camera=poses,
        actions=values(SPEC.action_dim),
        keyframes=values(3),
        proprio=values(SPEC.proprio_dim),
        windows=list(np.arange(count * CAMERAS).reshape(count, CAMERAS)),
        train=TRAIN,
        fingerprint="noise",
    )


def policy(noise=0.1):
    """A linear policy whose loss has random numbers of every sample in it."""
    shape = (SPEC.chunk, SPEC.action_dim)

    def init(key):
        return {"w": jax.random.normal(key, (6, SPEC.chunk * SPEC.action_dim)) / 3}

    def act(params, obs, key):
        image = obs["image"].astype(jnp.float32).mean((1, 2, 3)) / 128 - 1
        features = jnp.concatenate([image, obs["proprio"]], -1)
        return (features @ params["w"]).reshape(-1, *shape)

    def loss(params, batch, key):
        error = act(params, batch, None) - batch["action"]
        if key is not None:
            error += noise * jax.random.normal(key, error.shape)
        value = jnp.mean(error**2 * ~batch["is_pad"][..., None])
        return value, {"loss": value}

    return Policy(init, loss, act, Settings(noise), SPEC, SPEC.chunk)


def settings(folder, **changes):
    """Settings of a run of six updates of twelve samples."""
    small = {"steps": 6, "batch": 12, "lr": 0.01, "schedule": "constant", "warmup": 0,
             "resolution": PIXELS, "log_every": 1, "eval_every": 3, "save_every": 1, "ema": 0.5,
             "demos": TRAIN, "validation": VALID, "run_dir": str(folder)}  # fmt: skip
    return resolve(TrainConfig(**{**small, **changes}), accelerator=False)


def fit(*configs, stop=None, noise=0.1, write=True):
    """Trains one run or several side by side; their states."""
    runs = [RunDir.open(config) if write else None for config in configs]
    try:
        return Trainer(configs[0], dataset(), policy(noise), stop or Interrupt()).fit(configs, runs)
    finally:
        for run in runs:
            if run:
                run.close()


class PairsEvaluator:
    """Stands for the simulator: pair 1 ends in an error at first, pair 2 always."""

    width, engine_name, ensemble = 2, "native", 0.0
    conditions = Conditions()

    def __init__(self):
        self.task = type("Task", (), {"name": "lift", "horizon": 3})
        self.ran = []

    def finishes(self, pair):
        return pair != 2 and not (pair == 1 and 1 not in self.ran)

    def success(self, pair):
        return pair % 2 == 0

    def pairs(self, split, numbers):
        column = np.array(numbers, float)[:, None]
        return Pairs([*numbers], column, Start(*[column] * len(Start._fields)))

    def run(self, candidate, split, pairs, tick):
        assert len(pairs) <= self.width
        ok = [self.finishes(pair) for pair in pairs]
        self.ran += pairs
        rows = [
            Row(run=candidate.folder.name, step=candidate.step, split=split, pair=pair,
                width=self.width, engine=self.engine_name, ensemble=self.ensemble,
                status="ok" if good else "error", success=good and self.success(pair))
            for pair, good in zip(pairs, ok, strict=True)
        ]  # fmt: skip
        nothing = np.zeros(len(pairs))
        still = np.zeros((1, len(pairs), 1))
        return rows, Rollouts(nothing > 0, nothing, nothing == 0, still, nothing == 0)


def scenes(folder):
    """What each of several processes does; process i writes to `folder` only if i is 0."""

    record = {"shard": shard(), "devices": data_mesh(12).size}
    mine = folder if is_first() else folder / "elsewhere" / folder.name
    fit(settings(mine / "run", steps=3), write=is_first())
    state = fit(settings(mine / "run"), write=is_first())[0]  # restored from what was saved
    record["step"], record["w"] = int(state.step), np.asarray(state.params["w"]).tolist()
    stop = Interrupt()
    if not is_first():  # only one process is told
        stop.signal = signal.SIGTERM
    state = fit(settings(mine / "stopped"), stop=stop, write=is_first())[0]
    record["stopped"] = int(state.step)
    evaluator = PairsEvaluator()
    candidate = Candidate(None, None, mine, 7)  # pyright: ignore
    estimate = evaluate(evaluator, candidate, Wanted(pairs=7))  # pyright: ignore
    record["ran"], record["estimate"] = evaluator.ran, [estimate.value, estimate.n]
    try:
        check_same("demonstrations", "abc" if is_first() else "xyz")
    except ConfigError as error:
        record["different"] = str(error)
    return record


def act_on_all_devices():
    """A batch of rollouts asks the policy once, on four devices, and gets what one gives."""

    rng, tiny = np.random.default_rng(0), policy()
    obs = {"image": rng.integers(0, 256, (8, 1, PIXELS, PIXELS, 3), np.uint8),
           "proprio": rng.normal(size=(8, SPEC.proprio_dim)).astype(np.float32)}  # fmt: skip
    params, root = tiny.init(jax.random.key(1)), jax.random.key(0)
    mesh = data_mesh(8, everywhere=False)
    chunks = Acting(tiny.act, mesh)(copied(mesh, params), root, obs, jnp.int32(0), None)
    assert len(chunks.sharding.device_set) == 4
    assert chunks.addressable_shards[0].data.shape[0] == 2
    np.testing.assert_allclose(
        chunks, Acting(tiny.act)(params, root, obs, jnp.int32(0), None), rtol=1e-5, atol=1e-5
    )


def main():

    what, folder = sys.argv[1], Path(sys.argv[2])
    if what == "one":
        assert len(jax.devices()) == 4
        fit(settings(folder / "run", steps=3))
        fit(settings(folder / "run"))
        act_on_all_devices()
        return
    with joined(True):
        index = jax.process_index()
        if what == "fail" and index == 0:
            raise DatasetError("nothing there")
        if what == "fail":
            fit(settings(folder / "run"), write=False)
        record = scenes(folder)
    (folder / f"record-{index}.json").write_text(json.dumps(record))


if __name__ == "__main__":
    main()
