"""A small exhibit of everything that a viewer shows, without a simulator."""

from dataclasses import replace

import numpy as np
from filmed import filmed

from jaxcam.viewer.exhibit import Body, Outcomes, Viewpoint
from jaxcam.viewer.recorded import episode

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
SIDES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
LENS = [-0.3, 0.1, 0.001, -0.001, 0.0]
"""A lens that bends lines by several pixels."""
SLAB = 0.1
"""Height (m) of the top of the slab that the cameras look at."""


def an_exhibit(length=6):
    """Three filmed cameras with a lens, one without pictures, a slab, and outcomes."""
    recorded = episode(filmed(episodes=1, length=length, lens=LENS), 0)
    slab = Body(
        "slab", (CUBE - [0.5, 0.5, 1]) * [1.0, 1.0, 0.05] + [0.4, 0, SLAB], SIDES,
        (90, 120, 160), np.eye(4),
    )  # fmt: skip
    poses = np.tile(np.eye(4), (length, 1, 1))
    poses[:, 0, 3] = np.linspace(0.2, 0.6, length)
    poses[:, 2, 3] = 0.3
    block = Body("block", 0.05 * CUBE, SIDES, (200, 80, 40), poses)
    camera = recorded.viewpoints[0].camera
    above = np.diag([1.0, -1, -1, 1])
    above[:3, 3] = 0.4, 0, 1.2
    other = Viewpoint(
        "test 0", "test", (213, 68, 44), replace(camera, world_from_camera=above), beside=True
    )
    azimuth, elevation = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(0.5, 1, 5))
    ball = [
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
    ]
    shell = np.stack(ball, -1)
    outcomes = Outcomes(
        "success", shell[2, ::4], np.array([0, 0.5, 1]), ("pair 0: failure", "pair 1", "pair 2"),
        (0, 1, 2), shell, np.linspace(0, 1, azimuth.size).reshape(azimuth.shape),
    )  # fmt: skip
    return replace(
        recorded,
        bodies=(slab, block),
        viewpoints=(*recorded.viewpoints, other),
        outcomes=(outcomes,),
    )
