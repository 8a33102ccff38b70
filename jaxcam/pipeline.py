"""`python -m jaxcam.train`: demonstrations, pictures, training, evaluation and a report, in one go.

Whatever exists is used; whatever was interrupted goes on when the same command is run again.
"""

import dataclasses
import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from rich.console import Console

from jaxcam.config.datasets import CollectConfig
from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import Dataset, make_dataset
from jaxcam.data.collection import collect
from jaxcam.data.demos import read_demos
from jaxcam.data.pictures import load_pictures
from jaxcam.data.samples import Layout, Samples
from jaxcam.devices import check_same, gathered, is_first, joined, own
from jaxcam.errors import ConfigError
from jaxcam.evaluation.run import Evaluator, evaluate
from jaxcam.files.jsonl import read_jsonl
from jaxcam.models import Policy, PolicySpec, Stats, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.models.weights.load import Weights, load, read_weights, record_weights
from jaxcam.reports.camera_figures import ray_picture
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.reports.style import save
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.runs.interrupts import interrupts
from jaxcam.sim import make_task
from jaxcam.sim.actions import action_dim
from jaxcam.sim.world import PROPRIO_DIM
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.loggers import check_loggers
from jaxcam.training.loop import Trainer
from jaxcam.training.state import TrainState


def train(config: TrainConfig, console: Console | None = None) -> int:
    """Trains one run from wherever it stands to its report.

    Args:
        config: settings; unset ones are filled from the preset.
        console: for progress; silent when None.

    Returns:
        The process's exit code: 0, or 130 or 143 when a signal stopped it after saving.
    """
    configs = each_seed(_like_its_dataset(config))
    first = configs[0]
    check_loggers(first.log)
    weights = _checked_weights(configs)  # what cannot work is told before anything is made
    check_same("settings", to_json(replace(first, run_dir="", data_dir="", dataset="")))
    with ExitStack() as stack:
        runs = [stack.enter_context(RunDir.open(c)) if is_first() else None for c in configs]
        try:
            for run in runs:
                if run and weights and not checkpoint_steps(run.path):
                    record_weights(run.path, weights)
            dataset = _dataset(configs, console)
            check_same("demonstrations", dataset.fingerprint)
            policy = _policy(first, dataset.stats())
            with interrupts() as stop:  # only here is there something to save
                trainer = Trainer(first, dataset, policy, stop, console)
                states = trainer.fit(configs, runs, weights)
            if any(gathered(bool(stop))):
                steps = ", ".join(str(step) for step in sorted({int(s.step) for s in states}))
                _say_how_to_go_on(console, f"Stopped at update {steps} and saved.")
                return stop.exit_code or 143  # another process was asked
            for each, run, state in zip(configs, runs, states, strict=True):
                _finish(each, run, policy, state, console)
        except KeyboardInterrupt:
            _say_how_to_go_on(console, "Stopped; what is done is kept.")
            return 130
    return 0


def each_seed(config: TrainConfig) -> list[TrainConfig]:
    """The resolved settings of each run that a command trains."""
    if not config.seeds:
        return [resolve(config)]
    folders = [config.run_dir and f"{config.run_dir}-{seed}" for seed in config.seeds]
    return [
        resolve(replace(config, seeds=(), seed=seed, run_dir=folder))
        for seed, folder in zip(config.seeds, folders, strict=True)
    ]


def _say_how_to_go_on(console: Console | None, what: str) -> None:
    if console:
        command = shlex.join(["python", "-m", "jaxcam.train", *sys.argv[1:]])
        console.print(f"{what} To go on, run the same command again:\n  {command}", soft_wrap=True)


def _like_its_dataset(config: TrainConfig) -> TrainConfig:
    """The config with the demonstrations and cameras of the dataset that it names, if any."""
    if not config.dataset:
        return config

    header = read_demos(Path(config.dataset), task=config.task, scene=config.scene).header
    counts = {"demos": header.train, "validation": header.valid, "n": header.n, "m": header.m}
    for name, count in counts.items():
        if getattr(config, name) not in (count, getattr(TrainConfig, name)):
            raise ConfigError(
                f"{name} is {count} in {config.dataset}, but {getattr(config, name)} was asked. "
                f"Leave --{name} out: a dataset brings its own."
            )
    return replace(config, **counts)


def collect_config(config: TrainConfig) -> CollectConfig:
    """The dataset a run trains on; every training seed shares it."""
    names = [f.name for f in dataclasses.fields(CollectConfig) if f.name != "seed"]
    return CollectConfig(**{name: getattr(config, name) for name in names})


def _dataset(configs: Sequence[TrainConfig], console: Console | None) -> Dataset:
    """What runs that differ in their seed are trained on."""
    config = configs[0]
    task = make_task(config.task)
    task.require()  # hours may pass until the evaluation needs its simulator
    if config.dataset:
        demos = read_demos(Path(config.dataset), task=config.task, scene=config.scene)
    else:
        demos = collect(collect_config(config), console)
    samples = Samples(Layout.of(demos), len(demos.train))
    seeds, obs_steps = [c.seed for c in configs], policy_settings(config).obs_steps
    wanted = samples.wanted(seeds, config.steps, config.batch, config.views, obs_steps)
    pictures = load_pictures(demos, config.resolution, console, wanted)
    return make_dataset(demos, pictures, config.action_space, task.scene(config.scene))


def _policy(config: TrainConfig, stats: Stats | None = None) -> Policy:
    """The policy that is trained; without statistics, one of the same shapes."""
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


def _checked_weights(configs: Sequence[TrainConfig]) -> Weights | None:
    """The weights that new runs start from; None without, or when all resume.

    Raises:
        ConfigError: The policy cannot be built.
        CheckpointError: The weights are not its.
    """
    policy, file = _policy(configs[0]), configs[0].weights
    if not file or all(checkpoint_steps(config.run_dir) for config in configs):
        return None
    weights = read_weights(file)
    shapes = jax.eval_shape(policy.init, jax.random.key(0))
    load(weights, jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes))
    return weights


def _finish(
    config: TrainConfig,
    run: RunDir | None,
    policy: Policy,
    state: TrainState,
    console: Console | None,
) -> None:
    """Evaluates the last checkpoint, draws, and writes the report."""
    evaluator = Evaluator(config)
    step = int(state.step)
    estimate = evaluate(
        evaluator,
        policy,
        own(state.eval_params),
        Path(config.run_dir),
        step=step,
        pairs=config.pairs,
        videos=config.videos,
        console=console,
    )
    if run is None:
        return
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


def main(config: TrainConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    with joined(config.distributed):
        return train(config, console if is_first() else None)
