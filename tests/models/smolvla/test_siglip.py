"""The vision tower."""

import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.models.smolvla.siglip import Siglip


def test_tower_takes_patches_row_by_row():
    tower = Siglip(32, 8, 16, 1, 2, 16, rngs=nnx.Rngs(0), dtype=jnp.float32)
    image = np.zeros((1, 32, 32, 3), np.float32)
    plain = tower(image, remat=False)
    image[0, 8:16, 24:32] = 1  # The second row's last patch.
    assert np.abs(tower(image, remat=False) - plain).max(-1)[0].argmax() == 7
