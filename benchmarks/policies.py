"""Policies: many observations in one call against one by one, and train steps against PyTorch.

    python benchmarks/policies.py [--torch-python PATH] [--rounds 5] [--json]

1. Diffusion Policy's laptop preset, 10 steps of DDIM: 50 observations in one call and 50 calls.
2. One train step (loss, gradients, clipping, AdamW) in float32 of ACT `paper` (ResNet-18 at 256
   pixels, batch 8) and Diffusion Policy `paper` (batch 8), and the same with PyTorch's modules if
   PATH is the Python of an environment for `benchmarks/policies_torch.py`.

Everything is measured in turn, round by round; medians count, and ratios are taken within a round.
"""

import argparse
import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.config import TrainConfig, resolve
from jaxcam.models import FAMILIES, Policy, PolicySpec, make_policy
from jaxcam.models.policy import blank_stats
from jaxcam.state import init_state, make_optimizer, make_train_chunk

OBSERVATIONS = 50
BATCH = 8
ACTION, PROPRIO = 7, 9


def make(kind: str, preset: str, **changes: Any) -> tuple[Policy, TrainConfig]:
    """A policy of one camera, and the settings it is trained with."""
    config = resolve(TrainConfig(policy=kind, preset=preset), accelerator=False)
    settings = replace(FAMILIES[kind].presets[preset], **changes)
    size = config.resolution
    spec = PolicySpec(ACTION, PROPRIO, 1, size, size, settings.chunk, settings.obs_steps)
    return make_policy(settings, spec, blank_stats(spec)), config


def make_batch(policy: Policy, count: int) -> dict[str, np.ndarray]:
    """Noise seen by a camera above the table."""
    rng, spec = np.random.default_rng(0), policy.spec
    size = spec.height
    K = np.array([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]], np.float32)
    pose = np.array(policy.config.nominal_pose, np.float32)
    return {
        "image": rng.integers(0, 256, (count, 1, size, size, 3), dtype=np.uint8),
        "K": np.tile(K, (count, 1, 1, 1)),
        "base_from_camera": np.tile(pose, (count, 1, 1, 1)),
        "proprio": rng.normal(size=(count, PROPRIO)).astype(np.float32),
        "action": rng.uniform(-1, 1, (count, spec.chunk, ACTION)).astype(np.float32),
        "keyframe": rng.normal(size=(count, spec.chunk, 3)).astype(np.float32),
        "is_pad": np.zeros((count, spec.chunk), bool),
    }


def timed(function: Callable[[], Any]) -> float:
    """Seconds a call takes."""
    began = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - began


def sampling(rounds: int) -> dict[str, float]:
    """Milliseconds of 50 observations at once and one by one, and the ratio."""
    policy, _ = make("diffusion", "laptop")
    params, act = policy.init(jax.random.key(0)), jax.jit(policy.act)
    names = ("image", "K", "base_from_camera", "proprio")
    batch = make_batch(policy, OBSERVATIONS)
    many = {name: batch[name] for name in names}
    single = [{k: v[i : i + 1] for k, v in many.items()} for i in range(OBSERVATIONS)]
    key = jax.random.key(1)

    def together() -> jax.Array:
        return act(params, many, key)

    def one_by_one() -> list[jax.Array]:
        return [jax.block_until_ready(act(params, one, key)) for one in single]

    timed(together)
    timed(one_by_one)
    times = np.array([(timed(together), timed(one_by_one)) for _ in range(rounds)])
    return {
        "together_ms": float(np.median(times[:, 0]) * 1e3),
        "one_by_one_ms": float(np.median(times[:, 1]) * 1e3),
        "ratio": float(np.median(times[:, 0] / times[:, 1])),
    }


def train_step(kind: str) -> Callable[[], float]:
    """A function that makes one update and returns its seconds; compiled already."""
    # ACT without the paper's ray encoder, which LeRobot does not have.
    plain = {"conditioning": "none", "twin_of": "none"} if kind == "act" else {}
    policy, config = make(kind, "paper", compute_dtype="float32", **plain)
    tx, root = make_optimizer(config), jax.random.key(0)
    state = [init_state(policy.init, tx, root)]
    update = make_train_chunk(policy.loss, tx)
    batch = {k: jnp.asarray(v[None]) for k, v in make_batch(policy, BATCH).items()}

    def step() -> float:
        began = time.perf_counter()
        state[0], metrics = update(state[0], batch, root)
        jax.block_until_ready(metrics)
        return time.perf_counter() - began

    step()
    return step


class Torch:
    """The same step in a process of another Python, which waits while others are measured."""

    def __init__(self, python: str, kind: str) -> None:
        script = Path(__file__).with_name("policies_torch.py")
        self._process = subprocess.Popen(
            [python, str(script), kind, str(BATCH)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(self) -> float:
        """Seconds of one update."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write("step\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("PyTorch's process ended; its error is above.")
        return float(line)

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def training(kind: str, python: str | None, rounds: int) -> dict[str, float]:
    """Milliseconds of a train step here, and, if asked for, in PyTorch, and the ratio."""
    ours = train_step(kind)
    if python is None:
        return {"jax_ms": float(np.median([ours() for _ in range(rounds)]) * 1e3)}
    theirs = Torch(python, kind)
    theirs()
    times = np.array([(ours(), theirs()) for _ in range(rounds)])
    theirs.close()
    return {
        "jax_ms": float(np.median(times[:, 0]) * 1e3),
        "torch_ms": float(np.median(times[:, 1]) * 1e3),
        "ratio": float(np.median(times[:, 0] / times[:, 1])),
    }


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--torch-python", help="Python with PyTorch, see policies_torch.py")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=("sampling", "act", "diffusion"))
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = {}
    if args.only in (None, "sampling"):
        found["sampling"] = sampling(args.rounds)
    for kind in ("act", "diffusion"):
        if args.only in (None, kind):
            found[kind] = training(kind, args.torch_python, args.rounds)
    if args.json:
        print(json.dumps(found, indent=2))
        return
    for name, values in found.items():
        print(name, ", ".join(f"{k} {v:.3g}" for k, v in values.items()))


if __name__ == "__main__":
    main()
