"""What every policy is: three pure functions and the record of what they were made from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import jax

Params: TypeAlias = dict[str, Any]
"""Nested dict of float32 arrays; the keys mirror the attribute paths of the module."""

Obs: TypeAlias = Mapping[str, jax.Array]
"""``image`` uint8 or float32 in 0 to 255 [B, V, H, W, 3], ``K`` [B, V, 3, 3] in pixels of it,
``base_from_camera`` [B, V, 4, 4] with OpenCV axes, ``proprio`` [B, P]."""

Batch: TypeAlias = Mapping[str, jax.Array]
"""An observation with ``action`` float32 [B, T, A] in raw units, ``keyframe`` float32 [B, T, 3]
(base frame, metres) and ``is_pad`` bool [B, T]."""

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
    """

    init: Callable[[jax.Array], Params]
    loss: Callable[[Params, Batch, Key], tuple[jax.Array, dict[str, jax.Array]]]
    act: Callable[[Params, Obs, Key], jax.Array]
    config: Any
    spec: PolicySpec
    execute: int
