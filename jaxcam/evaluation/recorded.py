"""A policy on recorded episodes that it has not learned from: how far its actions are off.

Without a simulator there is no success. What can be said is how its actions differ from the
recorded ones, on new episodes and through new cameras, and by how much more when it is told poses
that are wrong: a policy that does not care where its camera is does not use what it is told.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from jaxcam.data.batches import Dataset
from jaxcam.data.recorded.parts import Parts
from jaxcam.models import Policy
from jaxcam.rays import perturb
from jaxcam.results.actions import ActionErrors

PER_EPISODE = 16
"""Steps of each episode that the policy is asked at, none that errs on purpose."""
POSE_ERRORS = ((0.0, 0.0), (5.0, 0.05))
"""Degrees and metres by which the poses that it is told are wrong."""


def action_errors(
    policy: Policy,
    params: Any,
    dataset: Dataset,
    parts: Parts,
    names: Sequence[str],
    step: int,
) -> list[ActionErrors]:
    """Errors on each group of held-out episodes, with right and with wrong poses.

    Args:
        policy: The policy.
        params: Its parameters.
        dataset: What it was trained on, with what was held out.
        parts: The demonstrations of that.
        names: Of the A numbers of an action.
        step: Updates of the checkpoint.
    """
    act = jax.jit(policy.act)
    scale = replace(dataset, axes=None).stats()["action_std"]  # not as cameras see them
    rows = []
    groups = dict.fromkeys(part.group for part in parts.all[parts.train :])
    for group in groups:
        demos = [i for i, part in enumerate(parts.all) if part.group == group]
        for degrees, metres in POSE_ERRORS:
            errors = np.stack(
                [_errors_of(act, policy, params, dataset, d, (degrees, metres)) for d in demos]
            )
            rows.append(ActionErrors(step, group, degrees, metres, tuple(names), scale, errors))
    return rows


def _errors_of(
    act: Any,
    policy: Policy,
    params: Any,
    dataset: Dataset,
    demo: int,
    pose_error: tuple[float, float],
) -> np.ndarray:
    """Mean absolute errors on one episode [T, A], NaN where it ends before all chunks reach."""
    spec = policy.spec
    t = dataset.samples.spread(demo, PER_EPISODE)
    views = np.broadcast_to(np.arange(spec.views), (PER_EPISODE, spec.views))
    batch = dict(dataset.batch(np.full(PER_EPISODE, demo), t, views, spec.chunk, spec.obs_steps))
    if any(pose_error):
        # A camera that stands is wrong in one way throughout the episode.
        still = np.broadcast_to(np.eye(4, dtype=np.float32), (spec.views, 4, 4))
        degrees, metres = pose_error
        moved = perturb(still, jax.random.key(demo), np.deg2rad(degrees), metres)
        batch["base_from_camera"] = batch["base_from_camera"] @ np.asarray(moved)
    # Chunks of data begin at the oldest observation, those of a policy at the newest.
    targets, is_pad = (batch.pop(name)[:, spec.obs_steps - 1 :] for name in ("action", "is_pad"))
    for name in ("keyframe", "keyframe_is_pad"):
        batch.pop(name, None)
    predicted = np.asarray(act(params, batch, jax.random.key(0)))
    errors = np.where(is_pad[..., None], np.nan, np.abs(predicted - targets))
    count = np.isfinite(errors).sum(0)
    return np.where(count, np.nansum(errors, 0) / np.maximum(count, 1), np.nan)
