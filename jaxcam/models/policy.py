"""What every policy is: three pure functions and the record of what they were made from."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeAlias, TypeVar

import jax
import numpy as np
from flax import nnx

from jaxcam.errors import ConfigError

C = TypeVar("C")
M = TypeVar("M", bound=nnx.Module)

Params: TypeAlias = dict[str, Any]
"""Nested dict of float32 arrays; the keys mirror the attribute paths of the module."""

Obs: TypeAlias = Mapping[str, jax.Array]
"""``image`` uint8 or float32 in 0 to 255 [B, V, H, W, 3], ``K`` [B, V, 3, 3] in pixels of it,
``base_from_camera`` [B, V, 4, 4] with OpenCV axes, ``proprio`` [B, P] and, where lenses are no
pinholes, ``distortion`` [B, V, 9] (`jaxcam.rays.lens.pack`). Policies that know several prompts are
told which by its number, ``instruction`` [B]; the first one where it is missing."""

CAMERA_INPUTS = ("image", "K", "base_from_camera", "distortion")
"""What an observation says of each view; `distortion` is missing where all are pinholes."""

Batch: TypeAlias = Mapping[str, Any]
"""Arrays of NumPy or JAX by name: an observation with ``action`` float32 [B, T, A] in raw units,
``keyframe`` float32 [B, T, 3] (base frame, metres), where the data has it, and ``is_pad`` bool
[B, T]: steps that are past an end or err on purpose. ``keyframe_is_pad`` [B, T] is the same of
keyframes, where they are unknown at other steps, too."""

TARGETS = ("action", "keyframe", "is_pad", "keyframe_is_pad")
"""What a batch has beside an observation."""

Stats: TypeAlias = Mapping[str, np.ndarray]
"""``action``, ``proprio`` and ``keyframe`` with ``_mean``, ``_std``, ``_min`` and ``_max`` each, of
the training data, in raw units."""

Key: TypeAlias = jax.Array | None
"""A JAX random key; ``None`` switches every random part (dropout, latent noise) off."""


@dataclass(frozen=True)
class PolicySpec:
    """The sizes a policy is built for."""

    action_dim: int
    proprio_dim: int
    views: int
    height: int
    width: int
    chunk: int
    obs_steps: int = 1
    """Observations the policy sees at once. With more than one, those of the steps before come
    first: ``image`` [B, S, V, H, W, 3] and so on, and chunks begin at the oldest one's step."""


@dataclass(frozen=True)
class Policy:
    """Three pure functions, safe under ``jit``, ``grad`` and ``vmap``.

    Attributes:
        init: ``init(key)`` draws the parameters.
        loss: ``loss(params, batch, key)`` gives a scalar and a dict of scalar metrics.
        act: ``act(params, obs, key)`` gives actions [B, T, A] in raw units.
        config: The policy's own settings.
        spec: The sizes it was built for.
        execute: How many actions of a chunk are executed before the policy is asked again.
        trained: ``trained(params)`` is False at the parameters that training leaves alone, whose
            gradient is zero; None is all that is not named ``frozen...``.
    """

    init: Callable[[jax.Array], Params]
    loss: Callable[[Params, Batch, Key], tuple[jax.Array, dict[str, jax.Array]]]
    act: Callable[[Params, Obs, Key], jax.Array]
    config: Any
    spec: PolicySpec
    execute: int
    trained: Callable[[Params], Any] | None = None

    @property
    def prompts(self) -> tuple[str, ...]:
        """What it can be asked for, in words; nothing where it does not read."""
        first = getattr(self.config, "prompt", "")
        return (first, *self.config.other_prompts) if first else ()


@dataclass(frozen=True)
class Family(Generic[C]):
    """One kind of policy: all that training, evaluation and checkpoints know of it.

    Attributes:
        config: Class of its settings, a frozen dataclass with ``chunk``, ``conditioning`` and
            ``compute_dtype``.
        presets: Its settings by the preset's name.
        make: Makes the policy from settings, sizes and statistics.
        conditioned: ``conditioned(config, conditioning)`` is the same policy, told of its cameras
            in another way.
        instructed: ``instructed(config, prompts)`` is the same policy, told what to do in words,
            or the things that it may be told; those that do not read stay as they are.
    """

    config: type[C]
    presets: Mapping[str, C]
    make: Callable[[C, PolicySpec, Stats], Policy]
    conditioned: Callable[[C, str], C]
    instructed: Callable[[C, Sequence[str]], C] = lambda config, prompts: config


def pure(
    build: Callable[[nnx.Rngs], M],
) -> tuple[Callable[[jax.Array], Params], Callable[[Params], M]]:
    """A module as pure functions.

    Args:
        build: Makes the module.

    Returns:
        ``init(key)``, which draws parameters as nested dicts with string keys, and
        ``network(params)``, which puts them back into the module.
    """
    graphdef, _ = nnx.split(nnx.eval_shape(lambda: build(_streams(0))))

    def init(key: jax.Array) -> Params:
        return _string_keys(nnx.to_pure_dict(nnx.split(build(_streams(key)))[1]))

    def network(params: Params) -> M:
        return nnx.merge(graphdef, nnx.restore_int_paths(params))

    return init, network


class _Stream(nnx.RngStream):
    """Flax's keys, counted by Python.

    A counter that is traced is asked for its sharding each time that it is set, which JAX answers
    with an error and a search for its origin: half of the time that tracing a module took.
    """

    drawn: int = 0

    def __call__(self) -> jax.Array:
        self.drawn += 1
        return jax.random.fold_in(self.key[...], self.drawn - 1)


def _streams(key: jax.Array | int) -> nnx.Rngs:
    rngs: Any = nnx.Rngs(key)
    rngs.default = _Stream(rngs.default.key[...], tag="default")
    return rngs


def _string_keys(tree: Any) -> Any:
    """Layer numbers as strings, so that parameters look the same in memory and in checkpoints."""
    if isinstance(tree, dict):
        return {str(name): _string_keys(value) for name, value in tree.items()}
    return tree


def blank_stats(spec: PolicySpec) -> dict[str, np.ndarray]:
    """Statistics of data that nobody has seen yet: for a policy that is only to be looked at."""
    sizes = {"action": spec.action_dim, "proprio": spec.proprio_dim, "keyframe": 3}
    values = {"mean": 0, "std": 1, "min": -1, "max": 1}
    return {
        f"{name}_{kind}": np.full(size, value, np.float32)
        for name, size in sizes.items()
        for kind, value in values.items()
    }


def keyframe_padding(batch: Batch) -> jax.Array:
    """Where the keyframes of a batch are not to be learned, bool [B, T]."""
    return batch.get("keyframe_is_pad", batch["is_pad"])


def check_sizes(chunk: int, spec: PolicySpec, stats: Stats) -> None:
    """Refuse a policy whose settings, sizes and statistics do not go together.

    Args:
        chunk: Actions that the policy predicts at a time.
        spec: Sizes of observations and actions.
        stats: Statistics of the training data.
    """
    if chunk != spec.chunk:
        raise ConfigError(
            f"The policy predicts {chunk} actions but the data has chunks of {spec.chunk}."
        )
    for name, expected in (("action", spec.action_dim), ("proprio", spec.proprio_dim)):
        for kind in ("mean", "std", "min", "max"):
            shape = np.shape(stats.get(f"{name}_{kind}", np.zeros(expected)))
            if shape != (expected,):
                raise ConfigError(
                    f"Statistics of {name} have shape {shape}; the policy expects ({expected},)."
                )


def statistic(stats: Stats, name: str) -> np.ndarray:
    """A statistic of the data, float32 [D].

    Args:
        stats: Of the data.
        name: Such as "action_mean".

    Raises:
        ConfigError: There is none, or it is no list of finite numbers.
    """
    value = np.asarray(stats.get(name))
    if value.dtype.kind not in "fiu" or value.ndim != 1 or not np.isfinite(value).all():
        got = "missing" if name not in stats else f"{value!r:.100}"
        raise ConfigError(f"Statistics: {name} is {got}, expected a list of finite numbers.")
    return value.astype(np.float32)
