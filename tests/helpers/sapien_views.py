"""Worlds of ManiSkill's Push, and views of its cube."""

import numpy as np

from jaxcam.rays import look_at
from jaxcam.sim.types import View

WORLDS = 3
HEIGHT, WIDTH = 96, 128
K = np.array([[210.0, 0, 70], [0, 190, 44], [0, 0, 1]])


def views(start, count=4):
    """The first episode seen from around its cube, near the grip's height."""
    angles = np.linspace(-1.2, 1.2, count)
    eyes = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), np.full(count, 0.35)], -1)
    poses = np.asarray(look_at(eyes, np.array([-0.05, 0.0, 0.08])))
    repeated = [np.repeat(x[:1], count, 0) for x in start]
    return View(*repeated, np.repeat(K[None], count, 0), poses)
