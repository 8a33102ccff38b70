"""The sections of benchmarks/gpu.py: each measures, and prints a line of JSON for each number.

python benchmarks/gpu_sections.py SECTION [--sizes full|toy] [--peak TFLOPS]
"""

import argparse
import dataclasses
import functools
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.config.names import Precision
from jaxcam.config.train import TrainConfig
from jaxcam.data.pairs import make_pairs
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.models import Policy, PolicySpec, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.rays import plucker
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_engine, make_painter, make_task
from jaxcam.sim.engine import Engine, OpenLoop
from jaxcam.sim.task import Task, starts
from jaxcam.sim.types import Command, State, View
from jaxcam.training.state import Update, init_state, make_optimizer, make_train_chunk

ON_CPU = jax.default_backend() == "cpu"
ENGINE = "native" if ON_CPU else "mjx-warp"
"""On a CPU the programs of mjx-warp take minutes to compile."""
OPEN_LOOP = OpenLoop()
ACTION, PROPRIO = 7, 9


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    maps: int
    side: int
    worlds: tuple[int, ...]
    steps: int
    pictures: int
    sides: tuple[int, ...]
    rollouts: int
    width: int
    presets: dict[str, str]
    batches: tuple[int, ...]
    """Of train steps; the first that fits into memory counts."""
    rounds: int


SIZES = {
    "full": Sizes(
        maps=256, side=256, worlds=(50, 500, 1500, 4096), steps=20, pictures=512, sides=(84, 256),
        rollouts=1500, width=500, presets=dict.fromkeys(("act", "diffusion", "smolvla"), "paper"),
        batches=(70, 32, 8), rounds=10,
    ),
    "toy": Sizes(
        maps=2, side=16, worlds=(2,), steps=2, pictures=2, sides=(16,), rollouts=2, width=2,
        presets={"act": "laptop", "diffusion": "laptop", "smolvla": "tiny"}, batches=(2,), rounds=1,
    ),
}  # fmt: skip


def say(what: str, value: float | str, unit: str, note: str = "") -> None:
    """A number that was measured."""
    value = float(value) if isinstance(value, int | float | np.number) else value
    print(json.dumps({"what": what, "value": value, "unit": unit, "note": note}), flush=True)


def seconds(function: Callable[[], Any], rounds: int) -> float:
    """Median time of a call; the first one, which compiles, does not count."""
    jax.block_until_ready(function())
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def cameras(count: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics and poses of Lift's cameras, float32."""
    task = make_task("lift")
    poses = make_pairs(task, task.scene("randomized"), 1, "validation", range(min(count, 32)))
    K = np.tile(intrinsics(task.fovy_deg, side), (count, 1, 1))
    return K.astype(np.float32), np.resize(poses.cameras[:, 0], (count, 4, 4)).astype(np.float32)


def rays(sizes: Sizes, peak: float | None) -> None:
    """Ray-maps, held against a copy of as much memory."""
    K, poses = map(jnp.asarray, cameras(sizes.maps, sizes.side))
    make = jax.jit(lambda K, poses: plucker(K, poses, sizes.side, sizes.side))
    took = seconds(lambda: make(K, poses), sizes.rounds)
    written = sizes.maps * sizes.side**2 * 6 * 4
    block = jnp.ones(written // 4, jnp.float32)
    copy = jax.jit(lambda x: x * 1.0001)  # reads and writes as much
    bandwidth = 2 * written / seconds(lambda: copy(block), sizes.rounds)
    say(f"ray-maps of {sizes.side}²", sizes.maps / took, "a second")
    say("written", written / took / 1e9, "GB/s")
    say("a copy reads and writes", bandwidth / 1e9, "GB/s")
    say("share of that bandwidth", 100 * written / took / bandwidth, "%")


def circles(state: State, steps: int) -> Command:
    """Circles of 5 cm, the hand opening and closing, each world at its own phase [B, T, ...]."""
    pose = np.concatenate([state.grip_position, rotvec_from_matrix(state.grip_rotation)], -1)
    angle = np.arange(steps)[None] / 8 + np.arange(len(pose))[:, None]
    target = np.repeat(np.asarray(pose)[:, None], steps, 1)
    target[..., 0] += 0.05 * np.sin(angle)
    target[..., 1] += 0.05 * np.cos(angle)
    return Command(target, np.sign(np.sin(angle)))


def moved(engine: Engine, task: Task, worlds: int, steps: int) -> Callable[[], Any]:
    """A function that moves so many worlds for so many control steps, open loop."""
    start = starts(task, engine.scene, range(worlds))
    chunk, success = circles(engine.reset(start), steps), task.success_in(engine.scene)
    return lambda: engine.run(OPEN_LOOP, chunk, start, success, steps)


def physics(sizes: Sizes, peak: float | None) -> None:
    """Control steps of three tasks, 25 physics steps each."""
    for worlds in sizes.worlds:
        for name in ("lift", "pick_place_can", "square"):
            task = make_task(name)
            engine = make_engine(ENGINE, task.scene("randomized"), "osc_pose", task.varied)
            run = moved(engine, task, worlds, sizes.steps)
            began = time.perf_counter()
            jax.block_until_ready(run())
            first = time.perf_counter() - began
            rate = worlds * sizes.steps / seconds(run, 1)
            what = f"{ENGINE} {name}, {worlds} worlds"
            say(what, rate, "control steps/s", f"first call {first:.0f} s")


def pictures(sizes: Sizes, peak: float | None) -> None:
    """Pictures from arrays on the host to arrays on the host."""
    task = make_task("lift")
    scene = task.scene("randomized")
    start = starts(task, scene, range(min(sizes.pictures, 32)))
    several = [np.resize(x, (sizes.pictures, *x.shape[1:])) for x in
               (start.qpos, start.geom_size, start.fixtures)]  # fmt: skip
    for side in sizes.sides:
        painter = make_painter(scene, side, varied=task.varied)
        view = View(*several, *cameras(sizes.pictures, side))
        took = seconds(
            lambda painter=painter, view=view: painter.rgb(view), max(1, sizes.rounds // 3)
        )
        say(f"pictures of {side}²", sizes.pictures / took, "a second")


def policy_of(
    kind: str, preset: str, precision: Precision, *changes: str
) -> tuple[Policy, TrainConfig]:
    """A policy of one camera, and the settings it is trained with."""
    words = ("tokens=(1,2,3,4)",) if kind == "smolvla" and preset == "paper" else ()
    config = TrainConfig(policy=kind, preset=preset, precision=precision,  # pyright: ignore
                         model=(*words, *changes))  # fmt: skip
    config = dataclasses.replace(resolve(config, accelerator=not ON_CPU), steps_per_call=1)
    settings = policy_settings(config, (make_task("lift").prompt,))
    side = int(config.resolution)
    spec = PolicySpec(ACTION, PROPRIO, 1, side, side, settings.chunk, settings.obs_steps)
    return make_policy(settings, spec, blank_stats(spec)), config


def batch_of(policy: Policy, count: int) -> dict[str, np.ndarray]:
    """Noise, seen by Lift's cameras."""
    rng, spec = np.random.default_rng(0), policy.spec
    K, poses = cameras(count, spec.height)
    scene = make_task("lift").scene("randomized")
    poses = np.linalg.inv(scene.world_from_base) @ poses
    return {
        "image": rng.integers(0, 256, (count, 1, spec.height, spec.width, 3), dtype=np.uint8),
        "K": K[:, None],
        "base_from_camera": poses[:, None].astype(np.float32),
        "proprio": rng.normal(size=(count, PROPRIO)).astype(np.float32),
        "action": rng.uniform(-1, 1, (count, spec.chunk, ACTION)).astype(np.float32),
        "keyframe": rng.normal(size=(count, spec.chunk, 3)).astype(np.float32),
        "is_pad": np.zeros((count, spec.chunk), bool),
    }


def rollouts(sizes: Sizes, peak: float | None) -> None:
    """Lift from held-out starts to the horizon, an untrained ACT acting."""
    policy, config = policy_of("act", sizes.presets["act"], "float32" if ON_CPU else "bfloat16")
    evaluator = Evaluator(config, sizes.width, ENGINE)
    params = jax.jit(policy.init)(jax.random.key(0))
    candidate = Candidate(policy, params, Path("untrained"), 0)
    took, ended = list[float](), 0
    for first in range(0, sizes.rollouts, sizes.width):
        numbers = range(first, min(first + sizes.width, sizes.rollouts))
        began = time.perf_counter()
        rows, _ = evaluator.run(candidate, "validation", numbers)
        took.append(time.perf_counter() - began)
        ended += sum(row.finished for row in rows)
        say(f"{len(numbers)} rollouts, call {len(took)}", took[-1], "s",
            "compiles" if len(took) == 1 else "")  # fmt: skip
    say(f"{sizes.rollouts} rollouts of Lift", sum(took), "s", f"{ended} ended")
    if len(took) > 1:
        say("compiled, so many would take", float(np.median(took[1:])) * len(took), "s")


def lowered_flops(kind: str, preset: str, precision: Precision, count: int) -> float:
    """Operations of an update, counted on the program as it was written; nothing is run."""
    changes = ("remat=False",) if kind == "smolvla" else ()
    policy, config = policy_of(kind, preset, precision, *changes)
    tx, root = make_optimizer(config, policy.trained), jax.random.key(0)
    state = jax.eval_shape(functools.partial(init_state, policy.init, tx), root)
    shapes = {k: jax.ShapeDtypeStruct((1, *v.shape), v.dtype)
              for k, v in batch_of(policy, count).items()}  # fmt: skip
    lowered = make_train_chunk(Update(policy.loss, tx)).lower(state, shapes, root)  # pyright: ignore
    return float((lowered.cost_analysis() or {})["flops"])


def training(sizes: Sizes, peak: float | None, *, kind: str) -> None:
    """Updates of a preset in bfloat16: loss, gradient, clipping, AdamW."""
    preset = sizes.presets[kind]
    policy, config = policy_of(kind, preset, "bfloat16")
    tx, root = make_optimizer(config, policy.trained), jax.random.key(0)
    update = make_train_chunk(Update(policy.loss, tx))
    for count in sizes.batches:
        batch = {k: jnp.asarray(v[None]) for k, v in batch_of(policy, count).items()}
        try:
            state = [init_state(policy.init, tx, root)]

            def step(state: list[Any] = state, batch: dict[str, Any] = batch) -> Any:
                state[0], metrics = update(state[0], batch, root)
                return metrics

            took = seconds(step, sizes.rounds)
        except jax.errors.JaxRuntimeError as error:
            if "RESOURCE_EXHAUSTED" not in str(error):
                raise
            say(f"{kind} {preset}, batch {count}", "no memory", "")
            state.clear()
            continue
        say(f"{kind} {preset}, batch {count}", 1e3 * took, "ms an update")
        flops = lowered_flops(kind, preset, "bfloat16", count)
        say("operations of an update", flops / 1e12, "TFLOP")
        say("rate", flops / took / 1e12, "TFLOP/s")
        if peak:
            say("share of peak", 100 * flops / took / 1e12 / peak, "%", f"of {peak:g} TFLOP/s")
        return


def parity(sizes: Sizes, peak: float | None) -> None:
    """The same computed here and on the CPU, in float32 at full precision."""
    host = jax.devices("cpu")[0]

    def both(function: Callable[..., Any], *inputs: Any) -> tuple[np.ndarray, np.ndarray]:
        with jax.default_matmul_precision("highest"):
            here = np.asarray(jax.jit(function)(*inputs))
            with jax.default_device(host):
                there = np.asarray(jax.jit(function)(*jax.device_put(inputs, host)))
        return here, there

    K, poses = cameras(min(sizes.maps, 16), sizes.side)
    here, there = both(lambda K, T: plucker(K, T, sizes.side, sizes.side), K, poses)
    say("rays, largest difference", abs(here - there).max(), "m, or 1")
    for kind, preset in (sizes.presets | {"smolvla": "tiny"}).items():
        policy, _ = policy_of(kind, preset, "float32")
        with jax.default_device(host):
            params = jax.jit(policy.init)(jax.random.key(0))
        params = jax.tree.map(np.asarray, params)
        batch = batch_of(policy, 2)
        here, there = both(lambda p, b, policy=policy: policy.loss(p, b, None)[0], params, batch)
        say(f"loss of {kind} {preset}", abs(here - there) / abs(there), "of itself")
    task, worlds = make_task("lift"), min(8, max(sizes.worlds))
    ends = []
    for name in ("native", ENGINE):
        engine = make_engine(name, task.scene("randomized"), "osc_pose", task.varied)
        progress, _ = moved(engine, task, worlds, sizes.steps)()
        ends.append(np.asarray(progress.state.grip_position))
    apart = np.linalg.norm(ends[0] - ends[1], axis=-1).max()
    say(f"grip after {sizes.steps} control steps", 1e3 * apart, "mm", f"{ENGINE} and native")


def measured() -> dict[str, Callable[[Sizes, float | None], None]]:
    """The sections by name."""
    kinds = {kind: functools.partial(training, kind=kind) for kind in SIZES["full"].presets}
    return {"rays": rays, "physics": physics, "pictures": pictures, "rollouts": rollouts,
            **kinds, "parity": parity}  # fmt: skip


def memory() -> Iterator[tuple[float, str]]:
    """The most that XLA held on the device (GB), where it says."""
    stats = jax.devices()[0].memory_stats() or {}
    if "peak_bytes_in_use" in stats:
        yield stats["peak_bytes_in_use"] / 1e9, "GB"


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("section", choices=[*measured()])
    parser.add_argument("--sizes", choices=[*SIZES], default="full")
    parser.add_argument("--peak", type=float)
    args = parser.parse_args()
    measured()[args.section](SIZES[args.sizes], args.peak)
    for most, unit in memory():
        say("peak memory of XLA", most, unit)


if __name__ == "__main__":
    main()
