"""Small policies and made-up inputs for the tests of the models."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import jax
import numpy as np

from jaxcam.config.names import Conditioning, names_of
from jaxcam.models import ACT_PRESETS, ActConfig, Policy, PolicySpec, make_policy
from jaxcam.models.conditioning import IN_ATTENTION, NOMINAL_POSE
from jaxcam.rays.rotations import matrix_from_rotvec

CONDITIONINGS = names_of(Conditioning)
OUTSIDE_ATTENTION = [name for name in CONDITIONINGS if name not in IN_ATTENTION]
"""The ways that need no transformer."""
CHUNK, ACTION, PROPRIO = 4, 3, 5


def tiny(preset: str, conditioning: str, **changes: object) -> ActConfig:
    """A preset shrunk so that a test compiles in a moment, `paper` with the small encoder too.

    `none` is the image-only twin of the preset's default.
    """
    sizes = {"encoder_width": 8, "keypoints": 3, "chunk": CHUNK, "width": 16, "layers": 1}
    if preset == "paper":
        sizes |= {"encoder": "small", "encoder_depth": 1, "heads": 2, "hidden": 16}
        sizes |= {"latent_layers": 1, "latent_dim": 4}
    if preset == "attention":
        sizes |= {"heads": 2, "hidden": 16, "fold": 2}
    twin_of = ACT_PRESETS[preset].network if conditioning == "none" else conditioning
    settings = {"conditioning": conditioning, "twin_of": twin_of} | sizes | changes
    return replace(ACT_PRESETS[preset], **settings)  # pyright: ignore[reportArgumentType]


def make_stats(seed: int = 3) -> dict[str, np.ndarray]:
    """Means and deviations that are not 0 and 1."""
    rng = np.random.default_rng(seed)
    return {
        "action_mean": rng.normal(size=ACTION).astype(np.float32),
        "action_std": rng.uniform(0.5, 2, ACTION).astype(np.float32),
        "keyframe_mean": np.zeros(3, np.float32),
        "keyframe_std": np.full(3, 0.5, np.float32),
        "proprio_mean": rng.normal(size=PROPRIO).astype(np.float32),
        "proprio_std": rng.uniform(0.5, 2, PROPRIO).astype(np.float32),
    }


def make_batch(
    size: int = 16, views: int = 1, batch: int = 2, seed: int = 0
) -> dict[str, np.ndarray]:
    """A batch of noise seen by cameras near the nominal one."""
    rng = np.random.default_rng(seed)
    pose = np.tile(np.array(NOMINAL_POSE, np.float32), (batch, views, 1, 1))
    pose[..., :3, 3] += rng.uniform(-0.2, 0.2, (batch, views, 3))
    focal = 1.2 * size
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], np.float32)
    return {
        "image": rng.integers(0, 256, (batch, views, size, size, 3), dtype=np.uint8),
        "K": np.tile(K, (batch, views, 1, 1)),
        "base_from_camera": pose,
        "proprio": rng.normal(size=(batch, PROPRIO)).astype(np.float32),
        "action": rng.normal(size=(batch, CHUNK, ACTION)).astype(np.float32),
        "keyframe": rng.normal(size=(batch, CHUNK, 3)).astype(np.float32),
        "is_pad": np.arange(CHUNK) >= np.array([[CHUNK], [CHUNK - 2]])[:batch],
    }


def laptop(conditioning: str) -> str:
    """The laptop's preset that has a way of conditioning."""
    return "attention" if conditioning in IN_ATTENTION else "laptop"


def moved(batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same pictures, said to be taken from elsewhere."""
    pose = batch["base_from_camera"].copy()
    pose[..., :3, 3] += (0.1, -0.2, 0.15)
    pose[..., :3, :3] = matrix_from_rotvec(np.array([0.1, 0.2, -0.3])) @ pose[..., :3, :3]
    return batch | {"base_from_camera": pose}


# Tests compile far longer than they run.
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}


def jit(function: Callable) -> Callable:
    """Compile quickly instead of well."""
    return jax.jit(function, compiler_options=QUICK)


@cache
def make_plain(config: ActConfig, size: int = 16, views: int = 1) -> Policy:
    """The policy of a config for the inputs above."""
    spec = PolicySpec(ACTION, PROPRIO, views, size, size, config.chunk)
    return make_policy(config, spec, make_stats())


@cache
def make(config: ActConfig, size: int = 16, views: int = 1) -> Policy:
    """The same with its functions compiled."""
    policy = make_plain(config, size, views)
    return replace(policy, init=jit(policy.init), loss=jit(policy.loss), act=jit(policy.act))


def start(policy: Policy) -> dict:
    """Parameters of the usual size, made without compiling the policy's own `init`."""
    rng = np.random.default_rng(0)

    def fill(path: tuple, leaf: jax.ShapeDtypeStruct) -> np.ndarray:
        values = rng.normal(size=leaf.shape).astype(np.float32)
        if path[-1].key == "scale":
            return 1 + 0.1 * values
        return values / np.float32(np.prod(leaf.shape[:-1])) ** 0.5

    return jax.tree_util.tree_map_with_path(fill, shapes(policy))


def shapes(policy: Policy) -> dict:
    """Shapes and types of a policy's parameters, without computing them."""
    return jax.eval_shape(policy.init, jax.random.key(0))
