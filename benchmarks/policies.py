"""Policies: many observations in one call against one by one, and train steps against PyTorch.

    python benchmarks/policies.py [--torch-python PATH [--torch-threads 1]] [--rounds 5] [--json]

1. Diffusion Policy, 10 steps of DDIM: 50 observations in one call and 50 calls; `--preset` says of
   which preset.
2. One train step (loss, gradients, clipping, AdamW) in float32 of ACT `paper` (ResNet-18 at 256
   pixels, batch 8) and Diffusion Policy `paper` (batch 8), and the same with PyTorch's modules if
   PATH is the Python of an environment for `benchmarks/policies_torch.py`.
3. With `--only encodings`: one train step of ACT `attention` (batch 64) by each way of
   conditioning, and its ratio to late fusion's; parameters likewise.
4. With `--only kernels`: the gradient of a convolution's kernel, ours against XLA's, in shapes of
   ACT `laptop` at 84 and 128 pixels, with one view and two, and of ResNet-18; and a whole update
   of ACT `laptop` with one and with the other.

Everything is measured in turn, round by round; medians count, and ratios are taken within a round.
`cpu` is the time of all cores, which tells more than the clock does on a machine that has other
work; threads of PyTorch that wait for each other take it too, so compare it with --torch-threads 1.
Of sampling, `bound` is the least ratio that is to be had: what the arithmetic of 50 takes at
the rate of a large matrix product, measured in the same rounds.
"""

import argparse
import json
import os
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.config.flags import PRESET
from jaxcam.config.names import Conditioning, names_of
from jaxcam.config.train import TrainConfig
from jaxcam.models import FAMILIES, Policy, PolicySpec, convolution, layers, make_policy
from jaxcam.models.crops import window
from jaxcam.models.diffusion.network import Diffusion
from jaxcam.models.policy import blank_stats, pure
from jaxcam.runs.identity import resolve
from jaxcam.training.state import Update, init_state, make_optimizer, make_train_chunk

OBSERVATIONS = 50
BATCH = 8
LAPTOP_BATCH = 64
REFERENCE = "late"
"""The way of conditioning that the others are measured against."""
ACTION, PROPRIO = 7, 9
KERNELS = (
    (64, 21, 32, 32, 3, 1),
    (128, 21, 48, 32, 3, 1),
    (64, 32, 32, 32, 3, 1),
    (8, 256, 3, 64, 7, 2),
    (8, 64, 64, 64, 3, 1),
    (8, 32, 128, 128, 3, 1),
    (8, 16, 256, 256, 3, 1),
    (8, 8, 512, 512, 3, 1),
)
"""Batch, side of pictures, channels in and out, side of the kernel, stride."""
SQUARE = 1024
"""Side of the matrices whose product tells what the machine can do."""


def make(kind: str, preset: str, side: Any = PRESET, **changes: Any) -> tuple[Policy, TrainConfig]:
    """A policy of one camera, and the settings it is trained with."""
    asked = TrainConfig(policy=kind, preset=preset, resolution=side)
    config = resolve(asked, accelerator=False)
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


def with_history(batch: dict[str, np.ndarray], steps: int) -> dict[str, np.ndarray]:
    """The observations, each seen for a number of steps."""
    names = ("image", "K", "base_from_camera", "proprio")
    return {name: np.repeat(batch[name][:, None], steps, 1) for name in names}


class Times(NamedTuple):
    """Seconds that something took."""

    clock: float
    cpu: float
    """Of all cores together."""


def timed(function: Callable[[], Any]) -> Times:
    """Seconds a call takes."""
    clock, cpu = time.perf_counter(), time.process_time()
    jax.block_until_ready(function())
    return Times(time.perf_counter() - clock, time.process_time() - cpu)


def compared(ours: list[Times], theirs: list[Times]) -> dict[str, float]:
    """Medians of the ratios of two things measured in turn."""
    clock, cpu = np.median(np.array(ours) / np.array(theirs), 0)
    return {"ratio": float(clock), "cpu_ratio": float(cpu)}


def milliseconds(name: str, times: list[Times]) -> dict[str, float]:
    """Medians."""
    clock, cpu = np.median(times, 0) * 1e3
    return {f"{name}_ms": float(clock), f"{name}_cpu_ms": float(cpu)}


def flops(policy: Policy, batch: dict[str, np.ndarray]) -> float:
    """Operations of a call: of the encoder once, of the U-Net every step."""
    config, spec = policy.config, policy.spec
    init, network = pure(lambda rngs: Diffusion(config, spec, rngs=rngs))
    params = jax.eval_shape(init, jax.random.key(0))
    obs = {k: jnp.asarray(v) for k, v in with_history(batch, spec.obs_steps).items()}
    obs |= window(obs, config.crop, None) if config.crop else {}

    def condition(params: Any) -> Any:
        return network(params).condition(obs, obs["proprio"])

    def predict(params: Any, features: Any) -> Any:
        x = jnp.asarray(batch["action"])
        return network(params).unet(x, jnp.zeros(len(x), int), *features)

    features = jax.eval_shape(condition, params)
    programs = (jax.jit(condition).lower(params), jax.jit(predict).lower(params, features))
    encoder, unet = ((p.cost_analysis() or {})["flops"] for p in programs)
    return encoder + config.sample_steps * unet


def sampling(rounds: int, preset: str) -> dict[str, float]:
    """50 observations at once and one by one, and the ratio."""
    policy, _ = make("diffusion", preset, sampler="ddim", sample_steps=10)
    params, act = jax.jit(policy.init)(jax.random.key(0)), jax.jit(policy.act)
    batch, steps = make_batch(policy, OBSERVATIONS), policy.spec.obs_steps
    many = with_history(batch, steps)
    many = {k: v[:, 0] for k, v in many.items()} if steps == 1 else many
    single = [{k: v[i : i + 1] for k, v in many.items()} for i in range(OBSERVATIONS)]
    key, square, multiply = jax.random.key(1), jnp.ones((SQUARE, SQUARE)), jax.jit(jnp.matmul)
    functions = (
        lambda: act(params, many, key),
        lambda: [jax.block_until_ready(act(params, one, key)) for one in single],
        lambda: multiply(square, square),
    )
    for function in functions:
        timed(function)
    times = [[timed(function) for function in functions] for _ in range(rounds)]
    together, one_by_one, product = ([row[i] for row in times] for i in range(3))
    work = flops(policy, batch)
    best = min(t.clock for t in product) * work / (2 * SQUARE**3)
    return {
        **milliseconds("together", together),
        **milliseconds("one_by_one", one_by_one),
        **compared(together, one_by_one),
        "gflop": work / 1e9,
        "bound": best / min(t.clock for t in one_by_one),
    }


def train_step(kind: str) -> Callable[[], Times]:
    """A function that makes one update; compiled already."""
    # ACT without the paper's ray encoder, which LeRobot does not have.
    plain = {"conditioning": "none", "twin_of": "none"} if kind == "act" else {}
    return step_of(*make(kind, "paper", compute_dtype="float32", **plain), BATCH)


def step_of(policy: Policy, config: TrainConfig, count: int) -> Callable[[], Times]:
    """A function that makes one update of so many samples; compiled already."""
    tx, root = make_optimizer(config), jax.random.key(0)
    state = [init_state(policy.init, tx, root)]
    update = make_train_chunk(Update(policy.loss, tx))
    batch = {k: jnp.asarray(v[None]) for k, v in make_batch(policy, count).items()}

    def step() -> Any:
        state[0], metrics = update(state[0], batch, root)
        return metrics

    timed(step)
    return lambda: timed(step)


def encodings(rounds: int) -> dict[str, dict[str, float]]:
    """An update of each way of conditioning in one network, in turn, and ratios to late fusion."""
    steps, sizes = {}, {}
    for way in names_of(Conditioning):
        twin_of = {"twin_of": way}  # none is the network without a ray path
        policy, config = make("act", "attention", conditioning=way, **twin_of)
        shapes = jax.tree.leaves(jax.eval_shape(policy.init, jax.random.key(0)))
        sizes[way] = float(sum(np.prod(leaf.shape) for leaf in shapes))
        steps[way] = step_of(policy, config, LAPTOP_BATCH)
    times = [{way: step() for way, step in steps.items()} for _ in range(rounds)]
    taken = {way: [row[way] for row in times] for way in steps}
    return {
        way: {
            **milliseconds("jax", taken[way]),
            **compared(taken[way], taken[REFERENCE]),
            "parameters": sizes[way],
            "parameters_ratio": sizes[way] / sizes[REFERENCE],
        }
        for way in steps
    }


def kernels(rounds: int) -> dict[str, dict[str, float]]:
    """Gradients of kernels, and whole updates, ours in turn with XLA's; ratios ours to XLA's."""
    measured = {}
    for batch, side, d_in, d_out, size, stride in KERNELS:
        x = jax.random.normal(jax.random.key(0), (batch, side, side, d_in))
        kernel = jnp.ones((size, size, d_in, d_out))
        ours, theirs = (
            gradient_of(convolve, x, kernel, stride) for convolve in (convolution.convolve, plain)
        )
        name = f"{batch} of {side} x {side} x {d_in}, {size} x {size} x {d_out}, stride {stride}"
        measured[name] = in_turn(ours, theirs, rounds)
    for side in (84, 128):
        updates = []
        for convolve in (convolution.convolve, plain):
            with mock.patch.object(layers, "convolve", convolve):
                updates.append(step_of(*make("act", "laptop", side), LAPTOP_BATCH))
        measured[f"update at {side}"] = in_turn(*updates, rounds)
    return measured


def plain(x: jax.Array, kernel: jax.Array, strides: Any, pads: Any, **_: Any) -> jax.Array:
    """XLA's convolution, with its own gradients."""
    return jax.lax.conv_general_dilated(
        x, kernel, strides, pads, dimension_numbers=("NHWC", "HWIO", "NHWC")
    )


def gradient_of(
    convolve: Callable[..., jax.Array], x: jax.Array, kernel: jax.Array, stride: int
) -> Callable[[], Times]:
    """A function that takes the gradient of a kernel; compiled already."""
    pad = (len(kernel) - 1) // 2
    where = (stride,) * 2, ((pad, pad),) * 2
    above = jnp.ones_like(convolve(x, kernel, *where))
    take = jax.jit(jax.grad(lambda k, x, above: (convolve(x, k, *where) * above).sum()))
    timed(lambda: take(kernel, x, above))
    return lambda: timed(lambda: take(kernel, x, above))


def in_turn(
    ours: Callable[[], Times], theirs: Callable[[], Times], rounds: int
) -> dict[str, float]:
    """Times of two things, and their ratio."""
    times = [(ours(), theirs()) for _ in range(rounds)]
    here, there = ([pair[i] for pair in times] for i in range(2))
    return {**milliseconds("jax", here), **milliseconds("xla", there), **compared(here, there)}


class Torch:
    """The same step in a process of another Python, which waits while others are measured."""

    def __init__(self, python: str, kind: str, threads: int | None) -> None:
        script = Path(__file__).with_name("policies_torch.py")
        self._process = subprocess.Popen(
            [python, str(script), kind, str(BATCH)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | ({"OMP_NUM_THREADS": str(threads)} if threads else {}),
        )

    def __call__(self) -> Times:
        """Times of one update."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write("step\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit("PyTorch's process ended; its error is above.")
        return Times(*map(float, line.split()))

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()


def training(
    kind: str, python: str | None, rounds: int, threads: int | None = None
) -> dict[str, float]:
    """A train step here, and, if asked for, in PyTorch, and the ratio."""
    ours = train_step(kind)
    if python is None:
        return milliseconds("jax", [ours() for _ in range(rounds)])
    theirs = Torch(python, kind, threads)
    theirs()
    times = [(ours(), theirs()) for _ in range(rounds)]
    theirs.close()
    here, there = ([pair[i] for pair in times] for i in range(2))
    return {**milliseconds("jax", here), **milliseconds("torch", there), **compared(here, there)}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--torch-python", help="Python with PyTorch, see policies_torch.py")
    parser.add_argument("--torch-threads", type=int, help="its threads; one waits for no other")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--preset", default="laptop", help="of which actions are sampled")
    parser.add_argument("--only", choices=("sampling", "act", "diffusion", "encodings", "kernels"))
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    measured = {}
    if args.only in (None, "sampling"):
        measured["sampling"] = sampling(args.rounds, args.preset)
    for kind in ("act", "diffusion"):
        if args.only in (None, kind):
            measured[kind] = training(kind, args.torch_python, args.rounds, args.torch_threads)
    if args.only == "encodings":
        measured |= encodings(args.rounds)
    if args.only == "kernels":
        measured |= kernels(args.rounds)
    if args.json:
        print(json.dumps(measured, indent=2))
        return
    for name, values in measured.items():
        print(name, ", ".join(f"{k} {v:.3g}" for k, v in values.items()))


if __name__ == "__main__":
    main()
