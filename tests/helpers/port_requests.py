"""Good requests for policies with small pictures, and what is wrong with bad ones."""

import numpy as np

from jaxcam.models import PolicySpec
from jaxcam.runs.interface import Interface

NAMES = Interface(("front", "wrist"), ("x", "y", "grip"), ("dx", "dy"), 10.0, "Lift it.")
SPEC = PolicySpec(action_dim=2, proprio_dim=3, views=2, height=16, width=24, chunk=4)


def camera(height, width, x=0.0):
    """K and pose of a camera above the base."""
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], np.float32)
    pose = np.diag([1.0, -1, -1, 1]).astype(np.float32)
    pose[:3, 3] = x, 0, 1
    return K, pose


def request(views=NAMES.views, size=(32, 48), state=3, seed=0, **changes):
    """A good request, or one that `changes` spoil; None takes an entry away."""
    rng = np.random.default_rng(seed)
    entries = {"observation.state": rng.normal(size=state).astype(np.float32)}
    for i, view in enumerate(views):
        K, pose = camera(*size, x=i / 4)
        entries[f"observation.images.{view}"] = rng.integers(0, 256, (*size, 3), np.uint8)
        entries[f"camera.{view}.intrinsics"] = K
        entries[f"camera.{view}.base_from_camera"] = pose
    changed = entries | {name.replace("__", "."): value for name, value in changes.items()}
    return {name: value for name, value in changed.items() if value is not None}
