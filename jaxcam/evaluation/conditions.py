"""Pairs under conditions: cameras with other intrinsics, and poses that are told with errors.

What is drawn follows from the number of the pair, the view and the split alone: every policy gets
the same, and an error of another size has the same direction.
"""
# K is K; JAX's own annotations are partial.
# pyright: reportConstantRedefinition=false, reportUnknownMemberType=false

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.config.conditions import Conditions, degrees_and_cm
from jaxcam.config.names import RaysFrom
from jaxcam.data.header import optics_ranges
from jaxcam.data.pairs import Pairs
from jaxcam.data.splits import SPLITS, TRAIN_CAMERAS
from jaxcam.rays import invert, perturb
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.optics import at_size, sample_optics
from jaxcam.sim.observing import Told
from jaxcam.sim.task import Task
from jaxcam.sim.world import World


@dataclass(frozen=True)
class SeenPairs:
    """How pairs are seen: the arrays of `jaxcam.sim.rollout.Episodes` that cameras make.

    Attributes:
        K: Intrinsics in pixels [B, V, 3, 3].
        lens: Packed coefficients [B, V, 9]; None where all are pinholes.
        claimed: What policies are told that is not so.
        fovy_deg: Of each pair's first camera [B]; None where all have the task's.
    """

    K: np.ndarray
    lens: np.ndarray | None
    claimed: Told
    fovy_deg: np.ndarray | None


@dataclass(frozen=True)
class ConditionedPairs:
    """Makes pairs to be seen under conditions.

    Attributes:
        task: What is done.
        world: Where.
        conditions: Which.
        rays_from: Whether policies are told the intrinsics of their cameras, or the usual ones.
        cameras: After how many cameras the first comes again, as in the pairs of `train`; never
            if None.
    """

    task: Task
    world: World
    conditions: Conditions
    rays_from: RaysFrom = "true"
    cameras: int | None = None

    def seen(
        self, pairs: Pairs, split: str, numbers: Sequence[int], size: tuple[int, int]
    ) -> SeenPairs:
        """How some pairs are seen.

        Args:
            pairs: Which.
            split: `test`, `validation` or `train`.
            numbers: Of the pairs.
            size: Height and width of the pictures.
        """
        count, views = pairs.cameras.shape[:2]
        usual = np.broadcast_to(intrinsics(self.task.fovy_deg, *size), (count, views, 3, 3))
        K, lens, fovy = usual, None, None
        if ranges := optics_ranges(self.conditions, self.task.fovy_deg):
            rows = views * np.array(numbers)[:, None] + np.arange(views)
            rows = rows % self.cameras if self.cameras else rows
            drawn = sample_optics(ranges, int(rows.max()) + 1, _seed(split))
            K = at_size(drawn[0], *size)[rows]
            lens = None if drawn[1] is None else drawn[1][rows]
            fovy = np.rad2deg(2 * np.arctan(0.5 / drawn[0][rows[:, 0], 1, 1]))
        claimed = Told(
            K=usual if self.rays_from == "nominal" and ranges else None,
            base_from_camera=self._poses(pairs, split, numbers),
            drift=self._drift(split, numbers, views),
        )
        return SeenPairs(K, lens, claimed, fovy)

    def _poses(self, pairs: Pairs, split: str, numbers: Sequence[int]) -> np.ndarray | None:
        """The poses that are told, with their errors [B, V, 4, 4]; None without errors."""
        degrees, cm = degrees_and_cm(self.conditions.pose_noise)
        if not degrees and not cm:
            return None
        true = (invert(self.world.world_from_base) @ pairs.cameras).astype(np.float32)
        keys = _keys(split, numbers, true.shape[1], 0)
        size = np.deg2rad(degrees), cm / 100
        wrong = jax.vmap(jax.vmap(lambda pose, key: perturb(pose, key, *size)))(true, keys)
        return np.asarray(wrong)

    def _drift(self, split: str, numbers: Sequence[int], views: int) -> np.ndarray | None:
        """How the poses that are told drift [B, V, 6] (rad/s, m/s); None where they do not."""
        degrees, cm = degrees_and_cm(self.conditions.pose_drift)
        if not degrees and not cm:
            return None
        keys = _keys(split, numbers, views, 1)
        way = np.asarray(jax.vmap(jax.vmap(lambda key: jax.random.normal(key, (2, 3))))(keys))
        way = way / np.linalg.norm(way, axis=-1, keepdims=True)
        return np.concatenate([way[..., 0, :] * np.deg2rad(degrees), way[..., 1, :] * cm / 100], -1)


def _seed(split: str) -> int:
    """Seed of the cameras of a split; those of `train` are the demonstrations'."""
    return SPLITS[split].cameras if split in SPLITS else TRAIN_CAMERAS


def _keys(split: str, numbers: Sequence[int], views: int, what: int) -> jax.Array:
    """Random keys [B, V] of the views of pairs."""
    root = jax.random.fold_in(jax.random.key(_seed(split)), what)
    of_pair = jax.vmap(lambda number: jax.random.fold_in(root, number))(jnp.array(numbers))
    each = jnp.arange(views)
    return jax.vmap(lambda key: jax.vmap(lambda v: jax.random.fold_in(key, v))(each))(of_pair)
