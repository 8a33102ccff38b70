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

from jaxcam.config.fields import to_json
from jaxcam.config.sizes import rows_and_columns
from jaxcam.config.train import TrainConfig
from jaxcam.devices import check_same, gathered, has_accelerator, is_first, joined
from jaxcam.interop.lerobot.starting import read_start
from jaxcam.interrupts import Stopped, interrupts
from jaxcam.models import Policy, PolicySpec, Stats, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.models.weights.load import Weights, load, record_weights
from jaxcam.pipeline.plan import show_plan
from jaxcam.pipeline.sources import Source, source_of
from jaxcam.runs.folder import RunDir
from jaxcam.runs.identity import resolve
from jaxcam.runs.interface import write_interface
from jaxcam.training.checkpoint import checkpoint_steps
from jaxcam.training.loggers import check_loggers
from jaxcam.training.loop import Trainer


def train(config: TrainConfig, console: Console | None = None) -> int:
    """Trains one run, or several side by side, from wherever they stand to their reports.

    Args:
        config: Settings; those that are left open are filled from the preset.
        console: For progress; silent when None.

    Returns:
        The process's exit code: 0, or 130 or 143 when a signal stopped it after saving.
    """
    source = source_of(config, console)
    configs = each_seed(source.complete(config))
    first = configs[0]
    check_loggers(first.log)
    weights = starting_weights(source, configs)  # what cannot work is told before anything is made
    check_same("settings", to_json(replace(first, run_dir="", data_dir="", dataset="")))
    if console:
        show_plan(configs, console)
    with ExitStack() as stack:
        runs = [stack.enter_context(RunDir.open(c)) if is_first() else None for c in configs]
        try:
            return _train(source, configs, runs, weights, console)
        except Stopped as stopped:
            _say_how_to_go_on(console, "Stopped; what is done is kept.")
            return stopped.exit_code


def _train(
    source: Source,
    configs: Sequence[TrainConfig],
    runs: Sequence[RunDir | None],
    weights: Weights | None,
    console: Console | None,
) -> int:
    """What `train` does once the run folders are its own."""
    for config, run in zip(configs, runs, strict=True):
        if run:
            write_interface(run.path, source.interface(config))
        if run and weights and not checkpoint_steps(run.path):
            record_weights(run.path, weights)
    dataset = source.dataset(configs, console)
    check_same("demonstrations", dataset.fingerprint)
    policy = policy_of(source, configs[0], dataset.stats())
    answer = "Stopping after this update; once more stops now, without saving."
    with interrupts(answer, raises=False) as stop:  # only here is there something to save
        states = Trainer(configs[0], dataset, policy, stop, console).fit(configs, runs, weights)
    if any(gathered(bool(stop))):
        steps = ", ".join(str(step) for step in sorted({int(s.step) for s in states}))
        _say_how_to_go_on(console, f"Stopped at update {steps} and saved.")
        return stop.exit_code or 143  # another process was asked
    for config, run, state in zip(configs, runs, states, strict=True):
        source.conclude(config, run, policy, state, dataset, console)
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


def policy_of(source: Source, config: TrainConfig, stats: Stats | None = None) -> Policy:
    """The policy that a run trains.

    Args:
        source: Its demonstrations.
        config: Resolved settings.
        stats: Statistics of the demonstrations; without them the policy has the same shapes only.

    Raises:
        ConfigError: Its settings do not go together.
    """
    settings = policy_settings(config, source.prompts, source.base_from_actions(config))
    action_dim, proprio_dim = source.sizes(config)
    height, width = rows_and_columns(config.resolution)
    spec = PolicySpec(
        action_dim=action_dim,
        proprio_dim=proprio_dim,
        views=config.views,
        height=height,
        width=width,
        chunk=settings.chunk,
        obs_steps=settings.obs_steps,
    )
    return make_policy(settings, spec, stats or blank_stats(spec))


def starting_weights(source: Source, configs: Sequence[TrainConfig]) -> Weights | None:
    """The weights that new runs start from; None without, or when all resume.

    Raises:
        ConfigError: The policy cannot be built.
        CheckpointError: The weights are not its, or were trained with other settings.
    """
    policy, file = policy_of(source, configs[0]), configs[0].weights
    if not file or all(checkpoint_steps(config.run_dir) for config in configs):
        return None
    weights = read_start(file, policy)
    shapes = jax.eval_shape(policy.init, jax.random.key(0))
    load(weights, jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes))
    return weights


def main(config: TrainConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    with joined(config.distributed):
        return train(config, console if is_first() else None)
