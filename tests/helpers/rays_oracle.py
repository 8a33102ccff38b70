"""Ray-maps and lenses in float64 from their definition, and random cameras, for tests of rays."""

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


LENSES = {
    "four": ("opencv", [-0.28, 0.09, 1e-3, -2e-3]),
    "five": ("opencv", [-0.3, 0.12, 2e-3, 1e-3, -0.02]),
    "eight": ("opencv", [0.4, -1.9, 8e-4, -5e-4, 1.2, 0.3, -1.7, 1.1]),
    "pincushion": ("opencv", [0.2, 0.05, -1e-3, 2e-3, 0.01]),
    "folding": ("opencv", [-0.45, 0.0, 0.0, 0.0, 0.0]),
    "fisheye": ("fisheye", [-0.03, 0.01, 1e-3, -5e-4]),
    "strong fisheye": ("fisheye", [0.12, -0.05, 0.02, -4e-3]),
}
"""Kind and coefficients of lenses as calibrations give them; one folds inside its image."""


def oracle_distort(x, y, kind, d):
    """Where OpenCV's formulas put a point, field or not."""
    r2 = x * x + y * y
    if kind == "fisheye":
        r = np.sqrt(r2)
        theta = np.arctan(r)
        powers = sum(c * theta ** (2 * i + 2) for i, c in enumerate(d))
        scale = np.where(r > 0, theta * (1 + powers) / np.where(r > 0, r, 1), 1)
        return x * scale, y * scale
    k1, k2, p1, p2, k3, k4, k5, k6 = [*d, *[0.0] * (8 - len(d))]
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def oracle_limit(kind, d):
    """Largest angle off the axis (radians) up to which points move outwards, by walking there."""
    angle = np.linspace(0, np.pi / 2 - 0.01, 200_001)
    radial = [*d[:2], 0.0, 0.0, *d[4:]] if kind == "opencv" else d
    x, _ = oracle_distort(np.tan(angle), np.zeros_like(angle), kind, radial)
    falls = np.flatnonzero((np.diff(x) <= 0) | (x[1:] < 0))
    return angle[falls[0]] if len(falls) else angle[-1]
