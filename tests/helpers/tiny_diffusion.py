"""Small Diffusion Policies for the tests of the models."""

from dataclasses import replace
from functools import cache

from policy_inputs import (
    ACTION,
    CHUNK,
    PROPRIO,
    jit,
    make_stats,
)

from jaxcam.models import PolicySpec, make_policy
from jaxcam.models.diffusion.config import DIFFUSION_PRESETS


def ranges():
    stats = make_stats()
    for name in ("action", "proprio"):
        stats[f"{name}_min"] = stats[f"{name}_mean"] - 1.5
        stats[f"{name}_max"] = stats[f"{name}_mean"] + 1.5
    return stats


def tiny(preset="laptop", conditioning="keypoints", **changes):
    twin_of = DIFFUSION_PRESETS[preset].network if conditioning == "none" else conditioning
    sizes = {"chunk": CHUNK, "execute": 0, "channels": (8, 16), "features": 8, "step_width": 8}
    sizes |= {"keypoints": 3, "conditioning": conditioning, "twin_of": twin_of}
    sizes |= {"encoder": "small", "encoder_depth": 1, "encoder_width": 8, "sample_steps": 5}
    return replace(DIFFUSION_PRESETS[preset], **sizes | changes)


@cache
def make(config, views=1, size=16):
    spec = PolicySpec(ACTION, PROPRIO, views, size, size, config.chunk, config.obs_steps)
    policy = make_policy(config, spec, ranges())
    return replace(policy, loss=jit(policy.loss), act=jit(policy.act))
