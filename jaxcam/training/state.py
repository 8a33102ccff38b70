"""The training state and the compiled update.

An update is a pure function of (state, batch, root key). Randomness comes from the root key, a
stream and the step alone, so a run that was stopped goes on exactly where it was.
"""

import dataclasses
import enum
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from jaxcam.config.train import TrainConfig
from jaxcam.errors import DivergedError
from jaxcam.models.policy import Batch, Params

Metrics = dict[str, jax.Array]
Loss = Callable[[Params, Batch, jax.Array], tuple[jax.Array, Metrics]]
Augment = Callable[[Batch, jax.Array], Batch]

MAX_BAD_STEPS = 10


class Stream(enum.IntEnum):
    """What a random number is for. Numbers are part of a run's identity: add, never renumber."""

    INIT = 0
    CROP = 2
    DROPOUT = 3
    POSE = 4


def stream_key(root: jax.Array, stream: Stream, index: int | jax.Array = 0) -> jax.Array:
    """The key of one stream at one index, such as the dropout of one step.

    Args:
        root: The run's key, `jax.random.key(seed)`.
        stream: What the key is for.
        index: Absolute index within the stream.
    """
    return jax.random.fold_in(jax.random.fold_in(root, stream), index)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TrainState:
    """All that an update changes; a checkpoint holds exactly this."""

    step: jax.Array
    """Updates so far, skipped ones included."""
    params: Params
    opt: optax.OptState
    bad_steps: jax.Array
    """Updates in a row that were skipped because they were not finite."""
    ema: Params | None = None
    """Moving average of the parameters, or None if the run keeps none."""

    @property
    def eval_params(self) -> Params:
        """The parameters that are evaluated."""
        return self.params if self.ema is None else self.ema


@dataclasses.dataclass(frozen=True)
class Update:
    """The parts of an update: loss, optimizer, moving average and augmentation."""

    loss: Loss
    """A policy's `loss`."""
    tx: optax.GradientTransformation
    """The optimizer."""
    augment: Augment | None = None
    """Changes the batch by a key, before the loss."""
    perturb: Callable[[Batch, jax.Array, jax.Array], Batch] | None = None
    """Changes the poses in the batch by the run's key of that and the step, before all else."""
    ema: float = 0.0
    """Largest decay of the moving average."""
    ema_power: float = 0.0
    """How the decay rises, see `ema_decay`."""
    accumulate: int = 1
    """Parts of the batch that gradients are summed over."""


def make_schedule(config: TrainConfig) -> optax.Schedule:
    """Learning rate over updates: linear warm-up, then constant or a cosine to `final_lr`."""
    start = config.lr / (config.warmup + 1)  # Not 0: the first update should count.
    if config.schedule == "constant":
        return optax.warmup_constant_schedule(start, config.lr, config.warmup)
    if config.schedule == "cosine_from_start":
        # As LeRobot's: what the warm-up takes, the cosine has done already when it sets in.
        warmup = optax.linear_schedule(start, config.lr, config.warmup)
        cosine = optax.cosine_decay_schedule(config.lr, config.steps, config.final_lr / config.lr)
        return lambda step: jnp.where(jnp.asarray(step) < config.warmup, warmup(step), cosine(step))
    return optax.warmup_cosine_decay_schedule(
        start, config.lr, config.warmup, config.steps, config.final_lr
    )


def is_trained(params: Params) -> Params:
    """False at parameters named ``frozen...``, which no policy trains."""
    return jax.tree_util.tree_map_with_path(
        lambda path, _: not path[-1].key.startswith("frozen"), params
    )


def make_optimizer(
    config: TrainConfig, trained: Callable[[Params], Params] | None = None
) -> optax.GradientTransformation:
    """Adam on gradients clipped by their global norm, with decoupled weight decay or L2.

    Args:
        config: Resolved settings.
        trained: Tree of booleans for parameters: False at those that stay as they are. Their
            gradient must be zero; the optimizer keeps nothing for them. None is `is_trained`.
    """
    clip = optax.clip_by_global_norm(config.clip_norm) if config.clip_norm else optax.identity()
    rate, betas = make_schedule(config), (config.beta1, config.beta2)
    if config.optimizer == "adamw":
        steps = [clip, optax.adamw(rate, *betas, weight_decay=config.weight_decay)]
    else:
        l2 = optax.add_decayed_weights(config.weight_decay)
        steps = [clip, l2, optax.adam(rate, *betas)]
    return optax.masked(optax.chain(*steps), trained or is_trained)


def ema_decay(step: jax.Array, largest: float, power: float) -> jax.Array | float:
    """Decay of the moving average at the update after `step` others.

    Diffusion Policy's: 1 - step^-power, from 0 up to the largest; with power 0 it is the largest.
    """
    if not power:
        return largest
    return jnp.minimum(1 - jnp.maximum(step, 1).astype(jnp.float32) ** -power, largest)


def init_state(
    init: Callable[[jax.Array], Params],
    tx: optax.GradientTransformation,
    root: jax.Array,
    *,
    ema: bool = False,
) -> TrainState:
    """The state before the first update.

    Args:
        init: A policy's `init`.
        tx: Optimizer.
        root: The run's key, `jax.random.key(seed)`.
        ema: Whether to keep a moving average of the parameters.
    """
    params = init(stream_key(root, Stream.INIT))
    return TrainState(
        step=jnp.int32(0),
        params=params,
        opt=tx.init(params),
        bad_steps=jnp.int32(0),
        # A copy, since the update donates the state and a buffer can be donated only once.
        ema=jax.tree.map(jnp.copy, params) if ema else None,
    )


def train_step(
    update: Update, state: TrainState, batch: Batch, root: jax.Array
) -> tuple[TrainState, Metrics]:
    """One update; skipped, and counted, if loss or gradient are not finite.

    Args:
        update: What it is made of.
        state: Before it.
        batch: Samples.
        root: The run's key.

    Returns:
        The state after the update, and scalars: those of the loss, "loss", "grad_norm", "skipped".
    """
    if update.perturb is not None:
        batch = update.perturb(batch, stream_key(root, Stream.POSE), state.step)
    if update.augment is not None:
        batch = update.augment(batch, stream_key(root, Stream.CROP, state.step))
    key = stream_key(root, Stream.DROPOUT, state.step)
    (value, metrics), grads = _gradient(update, state.params, batch, key)
    norm = optax.tree.norm(grads)
    is_good = jnp.isfinite(value) & jnp.isfinite(norm)

    changes, opt = update.tx.update(grads, state.opt, state.params)
    params = optax.apply_updates(state.params, changes)
    average = state.ema
    if average is not None:
        decay = ema_decay(state.step, update.ema, update.ema_power)
        average = jax.tree.map(lambda a, p: decay * a + (1 - decay) * p, average, params)
    new, old = (params, opt, average), (state.params, state.opt, state.ema)
    params, opt, average = jax.tree.map(lambda n, o: jnp.where(is_good, n, o), new, old)
    metrics = {**metrics, "loss": value, "grad_norm": norm, "skipped": 1.0 - is_good}
    bad_steps = jnp.where(is_good, 0, state.bad_steps + 1)
    return TrainState(state.step + 1, params, opt, bad_steps, average), metrics


def _gradient(
    update: Update, params: Params, batch: Batch, key: jax.Array
) -> tuple[tuple[jax.Array, Metrics], Params]:
    """Loss, its metrics and gradient: of the batch, or the mean over as many equal parts of it."""
    gradient, parts = jax.value_and_grad(update.loss, has_aux=True), update.accumulate
    if parts == 1:
        return gradient(params, batch, key)
    # Every so many-th sample, not a stretch: then each device goes on with its own ones.
    split = {k: x.reshape(-1, parts, *x.shape[1:]).swapaxes(0, 1) for k, x in batch.items()}

    def add(total: Any, part: tuple[Batch, jax.Array]) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, gradient(params, *part)), None

    shapes = jax.eval_shape(gradient, params, {k: x[0] for k, x in split.items()}, key)
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    total, _ = jax.lax.scan(add, zeros, (split, jax.random.split(key, parts)))
    return jax.tree.map(lambda x: x / parts, total)


def make_train_chunk(
    update: Update,
    *,
    seeds: int = 1,
    out_shardings: jax.sharding.Sharding | None = None,
) -> Callable[[TrainState, Batch, jax.Array], tuple[TrainState, Metrics]]:
    """Compile several updates into one call.

    Args:
        update: One of them.
        seeds: Runs that are updated side by side. With several, `state`, `root` and `metrics` have
            them as their first axis, `batches` as the second.
        out_shardings: Where the results lie; the compiler's choice when None.

    Returns:
        `train_chunk(state, batches, root) -> (state, metrics)`. Arrays in `batches` and `metrics`
        have the updates as their first axis. The state is donated: do not use it again.
    """

    def train_chunk(
        state: TrainState, batches: Batch, root: jax.Array
    ) -> tuple[TrainState, Metrics]:
        def step(state: TrainState, batch: Batch) -> tuple[TrainState, Metrics]:
            return train_step(update, state, batch, root)

        if jax.tree.leaves(batches)[0].shape[0] == 1:
            # Not a loop of one: on CPUs XLA runs convolutions in loops 6 to 17 times slower.
            state, metrics = step(state, jax.tree.map(lambda x: x[0], batches))
            return state, jax.tree.map(lambda x: x[None], metrics)
        return jax.lax.scan(step, state, batches)

    several = jax.vmap(train_chunk, in_axes=(0, 1, 0)) if seeds > 1 else train_chunk
    return jax.jit(several, donate_argnums=0, out_shardings=out_shardings)


def check_finite(state: TrainState, *, seed: int = 0, limit: int = MAX_BAD_STEPS) -> None:
    """Stop a run that has diverged. Waits for the update, so call it once per chunk or less.

    Args:
        state: After an update.
        seed: Of the run, for the message.
        limit: Skipped updates in a row that are too many.

    Raises:
        DivergedError: The last `limit` updates were not finite.
    """
    bad = int(state.bad_steps)
    if bad >= limit:
        raise DivergedError(
            f"Loss or gradient of seed {seed} was not finite in {bad} updates in a row, up to "
            f"update {int(state.step)}; the parameters are those from before. Likely causes: a "
            "learning rate that is too high (--lr), or non-finite numbers in the data; the last "
            "batch is in diverged.npz. The last checkpoint is whole."
        )
