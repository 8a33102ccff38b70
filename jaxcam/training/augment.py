"""What training does to pictures: a random crop, which their cameras follow, and other colours."""

import jax

from jaxcam.config.train import TrainConfig
from jaxcam.models import Batch
from jaxcam.models.color_jitter import color_jitter
from jaxcam.models.crops import random_crop
from jaxcam.training.state import Augment

_COLORS = 1
"""What the key of the colours is folded with: crops have it as it is."""


def augmentation(config: TrainConfig) -> Augment:
    """The random changes of a run's settings, as a function of a batch and a key."""

    def augment(batch: Batch, key: jax.Array) -> Batch:
        batch = random_crop(batch, key, smallest=config.crop_min)
        colors = jax.random.fold_in(key, _COLORS)
        return color_jitter(batch, colors, strength=config.color_jitter)

    return augment
