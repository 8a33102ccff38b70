"""Runs that stand at the same update, as one state that one compiled program updates."""

import contextlib
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import optax

from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import Dataset, stacked_batches
from jaxcam.devices import copied, data_mesh, part, replicated, shard, spread, stacked
from jaxcam.models import Batch, Policy
from jaxcam.training.augment import augmentation
from jaxcam.training.noise import pose_noise
from jaxcam.training.records import Records
from jaxcam.training.state import TrainState, Update, make_train_chunk
from jaxcam.training.watch import GradientWatch


@dataclass
class SeedRun:
    """A run in training."""

    seed: int
    records: Records
    state: TrainState
    """The state at the last `SideBySide.hand_out`."""

    @property
    def step(self) -> int:
        """Updates so far."""
        return int(self.state.step)


class SideBySide:
    """Runs that one compiled program updates together.

    Args:
        runs: The runs; they stand at the same update.
        config: Resolved settings of one of them; the others' differ in the seed.
        policy: What is trained.
        tx: The optimizer.
    """

    def __init__(
        self,
        runs: Sequence[SeedRun],
        config: TrainConfig,
        policy: Policy,
        tx: optax.GradientTransformation,
    ) -> None:
        self.runs = runs
        self.watches = [GradientWatch(run.seed) for run in runs]
        self._mesh = data_mesh(config.batch // config.accumulate)
        update = Update(
            policy.loss,
            tx,
            augment=augmentation(config),
            perturb=pose_noise(config.pose_noise, config.pose_noise_per),
            ema=config.ema,
            ema_power=config.ema_power,
            accumulate=config.accumulate,
        )
        where = replicated(self._mesh)
        self._update = make_train_chunk(update, seeds=len(runs), out_shardings=where)
        self._state = copied(self._mesh, stacked([run.state for run in runs]), donate=True)
        # Made where it lies: `device_put` takes no keys to other processes.
        self._root = jax.jit(
            lambda: stacked([jax.random.key(run.seed) for run in runs]), out_shardings=where
        )()
        self._metrics: list[Any] = []
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall time since the program was made."""
        return time.perf_counter() - self._began

    def update(self, batch: Batch) -> None:
        """Carry out one compiled call, on batches from `batches`."""
        batch = spread(self._mesh, batch, 1 if len(self.runs) == 1 else 2)
        self._state, metrics = self._update(self._state, batch, self._root)
        self._metrics.append(metrics)

    def hand_out(self) -> None:
        """Give each run its state."""
        for i, run in enumerate(self.runs):
            run.state = part(self._state, i, len(self.runs))

    def means(self, number: int) -> dict[str, float]:
        """Means of a run's metrics since the last `forget`. Waits for the updates."""
        metrics = [part(m, number, len(self.runs)) for m in self._metrics]
        return jax.tree.map(lambda *x: float(np.mean(np.concatenate(x))), *metrics)

    def forget(self) -> None:
        """Start the means anew."""
        self._metrics.clear()


def batches(
    dataset: Dataset, config: TrainConfig, seeds: Sequence[int], steps: range, **sizes: int
) -> Generator[tuple[int, Batch], None, None]:
    """Batches of this process for each compiled call, with the update that it begins with.

    Args:
        dataset: Where samples come from.
        config: Settings that the runs share.
        seeds: Of the runs. With several, arrays have the runs as their second axis.
        steps: Updates from the first to the last, without which step.
        **sizes: See `stacked_batches`.
    """
    streams = [
        stacked_batches(
            dataset, seed, steps.start, steps.stop, config.steps_per_call, config.batch,
            shard(), **sizes,
        )
        for seed in seeds
    ]  # fmt: skip
    with contextlib.ExitStack() as stack:
        for stream in streams:
            stack.enter_context(contextlib.closing(stream))
        for parts in zip(*streams, strict=True):
            step, batch = parts[0]
            if len(seeds) > 1:
                batch = {k: np.stack([b[k] for _, b in parts], 1) for k in batch}
            yield step, batch
