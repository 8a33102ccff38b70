"""Where the grip went after a picture, and where a policy would have sent it, in the picture."""

from typing import Any

import jax
import numpy as np

from jaxcam.config.names import ActionMeaning
from jaxcam.data.batches import Dataset
from jaxcam.data.recorded.parts import Parts
from jaxcam.data.recorded.spaces import AGREE_M
from jaxcam.models import Policy
from jaxcam.models.policy import TARGETS
from jaxcam.rays import Camera
from jaxcam.reports.camera_figures import GripWay

SHOWN = 6
"""Pictures, of several episodes and moments."""


def grip_ways(
    policy: Policy,
    params: Any,
    dataset: Dataset,
    parts: Parts,
    grip: tuple[int, int, int],
    meaning: ActionMeaning,
) -> list[GripWay]:
    """Ways of the grip in some pictures of what training did not see.

    Args:
        policy: The policy.
        params: Its parameters.
        dataset: What it was trained on, with what was held out.
        parts: The demonstrations of that.
        grip: Columns of the state that are the grip's position (base frame, m).
        meaning: What actions are. The first three numbers of `eef_abs` are the grip's next
            position and of `eef_delta` by how much it moves, in metres in the base frame.
    """
    if meaning == "eef_abs" and _far(dataset, grip):
        meaning = "unknown"
    spec, held_out = policy.spec, np.arange(parts.train, len(parts.all))
    if not len(held_out):
        return []
    demos = held_out[np.linspace(0, len(held_out) - 1, SHOWN).astype(int)]
    share = np.linspace(0.1, 0.6, SHOWN)  # of the episode that has passed
    t = (share * (dataset.lengths[demos] - 1)).astype(int)
    views = np.broadcast_to(np.arange(spec.views), (SHOWN, spec.views))
    batch = dict(dataset.batch(demos, t, views, spec.chunk, spec.obs_steps))
    observed = {k: v for k, v in batch.items() if k not in TARGETS}
    chunks = np.asarray(jax.jit(policy.act)(params, observed, jax.random.key(0)))
    ways = []
    for i, (demo, step) in enumerate(zip(demos, t, strict=True)):
        last = min(step + chunks.shape[1], dataset.lengths[demo] - 1)
        recorded = dataset.proprio[demo, step : last + 1][:, list(grip)]
        sight = {  # through the first camera, at the newest of what is observed
            name: (observed[name][i] if spec.obs_steps == 1 else observed[name][i, -1])[0]
            for name in ("image", "K", "base_from_camera", "distortion")
            if name in observed
        }
        picture = sight["image"]
        height, width = picture.shape[:2]
        camera = Camera(
            sight["K"], sight["base_from_camera"], height, width, sight.get("distortion")
        )
        leads = _targets(chunks[i, :, :3], recorded[0], meaning)
        predicted = None if leads is None else _pixels(camera, np.stack([recorded[0], *leads]))
        ways.append(GripWay(picture, _pixels(camera, recorded), predicted, parts.all[demo].group))
    return ways


def _far(dataset: Dataset, grip: tuple[int, int, int]) -> bool:
    """Whether commanded positions are in another frame than the state's."""
    steps = np.arange(dataset.actions.shape[1]) < dataset.lengths[:, None]
    apart = dataset.actions[..., :3] - dataset.proprio[..., list(grip)]
    return float(np.median(np.linalg.norm(apart, axis=-1)[steps])) > AGREE_M


def _targets(moves: np.ndarray, start: np.ndarray, meaning: ActionMeaning) -> np.ndarray | None:
    """Positions [T, 3] that the first numbers of actions lead to; None where they are none."""
    if meaning == "eef_abs":
        return moves
    return start + np.cumsum(moves, 0) if meaning == "eef_delta" else None


def _pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    pixels, depth = camera.project(np.asarray(points, np.float64))
    return np.where(np.asarray(depth)[:, None] > 0, np.asarray(pixels), np.nan)
