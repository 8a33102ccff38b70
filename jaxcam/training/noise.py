"""Errors of the camera poses that a policy is told in training, of a known size.

Where they come from decides what can be learned about them. Drawn anew for every sample, a policy
sees each episode under many of them; drawn once for each camera, of each episode or of all, they
are what calibrations leave behind, and a camera is always wrong in the same way.

All follow from the run's key and the step, or from the key and what the sample is of, so that a run
which goes on sees what it would have seen.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.config.conditions import degrees_and_cm
from jaxcam.config.names import PoseNoisePer
from jaxcam.models import Batch
from jaxcam.rays import perturb

PoseChange = Callable[[Batch, jax.Array, jax.Array], Batch]


def pose_noise(size: str, per: PoseNoisePer) -> PoseChange | None:
    """What puts errors into the poses of batches; None where there are none.

    Args:
        size: See `degrees_and_cm`: each camera turns by that angle about an axis through its
            centre, and moves by that distance; axis and direction are uniform on the sphere.
        per: What is drawn anew for: samples; or episodes and cameras, of batches that say which
            these are (`Dataset.named`).

    Returns:
        `change(batch, key, step)`: the batch with other `base_from_camera`, one error for all
        observations of a sample.
    """
    degrees, cm = degrees_and_cm(size)
    if not degrees and not cm:
        return None
    rotation, translation = np.deg2rad(degrees), cm / 100

    def wrong(poses: jax.Array, key: jax.Array) -> jax.Array:
        """Poses [..., 4, 4] with one error, that of the key."""
        error = perturb(jnp.eye(4), key, rotation, translation)
        turned = jnp.matmul(poses[..., :3, :3], error[:3, :3], precision="highest")
        moved = poses[..., :3, 3] + error[:3, 3]
        top = jnp.concatenate([turned, moved[..., None]], -1)
        return jnp.concatenate([top, poses[..., 3:, :]], -2)

    def change(batch: Batch, key: jax.Array, step: jax.Array) -> Batch:
        poses = batch["base_from_camera"]
        count, views = poses.shape[0], poses.shape[-3]
        if per == "sample":
            keys = jax.random.split(jax.random.fold_in(key, step), (count, views))
        else:
            demo = batch["demo"] if per == "episode" else jnp.zeros(count, int)
            of_demo = jax.vmap(jax.random.fold_in, (None, 0))(key, demo)
            of_camera = jax.vmap(jax.random.fold_in, (None, 0))
            keys = jax.vmap(of_camera)(of_demo, batch["camera"])
        wrong_poses = jax.vmap(jax.vmap(wrong, (-3, 0), -3))(poses, keys)
        kept = {name: x for name, x in batch.items() if name not in ("demo", "camera")}
        return {**kept, "base_from_camera": wrong_poses}

    return change
