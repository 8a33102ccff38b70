"""Ray-maps in float64 from their definition, and random cameras, for the tests of `jaxcam.rays`."""

import numpy as np
from hypothesis import strategies as st

from jaxcam.rays import Camera


def oracle(K, pose, height, width, offset=0.5):
    """(direction, moment) pixel by pixel: invert K, rotate, normalise, cross with the centre."""
    rays = np.empty((height, width, 6))
    for row in range(height):
        for column in range(width):
            pixel = np.array([column + offset, row + offset, 1.0])
            d = pose[:3, :3] @ np.linalg.inv(K) @ pixel
            d /= np.linalg.norm(d)
            rays[row, column] = *d, *np.cross(pose[:3, 3], d)
    return rays


def random_rotations(rng, batch=()):
    q, r = np.linalg.qr(rng.normal(size=(*batch, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=-2, axis2=-1))[..., None, :]
    q[..., 0] *= np.sign(np.linalg.det(q))[..., None]
    return q


def random_poses(rng, batch=()):
    poses = np.zeros((*batch, 4, 4))
    poses[..., :3, :3] = random_rotations(rng, batch)
    poses[..., :3, 3] = rng.uniform(-2, 2, (*batch, 3))
    poses[..., 3, 3] = 1
    return poses


def random_camera(seed, height=6, width=9, batch=()):
    """Any pose; 20 to 120 degrees of view, pixels not square, some skew, an off-centre K."""
    rng = np.random.default_rng(seed)
    K = np.zeros((*batch, 3, 3))
    K[..., 0, 0] = 0.5 * width / np.tan(rng.uniform(0.17, 1.05, batch))
    K[..., 1, 1] = 0.5 * height / np.tan(rng.uniform(0.17, 1.05, batch))
    K[..., 0, 1] = rng.uniform(-0.05, 0.05, batch) * K[..., 0, 0]
    K[..., 0, 2] = width * rng.uniform(0.1, 0.9, batch)
    K[..., 1, 2] = height * rng.uniform(0.1, 0.9, batch)
    K[..., 2, 2] = 1
    return Camera(K, random_poses(rng, batch), height, width)


seeds = st.integers(0, 2**32 - 1)
"""Seeds for `random_camera`; hypothesis shrinks them, the arrays come from NumPy."""
