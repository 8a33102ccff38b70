"""What SmolVLA's 450 million parameters ask for: operations and memory of an update, uncomputed.

    python benchmarks/smolvla.py [--rows paper:1:70 paper:2:30 lerobot:1:64] [--no-remat] [--json]

A row is preset, views and batch. The whole update (loss, gradient, AdamW) is lowered and compiled
for shapes alone, so neither weights nor a GPU are needed. Operations are those of an update that
keeps its activations; computing layers again adds those of one forward pass. Memory is XLA's own
plan for a CPU: `state` is what stays between updates (weights, two moments), `batch` the pictures,
`scratch` the rest at its worst moment. A CPU plans bfloat16 matrix products with float32 copies, so
scratch is an upper bound for an accelerator.
"""

import argparse
import json
import time
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from jaxcam.config.train import TrainConfig
from jaxcam.models import Policy, PolicySpec, make_policy, policy_settings
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_task
from jaxcam.training.state import Update, init_state, make_optimizer, train_step

ACTIONS, PROPRIO, WORDS = 7, 8, 6
UNUSED = 49280 * 960 + 960
"""Parameters of the published model that no action depends on: its head over words, a last norm."""


def make(preset: str, views: int, remat: bool) -> tuple[TrainConfig, Policy]:
    """A preset's policy for one of the paper's tasks, with made-up words."""
    changes = (f"tokens={(1,) * WORDS}", f"remat={remat}")
    run = TrainConfig(policy="smolvla", preset=preset, views=views, model=changes)
    run = resolve(run, accelerator=True)
    settings = policy_settings(run, (make_task(run.task).prompt,))
    spec = PolicySpec(ACTIONS, PROPRIO, views, run.resolution, run.resolution, settings.chunk)
    stats = {f"action_{k}": np.ones(ACTIONS) for k in ("mean", "std")}
    stats |= {f"proprio_{k}": np.ones(PROPRIO) for k in ("mean", "std")}
    return run, make_policy(settings, spec, stats)


def batch_shapes(spec: PolicySpec, batch: int) -> dict[str, jax.ShapeDtypeStruct]:
    """A batch without its numbers."""
    pixels = (batch, spec.views, spec.height, spec.width, 3)
    shapes = {
        "image": (pixels, jnp.uint8),
        "K": ((batch, spec.views, 3, 3), jnp.float32),
        "base_from_camera": ((batch, spec.views, 4, 4), jnp.float32),
        "proprio": ((batch, PROPRIO), jnp.float32),
        "action": ((batch, spec.chunk, ACTIONS), jnp.float32),
        "is_pad": ((batch, spec.chunk), jnp.bool_),
    }
    return {k: jax.ShapeDtypeStruct(*v) for k, v in shapes.items()}


def gigabytes(tree: object) -> float:
    """Size of arrays that may be shapes only."""
    leaves = jax.tree.leaves(tree)
    return sum(x.size * x.dtype.itemsize for x in leaves if x.dtype != jax.dtypes.prng_key) / 1e9


def lower(preset: str, views: int, batch: int, remat: bool) -> tuple[Any, ...]:
    """A row's policy, training state, batch and lowered update."""
    run, policy = make(preset, views, remat)
    tx = make_optimizer(run, policy.trained)
    root = jax.eval_shape(jax.random.key, 0)
    state = jax.eval_shape(lambda key: init_state(policy.init, tx, key), root)
    shapes = batch_shapes(policy.spec, batch)
    step = jax.jit(partial(train_step, Update(policy.loss, tx)), donate_argnums=0)
    return policy, state, shapes, step.lower(state, shapes, root)


def measure(preset: str, views: int, batch: int, remat: bool) -> dict[str, Any]:
    """One row of the table."""
    # XLA counts a loop's body once, so operations are counted on the layers written out.
    policy, state, shapes, written_out = lower(preset, views, batch, False)
    forward = jax.jit(lambda params, batch: policy.loss(params, batch, None)[0])
    operations = [
        lowered.cost_analysis()["flops"] / 1e12
        for lowered in (forward.lower(state.params, shapes), written_out)
    ]
    lowered = lower(preset, views, batch, True)[-1] if remat else written_out
    began = time.perf_counter()
    memory = lowered.compile().memory_analysis()
    sizes = jax.tree.map(lambda x: x.size, state.params)
    count = sum(jax.tree.leaves(sizes))
    mask = policy.trained(sizes) if policy.trained else jax.tree.map(lambda _: True, sizes)
    trained = sum(jax.tree.leaves(jax.tree.map(lambda n, t: n * t, sizes, mask)))
    return {
        "preset": preset,
        "views": views,
        "batch": batch,
        "remat": remat,
        "M parameters": count / 1e6,
        "as published": (count + UNUSED) / 1e6,
        "trained": trained / 1e6,
        "TFLOP forward": operations[0],
        "TFLOP update": operations[1],
        "state GB": gigabytes(state),
        "batch GB": gigabytes(shapes),
        "scratch GB": memory.temp_size_in_bytes / 1e9,
        "compiled in s": time.perf_counter() - began,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="+", default=["paper:1:70", "paper:2:30", "lerobot:1:64"])
    parser.add_argument("--no-remat", action="store_true", help="keep activations in memory")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = []
    for text in args.rows:
        preset, views, batch = text.split(":")
        rows.append(measure(preset, int(views), int(batch), not args.no_remat))
        if args.json:
            print(json.dumps(rows[-1]), flush=True)
    if not args.json:
        table = Table(*rows[0])
        for row in rows:
            table.add_row(*(f"{v:.2f}" if isinstance(v, float) else str(v) for v in row.values()))
        Console(width=160).print(table)


if __name__ == "__main__":
    main()
