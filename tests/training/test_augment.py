"""What training does to pictures: colours come behind crops, which are what they were without."""

from functools import partial

import jax
import numpy as np

from jaxcam.config.train import TrainConfig
from jaxcam.models.color_jitter import color_jitter
from jaxcam.models.crops import random_crop
from jaxcam.training.augment import augmentation


def test_colours_come_after_the_crop_and_leave_it_as_it_was():
    rng = np.random.default_rng(0)
    K = np.array([[20.0, 0, 10], [0, 20, 10], [0, 0, 1]], np.float32)
    image = rng.integers(0, 255, (3, 1, 20, 20, 3)).astype(np.uint8)
    batch, key = {"image": image, "K": np.broadcast_to(K, (3, 1, 3, 3))}, jax.random.key(5)
    crop = jax.jit(partial(random_crop, smallest=0.5))(batch, key)
    plain = jax.jit(augmentation(TrainConfig(crop_min=0.5)))(batch, key)
    np.testing.assert_array_equal(plain["image"], crop["image"])
    both = jax.jit(augmentation(TrainConfig(crop_min=0.5, color_jitter=0.3)))(batch, key)
    np.testing.assert_allclose(both["K"], crop["K"], rtol=1e-6)
    jitter = jax.jit(partial(color_jitter, strength=0.3))
    again = jitter(crop, jax.random.fold_in(key, 1))
    np.testing.assert_allclose(both["image"], again["image"], atol=1e-3)
    assert np.abs(np.asarray(both["image"]) - np.asarray(crop["image"])).mean() > 3
