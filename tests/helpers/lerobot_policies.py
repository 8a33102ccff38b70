"""Small policies with made-up weights, as runs that LeRobot has a place for hold them."""

from dataclasses import asdict, replace

import numpy as np
from policy_inputs import start

from jaxcam.config.train import TrainConfig
from jaxcam.interop.lerobot.pipelines import STATISTICS
from jaxcam.models import FAMILIES, PolicySpec, make_policy
from jaxcam.runs.identity import resolve
from jaxcam.training.checkpoint import PolicyInputs

SMALL = {
    "act": {"chunk": 6, "execute": 2, "width": 16, "encoder_width": 16, "heads": 2, "hidden": 24,
            "layers": 1, "latent_layers": 1, "latent_dim": 4},
    "diffusion": {"chunk": 8, "execute": 2, "channels": (16, 32), "step_width": 16,
                  "keypoints": 4, "features": 8},
}  # fmt: skip
PROPRIO, ACTION, SIDE = 11, 7, 32


def settings_for(name, preset="lerobot", **changes):
    return replace(FAMILIES[name].presets[preset], **(SMALL[name] | changes))  # pyright: ignore


def inputs_of(settings, views=1, ensemble=0.0, draw=start):
    """A policy with made-up weights, as a run's checkpoint holds it."""
    name = next(n for n, f in FAMILIES.items() if f.config is type(settings))
    spec = PolicySpec(ACTION, PROPRIO, views, SIDE, SIDE, settings.chunk, settings.obs_steps)
    rng = np.random.default_rng(0)
    stats = {}
    for kind, size in (("action", ACTION), ("proprio", PROPRIO)):
        low, width = rng.normal(size=size), rng.uniform(0.5, 2, size)
        width[0] = 0  # a dimension that never varied
        values = (low + width / 2, width / 3, low, low + width)
        stats |= {
            f"{kind}_{k}": v.astype(np.float32) for k, v in zip(STATISTICS, values, strict=True)
        }
    config = TrainConfig(policy=name, preset="lerobot", views=views, ensemble=ensemble)
    params = draw(make_policy(settings, spec, stats))
    config = resolve(config, accelerator=False)
    return PolicyInputs(config, asdict(settings), asdict(spec), stats, params, 5)
