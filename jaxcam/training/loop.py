"""The training loop: every seed from its newest whole checkpoint to the last update."""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import jax
from rich.console import Console

from jaxcam.config.train import TrainConfig
from jaxcam.console.paces import training_job
from jaxcam.console.progress import progress
from jaxcam.data.batches import Dataset
from jaxcam.devices import from_first, gathered, memory_lacks
from jaxcam.errors import DivergedError
from jaxcam.interrupts import Interrupt
from jaxcam.models import Batch, Policy
from jaxcam.models.weights.load import Weights, load_after
from jaxcam.runs.folder import RunDir
from jaxcam.training.records import Records
from jaxcam.training.side import make_side
from jaxcam.training.side_by_side import SeedRun, SideBySide, batches
from jaxcam.training.state import TrainState, check_finite, init_state, make_optimizer

QUICKLY = {"xla_backend_optimization_level": 0}
"""For a program that runs once: XLA's compiler takes a third of its time."""


class Trainer:
    """Trains runs that share everything but their seed.

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
        self.config, self.policy = config, policy
        self.dataset = replace(dataset, named=config.pose_noise_per != "sample")
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
            trained = [
                self._begin(config, run, weights, stack)
                for config, run in zip(configs, runs, strict=True)
            ]
            if self.console and all(run.step >= steps for run in trained):
                self.console.print(f"Trained to update {steps} already.")
            while behind := [run for run in trained if run.step < steps]:
                least = min(run.step for run in behind)
                group = [run for run in behind if run.step == least]
                others = [run.step for run in behind if run.step > least]
                with memory_lacks(*self._size()):
                    if self._advance(group, min(others, default=steps)):
                        break
        return [run.state for run in trained]

    def _size(self) -> tuple[str, str]:
        """The size of an update in words, and the flags that make it smaller."""
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
    ) -> SeedRun:
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
        init = jax.jit(policy.init, compiler_options=QUICKLY)
        if weights:
            init = load_after(init, weights, config.stem == "new")
        fresh = init_state(init, self._tx, jax.random.key(config.seed), ema=config.ema > 0)
        return SeedRun(config.seed, records, from_first(records.restore(fresh)))

    def _advance(self, runs: Sequence[SeedRun], goal: int) -> bool:
        """Updates runs side by side up to `goal`; whether they were stopped before."""
        config, first, stopping = self.config, runs[0].step, False
        group = SideBySide(runs, config, self.policy, self._tx)
        seeds = [run.seed for run in runs]
        job = training_job(config, len(runs))
        stream = batches(self.dataset, config, seeds, range(first, goal), **self._sizes)
        with (
            contextlib.closing(stream),
            progress(self.console, "training", config.steps, done=first, job=job) as advance,
        ):
            for step, batch in stream:
                group.update(batch)
                done = step + config.steps_per_call
                stopping = any(gathered(bool(self.stop)))
                logs = done % config.log_every == 0 or done == goal
                saves = done % config.save_every == 0 or done == goal or stopping
                note = self._record(group, done, batch, logs, saves) if logs or saves else ""
                advance(config.steps_per_call, note=note)
                if stopping:
                    break
        return stopping

    def _record(self, group: SideBySide, done: int, batch: Batch, logs: bool, saves: bool) -> str:
        """Writes down rows of metrics, checkpoints, or both; a note for the progress."""
        group.hand_out()
        note = ""
        for i, (run, watch) in enumerate(zip(group.runs, group.watches, strict=True)):
            if logs:
                self._check(run, batch)
                row = {"step": done, **group.means(i), **self._validation(run, done)}
                run.records.log(row | {"seconds": group.seconds})
                watch.look(row)
                note = f"loss {row['loss']:.3f}"
            if saves:
                run.records.save(run.state)
        if logs:
            group.forget()
        return note

    def _check(self, run: SeedRun, batch: Batch) -> None:
        """Stops a run that has diverged, and keeps the batch at which it did."""
        try:
            check_finite(run.state, seed=run.seed)
        except DivergedError:
            run.records.keep_batch(batch)
            raise

    def _validation(self, run: SeedRun, done: int) -> dict[str, float]:
        """A run's loss on the validation demonstrations, if it is time for it."""
        due = done % self.config.eval_every == 0 or done == self.config.steps
        if not self._held_out or not due:
            return {}
        return {"val_loss": float(self._validation_loss(run.state.eval_params, self._held_out))}
