"""Diffusion Policy's network has the size of the authors'."""

import jax
import numpy as np
from policy_inputs import (
    shapes,
)

from jaxcam.models import PolicySpec, make_policy
from jaxcam.models.diffusion.config import DIFFUSION_PRESETS


def test_paper_has_the_parameters_of_the_authors_network():
    stats = {f"{a}_{k}": np.ones(7) for a in ("action", "proprio") for k in ("mean", "min", "max")}
    config = DIFFUSION_PRESETS["paper"]
    params = shapes(make_policy(config, PolicySpec(7, 7, 1, 256, 256, 32), stats))
    count = {k: sum(x.size for x in jax.tree.leaves(v)) for k, v in params.items()}
    assert count["vision"] + count["features"] == 11_215_904
    assert count["unet"] == 252_647_047
