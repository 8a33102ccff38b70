"""`python -m jaxcam.train`: demonstrations, frames, training, evaluation and a report, in one go.

Whatever exists is used; whatever was interrupted goes on when the same command is run again.
"""

import dataclasses
import functools
import logging
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from jaxcam.config import CollectConfig, TrainConfig, resolve
from jaxcam.errors import ConfigError, run_main
from jaxcam.fields import cli

if TYPE_CHECKING:
    from rich.console import Console

    from jaxcam.data import Dataset
    from jaxcam.models import Policy, Stats
    from jaxcam.rundir import Interrupt, RunDir
    from jaxcam.state import TrainState
    from jaxcam.weights import Weights

VIDEOS = 16
"""Rollouts shown in the final video."""


def train(config: TrainConfig, console: "Console | None" = None) -> int:
    """Trains one run from wherever it stands to its report.

    Args:
        config: settings; unset ones are filled from the preset.
        console: for progress; silent when None.

    Returns:
        The process's exit code: 0, or 130 or 143 when a signal stopped it after saving.
    """
    from jaxcam.rundir import RunDir, interrupts
    from jaxcam.weights import record_weights

    config = resolve(_like_its_dataset(config))
    weights = _checked_weights(config)  # what cannot work is told before anything is made
    with RunDir.open(config) as run:
        try:
            if weights:
                record_weights(run.path, weights)
            dataset = _dataset(config, console)
            policy = _policy(config, dataset.stats())
            with interrupts() as stop:  # only here is there something to save
                state = _fit(config, run, dataset, policy, weights, stop, console)
            if stop:
                _say_how_to_go_on(console, f"Stopped at update {int(state.step)} and saved.")
                return stop.exit_code
            _finish(config, run, policy, state, console)
        except KeyboardInterrupt:
            _say_how_to_go_on(console, "Stopped; what is done is kept.")
            return 130
    return 0


def _say_how_to_go_on(console: "Console | None", what: str) -> None:
    if console:
        command = shlex.join(["python", "-m", "jaxcam.train", *sys.argv[1:]])
        console.print(f"{what} To go on, run the same command again:\n  {command}", soft_wrap=True)


def _like_its_dataset(config: TrainConfig) -> TrainConfig:
    """The config with the demonstrations and cameras of the dataset that it names, if any."""
    if not config.dataset:
        return config
    from jaxcam.demos import read_demos

    header = read_demos(Path(config.dataset), task=config.task, scene=config.scene).header
    counts = {"demos": header.train, "validation": header.valid, "n": header.n, "m": header.m}
    for name, count in counts.items():
        if getattr(config, name) not in (count, getattr(TrainConfig, name)):
            raise ConfigError(
                f"{name} is {count} in {config.dataset}, but {getattr(config, name)} was asked. "
                f"Leave --{name} out: a dataset brings its own."
            )
    return dataclasses.replace(config, **counts)


def collect_config(config: TrainConfig) -> CollectConfig:
    """The dataset a run trains on; every training seed shares it."""
    names = [f.name for f in dataclasses.fields(CollectConfig) if f.name != "seed"]
    return CollectConfig(**{name: getattr(config, name) for name in names})


def _dataset(config: TrainConfig, console: "Console | None") -> "Dataset":
    from jaxcam.collect import collect
    from jaxcam.data import make_dataset
    from jaxcam.demos import read_demos
    from jaxcam.frames import load_frames
    from jaxcam.sim import make_task

    task = make_task(config.task)
    task.require()  # hours may pass until the evaluation needs its simulator
    if config.dataset:
        demos = read_demos(Path(config.dataset), task=config.task, scene=config.scene)
    else:
        demos = collect(collect_config(config), console)
    frames = load_frames(demos, config.resolution, console)
    return make_dataset(demos, frames, config.action_space, task.scene(config.scene))


def _policy(config: TrainConfig, stats: "Stats | None" = None) -> "Policy":
    """The policy that is trained; without statistics, one of the same shapes."""
    from jaxcam.actions import action_dim
    from jaxcam.models import PolicySpec, make_policy, policy_settings
    from jaxcam.models.policy import blank_stats
    from jaxcam.sim.world import PROPRIO_DIM

    settings = policy_settings(config)
    spec = PolicySpec(
        action_dim=action_dim(config.action_space),
        proprio_dim=PROPRIO_DIM,
        views=config.views,
        height=config.resolution,
        width=config.resolution,
        chunk=settings.chunk,
        obs_steps=settings.obs_steps,
    )
    return make_policy(settings, spec, stats or blank_stats(spec))


def _checked_weights(config: TrainConfig) -> "Weights | None":
    """The weights a new run starts from; None without, or when resuming.

    Raises:
        ConfigError: The policy cannot be built.
        CheckpointError: The weights are not its.
    """
    import jax
    import numpy as np

    from jaxcam.checkpoint import checkpoint_steps
    from jaxcam.weights import load, read_weights

    policy = _policy(config)
    if not config.weights or checkpoint_steps(config.run_dir):
        return None
    weights = read_weights(config.weights)
    shapes = jax.eval_shape(policy.init, jax.random.key(0))
    load(weights, jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes))
    return weights


def _fit(
    config: TrainConfig,
    run: "RunDir",
    dataset: "Dataset",
    policy: "Policy",
    weights: "Weights | None",
    stop: "Interrupt",
    console: "Console | None",
) -> "TrainState":
    """Updates from the newest whole checkpoint to the last step."""
    import jax
    import numpy as np

    from jaxcam.augment import random_crop
    from jaxcam.checkpoint import Checkpoints, make_side
    from jaxcam.data import stacked_batches
    from jaxcam.progress import progress
    from jaxcam.state import check_finite, init_state, make_optimizer, make_train_chunk
    from jaxcam.weights import load_after

    root, tx = jax.random.key(config.seed), make_optimizer(config, policy.trained)
    crop = functools.partial(random_crop, smallest=config.crop_min)
    update = make_train_chunk(
        policy.loss, tx, augment=crop, ema=config.ema, ema_power=config.ema_power
    )
    validation_loss = jax.jit(lambda params, batch: policy.loss(params, batch, None)[0])
    sizes = {
        "views": config.views, "chunk": policy.spec.chunk, "obs_steps": policy.spec.obs_steps
    }  # fmt: skip
    held_out = dataset.validation(**sizes) if config.validation else None
    side = make_side(
        config,
        settings=policy.config,
        spec=policy.spec,
        stats=dataset.stats(),
        data=dataset.fingerprint,
    )
    with Checkpoints(run.checkpoints, keep=config.keep) as checkpoints:
        init = load_after(policy.init, weights, config.stem == "new") if weights else policy.init
        state = init_state(init, tx, root, ema=config.ema > 0)
        if restored := checkpoints.restore_latest(state, expect=side):
            state = restored.state
            run.rewind(int(state.step))
        first = int(state.step)
        batches = stacked_batches(
            dataset, config.seed, first, config.steps, config.steps_per_call, config.batch,
            **sizes,
        )  # fmt: skip
        began, recent = time.perf_counter(), []
        with progress(console, "training", config.steps, done=first) as advance:
            for step, batch in batches:
                state, metrics = update(state, batch, root)
                recent.append(metrics)
                done = step + config.steps_per_call
                if done % config.log_every == 0 or done == config.steps:
                    check_finite(state)
                    means = jax.tree.map(lambda *x: float(np.mean(np.concatenate(x))), *recent)
                    row = {"step": done, **means, "seconds": time.perf_counter() - began}
                    if held_out and (done % config.eval_every == 0 or done == config.steps):
                        row["val_loss"] = float(validation_loss(state.eval_params, held_out))
                    run.log(row)
                    recent = []
                    advance(0, note=f"loss {row['loss']:.3f}")
                if done % config.save_every == 0 or done == config.steps or stop:
                    checkpoints.save(state, side)
                advance(config.steps_per_call)
                if stop:
                    batches.close()
                    break
    return state


def _finish(
    config: TrainConfig,
    run: "RunDir",
    policy: "Policy",
    state: "TrainState",
    console: "Console | None",
) -> None:
    """Evaluates the last checkpoint, draws, and writes the report."""
    from jaxcam.camera_plots import ray_picture
    from jaxcam.evaluate import Evaluator, evaluate
    from jaxcam.html import write_report
    from jaxcam.plot_style import save
    from jaxcam.plots import write_plots
    from jaxcam.rundir import read_jsonl

    evaluator = Evaluator(config)
    step = int(state.step)
    estimate = evaluate(
        evaluator,
        policy,
        state.eval_params,
        run.path,
        step=step,
        pairs=config.pairs,
        videos=VIDEOS,
        console=console,
    )
    metrics = read_jsonl(run.metrics)
    if not any(r["step"] == step and "success_rate" in r for r in metrics):
        run.log(
            {
                "step": step,
                "success_rate": estimate.value,
                "low": estimate.low,
                "high": estimate.high,
                "pairs": estimate.clusters,
            }
        )
    rows = [r for r in read_jsonl(run.path / "eval" / "rows.jsonl") if r["step"] == step]
    write_plots(run.path / "plots", read_jsonl(run.metrics), rows)
    save(ray_picture(*evaluator.sight("test", 0)), run.path / "pictures" / "rays.png")
    report = write_report(run.path)
    if console:
        console.print(f"Success on {config.pairs} held-out pairs: {estimate}")
        console.print(f"Report: {report}")


def main() -> None:
    """The command line."""
    config = cli(TrainConfig)
    from rich.console import Console
    from rich.logging import RichHandler

    console = Console()
    logging.basicConfig(
        level=logging.WARNING, format="%(message)s", handlers=[RichHandler(console=console)]
    )
    sys.exit(train(config, console))


if __name__ == "__main__":
    run_main(main)
