"""Demonstrations given in a simulator: collected, rendered, and judged by rollouts of new pairs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console

from jaxcam.config.conditions import OPTICS, of_task
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.sizes import rows_and_columns
from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import Dataset, make_dataset, seen_by_cameras
from jaxcam.data.collection import collect
from jaxcam.data.demos import read_demos
from jaxcam.data.pictures import load_pictures
from jaxcam.data.samples import Layout, Samples, errors_of
from jaxcam.data.splits import NO_VALIDATION
from jaxcam.devices import own
from jaxcam.errors import ConfigError
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.files.paths import absolute
from jaxcam.models import Policy, policy_settings
from jaxcam.rays import invert
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.reports.camera_figures import ray_picture
from jaxcam.reports.run_figures import write_plots
from jaxcam.reports.run_page import write_report
from jaxcam.reports.style import save
from jaxcam.results.stats import Estimate
from jaxcam.runs.folder import RunDir
from jaxcam.runs.interface import Interface, simulated_interface
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import as_usual, read_rows, rows_file
from jaxcam.sim import engine_name, make_task
from jaxcam.sim.actions import action_dim, space_of
from jaxcam.sim.world import PROPRIO_DIM
from jaxcam.training.state import TrainState


@dataclass(frozen=True)
class Simulated:
    """Demonstrations of a task, in the file that the settings name or lead to.

    Attributes:
        task: The task's name.
    """

    task: str

    @property
    def prompts(self) -> tuple[str, ...]:
        """What the task asks for, in words."""
        return (make_task(self.task).prompt,)

    def complete(self, config: TrainConfig) -> TrainConfig:
        """The settings with the demonstrations and cameras of the dataset file, if one is named.

        Raises:
            DatasetError: The file cannot be read, or is of another task or scene.
            ConfigError: It has other numbers of them than are asked, or a setting is not for a
                task or for its engine.
        """
        if recorded := config.given("cameras grip action_is hold_out_view hold_out_episodes"):
            raise ConfigError(
                f"{recorded[0]} is for recorded datasets: give a folder as --dataset, or leave "
                "it out."
            )
        task = make_task(config.task)
        engine_name(config.engine, task)
        config = of_task(config, task.fovy_deg)
        if not config.dataset:
            return config
        header = read_demos(absolute(config.dataset), task=config.task, scene=config.scene).header
        counts = {"demos": header.train, "validation": header.valid, "n": header.n, "m": header.m}
        counts |= dict.fromkeys(OPTICS, "") | header.ranges
        for name, count in counts.items():
            if getattr(config, name) not in (count, getattr(TrainConfig, name)):
                raise ConfigError(
                    f"{name} is {count} in {config.dataset}, but {getattr(config, name)} was "
                    f"asked. Leave --{name} out: a dataset brings its own."
                )
        return replace(config, **counts)

    def sizes(self, config: TrainConfig) -> tuple[int, int]:
        """Numbers of an action, and of what the robot feels."""
        return action_dim(config.action_space), PROPRIO_DIM

    def base_from_actions(self, config: TrainConfig) -> np.ndarray:
        """The world that grip poses of the actions are in [4, 4]."""
        return invert(make_task(self.task).scene(config.scene).world_from_base)

    def interface(self, config: TrainConfig) -> Interface:
        """What a policy of the task is shown and answers, by name."""
        return simulated_interface(config)

    def dataset(self, configs: Sequence[TrainConfig], console: Console | None) -> Dataset:
        """What runs that differ in their seed are trained on; what is missing is made."""
        config = configs[0]
        task = make_task(config.task)
        task.require()  # hours may pass until the evaluation needs its simulator
        if config.dataset:
            demos = read_demos(absolute(config.dataset), task=config.task, scene=config.scene)
        else:
            demos = collect(CollectConfig.of(config), console)
        if console and not demos.valid:
            console.print(f"{demos.path}: {NO_VALIDATION}", soft_wrap=True)
        samples = Samples(Layout.of(demos), len(demos.train), errors=errors_of(demos.episodes))
        samples.check_views(config.views)
        seeds, obs_steps = (
            [c.seed for c in configs],
            policy_settings(config, self.prompts).obs_steps,
        )
        wanted = samples.wanted(seeds, config.steps, config.batch, config.views, obs_steps)
        pictures = load_pictures(demos, config.resolution, console, wanted)
        space = space_of(config.action_space, config.rotations)
        scene = task.scene(config.scene)
        dataset = make_dataset(demos, pictures, space, scene, config.ray_frame)
        if config.rays_from == "nominal":
            K = intrinsics(task.fovy_deg, *rows_and_columns(config.resolution))
            usual = np.broadcast_to(K, dataset.K.shape).astype(np.float32)
            dataset = replace(dataset, K=usual, distortion=None)
        return seen_by_cameras(dataset, config, self.base_from_actions(config))

    def conclude(
        self,
        config: TrainConfig,
        run: RunDir | None,
        policy: Policy,
        state: TrainState,
        dataset: Dataset,
        console: Console | None,
    ) -> None:
        """Evaluate the last checkpoint on held-out pairs, draw, and write the report."""
        del dataset  # new pairs are simulated
        evaluator = Evaluator(config, conditions=config.conditions)
        step = int(state.step)
        candidate = Candidate(policy, own(state.eval_params), absolute(config.run_dir), step)
        wanted = Wanted(pairs=config.pairs, videos=config.videos)
        estimate = evaluate(evaluator, candidate, wanted, console)
        if run is None:
            return
        _log_success(run, step, estimate)
        rows = as_usual(read_rows(rows_file(run.path)), config)
        rows = [row for row in rows if row.step == step]
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
