"""Held-out pairs of a run as exhibits: rolled out anew, under the sphere of all outcomes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax
import numpy as np

from jaxcam.config.datasets import CollectConfig
from jaxcam.config.train import TrainConfig
from jaxcam.data.collection import dataset_path
from jaxcam.data.demos import read_demos
from jaxcam.data.pairs import Pairs, make_pairs
from jaxcam.errors import ConfigError, DatasetError, JaxcamError
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.files.paths import home
from jaxcam.interrupts import check_stop
from jaxcam.rays import spherical
from jaxcam.reports.camera_figures import angle_ticks, smoothed_rate
from jaxcam.results.rows import Row
from jaxcam.results.stats import latest_rows
from jaxcam.runs.foreign import ForeignRecord, has_foreign, read_foreign_record
from jaxcam.runs.identity import RECORDED, read_config
from jaxcam.runs.rollouts import as_usual, own_conditions, read_run_rows
from jaxcam.sim import make_task
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.mujoco.scene import Scene
from jaxcam.training.checkpoint import load_policy_inputs, rebuild_policy
from jaxcam.viewer.bodies import grip_places
from jaxcam.viewer.exhibit import RED, Exhibit, Outcomes, Viewpoint, Way
from jaxcam.viewer.simulated import (
    Course,
    bystanders,
    grip_way,
    seen_pairs,
    trainers,
    training_cameras,
)


@dataclass(frozen=True)
class Rolled:
    """A run whose rollouts are looked at.

    Attributes:
        folder: Of the run.
        config: Its settings.
        rows: Of one split under the run's own conditions, the newest of each rollout.
    """

    folder: Path
    config: TrainConfig | ForeignRecord
    rows: Sequence[Row]

    @classmethod
    def open(cls, folder: Path, split: str, step: int | None) -> "Rolled":
        """Reads a run's rows.

        Args:
            folder: Of the run.
            split: Which pairs: `test` or `validation`.
            step: Checkpoint whose rows are wanted; all when None.

        Raises:
            ConfigError: It learned from recorded episodes, or its settings are damaged.
            DatasetError: It has no such rows.
        """
        config = read_foreign_record(folder) if has_foreign(folder) else read_config(folder)
        if config.task == RECORDED:
            raise ConfigError(
                f"{folder} learned from recorded episodes, of which there are no rollouts. Look at "
                "its dataset instead: python -m jaxcam.view DATASET"
            )
        rows = [
            row
            for row in as_usual(latest_rows(read_run_rows(folder)), config)
            if row.split == split and (step is None or row.step == step) and row.finished
        ]
        if not rows:
            which = f"{split} pairs" + (f" at step {step}" if step is not None else "")
            raise DatasetError(
                f"{folder}: no rollouts of {which}. Make some: python -m jaxcam.evaluate {folder}"
            )
        return cls(folder, config, rows)

    def pairs(self) -> dict[int, str]:
        """What came of each pair, in words, by its number."""
        by_pair: dict[int, list[Row]] = {}
        for row in sorted(self.rows, key=lambda row: (row.pair, row.step)):
            by_pair.setdefault(row.pair, []).append(row)
        return {pair: _outcome(rows) for pair, rows in by_pair.items()}

    def exhibit(self, pair: int) -> Exhibit:
        """A pair, rolled out anew where that is possible."""
        row = max((row for row in self.rows if row.pair == pair), key=lambda row: row.step)
        task = make_task(self.config.task)
        world = task.scene(self.config.scene)
        chosen = make_pairs(task, world, self.config.views, row.split, [pair])
        qpos, notes = self._roll(row, chosen)
        start = type(chosen.start)(*(part[0] for part in chosen.start))
        cameras_of = partial(seen_pairs, task, world, own_conditions(self.config))
        watching = jax.tree.map(lambda part: part[0], cameras_of(chosen, row.split, [pair]))
        course = Course(task, world, start, qpos, watching, test=True)
        bodies, no_bodies = course.bodies()
        shown, few = course.viewpoints()
        cameras, no_cameras = self._training_cameras(course)
        ways: tuple[Way, ...] = ()
        if isinstance(world, Scene):
            ways = (grip_way(course, grip_places(world, qpos)),)
        numbers = list(self.pairs())
        everybody = make_pairs(task, world, self.config.views, row.split, numbers)
        is_other = np.array(numbers) != pair
        others = jax.tree.map(
            lambda part: part[is_other].reshape(-1, *part.shape[2:]),
            cameras_of(everybody, row.split, numbers),
        )
        return Exhibit(
            title=f"{self.config.task}, {self.config.scene}",
            subtitle=f"{self.folder.name}, step {row.step}: {row.split} pair {pair}, "
            f"{_outcome([row])}",
            rate=CONTROL_HZ,
            bodies=bodies,
            viewpoints=(
                *shown,
                *cameras,
                *bystanders(course, others, "test", RED),
            ),
            ways=ways,
            outcomes=(self._outcomes(course, everybody.cameras[:, 0]),),
            notes=tuple(note for note in (*notes, no_bodies, few, no_cameras) if note),
        )

    def _roll(self, row: Row, chosen: Pairs) -> tuple[np.ndarray, list[str]]:
        """Joint positions [T, nq] of a rollout made anew, or of its start alone, and notes."""
        try:
            inputs = load_policy_inputs(self.folder, row.step)
            candidate = Candidate(rebuild_policy(inputs), inputs.params, self.folder, row.step)
            evaluator = Evaluator(
                inputs.config, row.width or 50, row.engine, row.ensemble, inputs.config.conditions
            )
            (anew,), done = evaluator.run(candidate, row.split, [row.pair], check_stop)
        except JaxcamError as error:
            why = f"Viewed is the start only, since the rollout cannot be made anew: {error}"
            return chosen.start.qpos, [why]
        qpos = np.asarray(done.qpos)[: int(done.steps[0]) + 1, 0]
        if (anew.success, anew.steps) == (row.success, row.steps):
            return qpos, ["The rollout was made anew, and ends as its row says."]
        return qpos, [
            f"The rollout was made anew and ends otherwise ({_outcome([anew])}) than its row says "
            f"({_outcome([row])}): another machine or version has other last digits."
        ]

    def _training_cameras(self, course: Course) -> tuple[tuple[Viewpoint, ...], str]:
        config = self.config
        if isinstance(config, ForeignRecord):
            return (), ""
        path = home(config.dataset) if config.dataset else dataset_path(CollectConfig.of(config))
        try:
            demos = read_demos(path, task=config.task)
        except (JaxcamError, OSError):
            return (), f"The run's dataset is not at {path}: its cameras are not shown."
        return trainers(course, demos, training_cameras(demos)), ""

    def _outcomes(self, course: Course, cameras: np.ndarray) -> Outcomes:
        """What came of all pairs, over the sphere of their first cameras [pairs, 4, 4]."""
        base_from_world, centre = course.base_from_world, np.array(course.task.cameras.centre)
        labels = self.pairs()
        won = [[bool(row.success) for row in self.rows if row.pair == pair] for pair in labels]
        rates = np.array([np.mean(outcomes) for outcomes in won])
        angles = np.rad2deg(np.stack(spherical(cameras, centre)[:2], 1))
        table = np.column_stack([angles, rates, [len(outcomes) for outcomes in won]])
        across, up = angle_ticks(table)
        smooth = smoothed_rate(table, across, up)
        azimuth, elevation = np.deg2rad(
            np.meshgrid(
                np.linspace(across[0], across[-1], smooth.shape[1]),
                np.linspace(up[0], up[-1], smooth.shape[0]),
            )
        )
        _, _, distance = spherical(cameras, centre)
        directions = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            -1,
        )
        return Outcomes(
            name="success",
            places=_moved(base_from_world, cameras[:, :3, 3]),
            rates=rates,
            labels=tuple(f"pair {pair}: {words}" for pair, words in labels.items()),
            numbers=tuple(labels),
            shell=_moved(base_from_world, centre + float(np.mean(distance)) * directions),
            smooth=smooth,
        )


def _outcome(rows: Sequence[Row]) -> str:
    """What came of rollouts of one pair."""
    if len(rows) > 1:
        return f"{sum(bool(row.success) for row in rows)} of {len(rows)} succeed"
    return f"success in {rows[0].steps} steps" if rows[0].success else "failure"


def _moved(a_from_b: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ a_from_b[:3, :3].T + a_from_b[:3, 3]
