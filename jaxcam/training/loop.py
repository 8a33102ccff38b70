"""The training loop: every seed from its newest whole checkpoint to the last update."""

import collections
import contextlib
import functools
import logging
import statistics
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from rich.console import Console

from jaxcam.config.train import TrainConfig
from jaxcam.console.progress import progress
from jaxcam.data.batches import Batch, Dataset, stacked_batches
from jaxcam.devices import (
    copied,
    data_mesh,
    from_first,
    gathered,
    memory_lacks,
    part,
    replicated,
    shard,
    spread,
    stacked,
)
from jaxcam.errors import DivergedError
from jaxcam.models import Policy
from jaxcam.models.crops import random_crop
from jaxcam.models.weights.load import Weights, load_after
from jaxcam.runs.folder import RunDir
from jaxcam.runs.interrupts import Interrupt
from jaxcam.training.checkpoint import make_side
from jaxcam.training.records import Records
from jaxcam.training.state import (
    TrainState,
    check_finite,
    init_state,
    make_optimizer,
    make_train_chunk,
)

EXPLODED = 100
"""Times its usual size at which a gradient is worth a warning."""

_log = logging.getLogger(__name__)


@dataclass
class _Seed:
    """A run in training."""

    number: int
    records: Records
    state: TrainState

    @property
    def step(self) -> int:
        return int(self.state.step)


class Trainer:
    """What the runs of one training share.

    Args:
        config: Resolved settings of one of them; the others' differ in the seed.
        dataset: Demonstrations.
        policy: What is trained.
        stop: Whether a signal asked to stop.
        console: For progress; silent when None.
    """

    def __init__(
        self,
        config: TrainConfig,
        dataset: Dataset,
        policy: Policy,
        stop: Interrupt,
        console: Console | None = None,
    ) -> None:
        self.config, self.dataset, self.policy = config, dataset, policy
        self.stop, self.console = stop, console
        self._tx = make_optimizer(config, policy.trained)
        self._sizes = {
            "views": config.views, "chunk": policy.spec.chunk, "obs_steps": policy.spec.obs_steps
        }  # fmt: skip
        self._held_out = dataset.validation(**self._sizes) if config.validation else None
        self._validation_loss = jax.jit(lambda params, batch: policy.loss(params, batch, None)[0])

    def fit(
        self,
        configs: Sequence[TrainConfig],
        runs: Sequence[RunDir | None],
        weights: Weights | None = None,
    ) -> list[TrainState]:
        """Trains each run to the last update, or until a signal stops all after saving.

        Runs that stand at the same update go on side by side, those furthest behind first.

        Args:
            configs: Settings of the runs.
            runs: Their folders; None in a process that writes nothing.
            weights: What runs without a checkpoint start from; None is random.

        Returns:
            Their states.
        """
        steps = self.config.steps
        with contextlib.ExitStack() as stack:
            seeds = [
                self._begin(config, run, weights, stack)
                for config, run in zip(configs, runs, strict=True)
            ]
            if self.console and all(s.step >= steps for s in seeds):
                self.console.print(f"Trained to update {steps} already.")
            while behind := [s for s in seeds if s.step < steps]:
                least = min(s.step for s in behind)
                group = [s for s in behind if s.step == least]
                others = [s.step for s in behind if s.step > least]
                with memory_lacks(*self._size()):
                    if self._advance(group, min(others, default=steps)):
                        break
        return [s.state for s in seeds]

    def _size(self) -> tuple[str, str]:
        """What an update is, and what is smaller."""
        config = self.config
        return (
            f"An update of {config.batch} samples in {config.accumulate} parts, {config.precision}",
            f"--accumulate {2 * config.accumulate}, --precision bfloat16, a smaller --batch or "
            "--resolution. The last checkpoint is whole, but a run goes on with its own settings "
            "only: choose another --run-dir.",
        )

    def _begin(
        self,
        config: TrainConfig,
        run: RunDir | None,
        weights: Weights | None,
        stack: contextlib.ExitStack,
    ) -> _Seed:
        """A run as it was last saved."""
        policy = self.policy
        side = make_side(
            config,
            settings=policy.config,
            spec=policy.spec,
            stats=self.dataset.stats(),
            data=self.dataset.fingerprint,
        )
        records = stack.enter_context(Records(run, config, side))
        init = load_after(policy.init, weights, config.stem == "new") if weights else policy.init
        fresh = init_state(init, self._tx, jax.random.key(config.seed), ema=config.ema > 0)
        return _Seed(config.seed, records, from_first(records.restore(fresh)))

    def _advance(self, group: Sequence[_Seed], goal: int) -> bool:
        """Updates runs side by side up to `goal`; whether they were stopped before."""
        config, count, first = self.config, len(group), group[0].step
        mesh = data_mesh(config.batch // config.accumulate)
        update = make_train_chunk(
            self.policy.loss,
            self._tx,
            augment=functools.partial(random_crop, smallest=config.crop_min),
            ema=config.ema,
            ema_power=config.ema_power,
            accumulate=config.accumulate,
            seeds=count,
            out_shardings=replicated(mesh),
        )
        state = copied(mesh, stacked([seed.state for seed in group]), donate=True)
        # Made where it lies: `device_put` takes no keys to other processes.
        root = jax.jit(
            lambda: stacked([jax.random.key(seed.number) for seed in group]),
            out_shardings=replicated(mesh),
        )()
        watches = [_Watch(seed.number) for seed in group]
        began, recent, stopping = time.perf_counter(), [], False
        with (
            contextlib.closing(self._batches(group, first, goal)) as batches,
            progress(self.console, "training", config.steps, done=first) as advance,
        ):
            for step, batch in batches:
                state, metrics = update(state, spread(mesh, batch, 1 if count == 1 else 2), root)
                recent.append(metrics)
                done = step + config.steps_per_call
                stopping = any(gathered(bool(self.stop)))
                logs = done % config.log_every == 0 or done == goal
                saves = done % config.save_every == 0 or done == goal or stopping
                for i, seed in enumerate(group if logs or saves else ()):
                    seed.state = part(state, i, count)
                    if logs:
                        row = self._row(seed, [part(m, i, count) for m in recent], done, batch)
                        seed.records.log(row | {"seconds": time.perf_counter() - began})
                        watches[i].see(row)
                        advance(0, note=f"loss {row['loss']:.3f}")
                    if saves:
                        seed.records.save(seed.state)
                if logs:
                    recent = []
                advance(config.steps_per_call)
                if stopping:
                    break
        return stopping

    def _batches(
        self, group: Sequence[_Seed], first: int, last: int
    ) -> Generator[tuple[int, Batch], None, None]:
        """Batches of this process: those of several runs have the runs as their second axis."""
        config = self.config
        streams = [
            stacked_batches(
                self.dataset, seed.number, first, last, config.steps_per_call, config.batch,
                shard(), **self._sizes,
            )
            for seed in group
        ]  # fmt: skip
        with contextlib.ExitStack() as stack:
            for stream in streams:
                stack.enter_context(contextlib.closing(stream))
            for parts in zip(*streams, strict=True):
                step, batch = parts[0]
                if len(group) > 1:
                    batch = {k: np.stack([b[k] for _, b in parts], 1) for k in batch}
                yield step, batch

    def _row(
        self, seed: _Seed, metrics: Sequence[Any], done: int, batch: Batch
    ) -> dict[str, float]:
        """Means of a run's metrics since the last row, and its validation loss if it is time."""
        config = self.config
        try:
            check_finite(seed.state, seed=seed.number)
        except DivergedError:
            seed.records.keep_batch(batch)
            raise
        means = jax.tree.map(lambda *x: float(np.mean(np.concatenate(x))), *metrics)
        row = {"step": done, **means}
        if self._held_out and (done % config.eval_every == 0 or done == config.steps):
            loss = self._validation_loss(seed.state.eval_params, self._held_out)
            row["val_loss"] = float(loss)
        return row


class _Watch:
    """Warns of gradients that explode while they are finite."""

    def __init__(self, seed: int) -> None:
        self._seed, self._norms = seed, collections.deque[float](maxlen=20)

    def see(self, row: dict[str, float]) -> None:
        norm = row["grad_norm"]
        if len(self._norms) > 4 and norm > EXPLODED * (usual := statistics.median(self._norms)):
            _log.warning(
                "Seed %d: around update %d the gradient's norm is %.3g, %.0f times the usual "
                "%.3g: a lower --lr or --clip-norm may help.",
                self._seed, row["step"], norm, norm / usual, usual,
            )  # fmt: skip
        if np.isfinite(norm):
            self._norms.append(norm)
