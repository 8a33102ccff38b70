"""`python -m jaxcam.train`: demonstrations, pictures, training, evaluation, report, in one go.

Whatever exists is used; whatever was interrupted goes on when the same command is run again.
"""

import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace

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
from jaxcam.data.splits import NO_VALIDATION
from jaxcam.devices import check_same, gathered, has_accelerator, is_first, joined, own
from jaxcam.errors import ConfigError
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.files.paths import absolute
from jaxcam.interrupts import Stopped, interrupts
from jaxcam.models import Policy, PolicySpec, Stats, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.models.weights.load import Weights, load, read_weights, record_weights
from jaxcam.reports.camera_figures import ray_picture
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.reports.style import save
from jaxcam.results.stats import Estimate
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import read_rows, rows_file
from jaxcam.sim import engine_name, make_task
from jaxcam.sim.actions import action_dim, space_of
from jaxcam.sim.world import PROPRIO_DIM
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.loggers import check_loggers
from jaxcam.training.loop import Trainer
from jaxcam.training.state import TrainState


def train(config: TrainConfig, console: Console | None = None) -> int:
    """Trains one run, or several side by side, from wherever they stand to their reports.

    Args:
        config: Settings; those that are left open are filled from the preset.
        console: For progress; silent when None.

    Returns:
        The process's exit code: 0, or 130 or 143 when a signal stopped it after saving.
    """
    configs = each_seed(like_its_dataset(config))
    first = configs[0]
    check_loggers(first.log)
    engine_name(first.engine, make_task(first.task))
    weights = starting_weights(configs)  # what cannot work is told before anything is made
    check_same("settings", to_json(replace(first, run_dir="", data_dir="", dataset="")))
    with ExitStack() as stack:
        runs = [stack.enter_context(RunDir.open(c)) if is_first() else None for c in configs]
        try:
            return _train(configs, runs, weights, console)
        except Stopped as stopped:
            _say_how_to_go_on(console, "Stopped; what is done is kept.")
            return stopped.exit_code


def _train(
    configs: Sequence[TrainConfig],
    runs: Sequence[RunDir | None],
    weights: Weights | None,
    console: Console | None,
) -> int:
    """What `train` does once the run folders are its own."""
    for run in runs:
        if run and weights and not checkpoint_steps(run.path):
            record_weights(run.path, weights)
    dataset = training_data(configs, console)
    check_same("demonstrations", dataset.fingerprint)
    policy = policy_of(configs[0], dataset.stats())
    answer = "Stopping after this update; once more stops now, without saving."
    with interrupts(answer, raises=False) as stop:  # only here is there something to save
        states = Trainer(configs[0], dataset, policy, stop, console).fit(configs, runs, weights)
    if any(gathered(bool(stop))):
        steps = ", ".join(str(step) for step in sorted({int(s.step) for s in states}))
        _say_how_to_go_on(console, f"Stopped at update {steps} and saved.")
        return stop.exit_code or 143  # another process was asked
    for config, run, state in zip(configs, runs, states, strict=True):
        _finish(config, run, policy, state, console)
    return 0


def each_seed(config: TrainConfig) -> list[TrainConfig]:
    """The settings, in full, of each run that a command trains: one for each seed."""
    if not config.seeds:
        return [resolve(config, accelerator=has_accelerator())]
    folders = [config.run_dir and f"{config.run_dir}-{seed}" for seed in config.seeds]
    return [
        resolve(replace(config, seeds=(), seed=seed, run_dir=folder), accelerator=has_accelerator())
        for seed, folder in zip(config.seeds, folders, strict=True)
    ]


def _say_how_to_go_on(console: Console | None, what: str) -> None:
    if console:
        command = shlex.join(["python", "-m", "jaxcam.train", *sys.argv[1:]])
        console.print(f"{what} To go on, run the same command again:\n  {command}", soft_wrap=True)


def like_its_dataset(config: TrainConfig) -> TrainConfig:
    """The config with the demonstrations and cameras of the dataset that it names, if any."""
    if not config.dataset:
        return config

    header = read_demos(absolute(config.dataset), task=config.task, scene=config.scene).header
    counts = {"demos": header.train, "validation": header.valid, "n": header.n, "m": header.m}
    for name, count in counts.items():
        if getattr(config, name) not in (count, getattr(TrainConfig, name)):
            raise ConfigError(
                f"{name} is {count} in {config.dataset}, but {getattr(config, name)} was asked. "
                f"Leave --{name} out: a dataset brings its own."
            )
    return replace(config, **counts)


def training_data(configs: Sequence[TrainConfig], console: Console | None) -> Dataset:
    """What runs that differ in their seed are trained on."""
    config = configs[0]
    task = make_task(config.task)
    task.require()  # hours may pass until the evaluation needs its simulator
    if config.dataset:
        demos = read_demos(absolute(config.dataset), task=config.task, scene=config.scene)
    else:
        demos = collect(CollectConfig.of(config), console)
    if console and not demos.valid:
        console.print(f"{demos.path}: {NO_VALIDATION}", soft_wrap=True)
    samples = Samples(Layout.of(demos), len(demos.train))
    samples.check_views(config.views)
    seeds, obs_steps = [c.seed for c in configs], policy_settings(config, task.prompt).obs_steps
    wanted = samples.wanted(seeds, config.steps, config.batch, config.views, obs_steps)
    pictures = load_pictures(demos, config.resolution, console, wanted)
    space = space_of(config.action_space, config.rotations)
    return make_dataset(demos, pictures, space, task.scene(config.scene))


def policy_of(config: TrainConfig, stats: Stats | None = None) -> Policy:
    """The policy that a run trains.

    Args:
        config: Resolved settings.
        stats: Statistics of its demonstrations; without them the policy has the same shapes only.

    Raises:
        ConfigError: Its settings do not go together.
    """
    settings = policy_settings(config, make_task(config.task).prompt)
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


def starting_weights(configs: Sequence[TrainConfig]) -> Weights | None:
    """The weights that new runs start from; None without, or when all resume.

    Raises:
        ConfigError: The policy cannot be built.
        CheckpointError: The weights are not its.
    """
    policy, file = policy_of(configs[0]), configs[0].weights
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
    candidate = Candidate(policy, own(state.eval_params), absolute(config.run_dir), step)
    wanted = Wanted(pairs=config.pairs, videos=config.videos)
    estimate = evaluate(evaluator, candidate, wanted, console)
    if run is None:
        return
    _log_success(run, step, estimate)
    rows = [row for row in read_rows(rows_file(run.path)) if row.step == step]
    write_plots(run.path / "plots", read_metrics(run.path), rows)
    save(ray_picture(*evaluator.sight("test", 0)), run.path / "pictures" / "rays.png")
    report = write_report(run.path)
    if console:
        console.print(f"Success on {config.pairs} held-out pairs: {estimate}")
        console.print(f"Report: {report}", soft_wrap=True)


def _log_success(run: RunDir, step: int, estimate: Estimate) -> None:
    """Writes the result among the metrics, once."""
    if any(row["step"] == step and "success_rate" in row for row in read_metrics(run.path)):
        return
    rate = {"success_rate": estimate.value, "low": estimate.low, "high": estimate.high}
    run.log({"step": step, **rate, "pairs": estimate.clusters})


def main(config: TrainConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    with joined(config.distributed):
        return train(config, console if is_first() else None)
