"""How exact `jaxcam.calibrate` is, on drawn pictures whose truth is known.

    python benchmarks/calibration.py lens [--trials 20] [--kind opencv|fisheye]

Pictures are drawn by following each pixel's rays through a camera and its lens, with blur, noise,
light from one side, and boards that are seen in part.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.rays.lens import distort, normalised, pack, sight_lines
from jaxcam.robot.calibration.boards import Board
from jaxcam.robot.calibration.lens.fit import LensFit, fit_lens, ray_pixels

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from drawn import boards_shown  # noqa: E402

SIZE = (480, 640)
BOARD = Board("charuco", 11, 8, 0.023, 0.0161, "4x4_50")


def camera_of(rng: np.random.Generator, kind: str) -> tuple:
    """A webcam, or a wide one: K, size, coefficients and the lens's kind."""
    focal = rng.uniform(450, 750) if kind == "opencv" else rng.uniform(250, 350)
    centre = np.array([320.0, 240]) + rng.uniform(-10, 10, 2)
    K = np.array([[focal, 0, centre[0]], [0, focal * rng.uniform(0.998, 1.002), centre[1]],
                  [0, 0, 1]])  # fmt: skip
    if kind == "opencv":
        k1, k2, k3 = rng.uniform(-0.3, 0.1), rng.uniform(-0.05, 0.1), rng.uniform(-0.02, 0.02)
        return K, SIZE, [k1, k2, *rng.normal(0, 5e-4, 2), k3], kind
    return K, SIZE, [rng.uniform(-0.05, 0.05), rng.uniform(-0.02, 0.02), 0.003, -0.001], kind


def ray_errors(fit: LensFit, camera: tuple) -> tuple[np.ndarray, np.ndarray]:
    """How far (pixels) rays are off over the picture: as they are, and after one turn of all."""
    K, (height, width), coefficients, kind = camera
    pixels = ray_pixels(width, height)
    packed = np.asarray(pack(np.array(coefficients), kind))
    true = _sights(K, pixels, packed)
    there = np.isfinite(true).all(-1)
    x, y, _ = distort(*(true[there][:, :2] / true[there][:, 2:]).T, fit.optics.distortion, "opencv")
    K2 = fit.optics.K
    own = np.stack([K2[0, 0] * x + K2[0, 2], K2[1, 1] * y + K2[1, 2]], -1)
    direct = np.linalg.norm(own - pixels[there], axis=-1)
    fitted = _sights(K2, pixels, fit.optics.distortion)
    both = there & np.isfinite(fitted).all(-1)
    turn = Rotation.align_vectors(true[both], fitted[both])[0].as_matrix()
    return direct, K[0, 0] * np.linalg.norm(true[both] - fitted[both] @ turn.T, axis=-1)


def _sights(K: np.ndarray, pixels: np.ndarray, packed: np.ndarray) -> np.ndarray:
    sight = np.stack(sight_lines(*normalised(K, pixels[..., 0], pixels[..., 1]), packed, "opencv"), -1)
    length = np.linalg.norm(sight, axis=-1, keepdims=True)
    return np.where(length > 0, sight / np.maximum(length, 1e-12), np.nan)


def lens(trials: int, kind: str) -> None:
    """20 pictures at 640x480 of the board that --print-board prints."""
    rows = []
    for trial in range(trials):
        rng = np.random.default_rng(trial)
        camera = camera_of(rng, kind)
        views = [BOARD.find(picture[..., 0], str(i))
                 for i, picture in enumerate(boards_shown(rng, camera, BOARD))]  # fmt: skip
        views = [view for view in views if view is not None]
        began = time.perf_counter()
        fit = fit_lens(BOARD.points, views, SIZE[::-1], kind, len(camera[2]))
        took = time.perf_counter() - began
        direct, turned = ray_errors(fit, camera)
        K, K2 = camera[0], fit.optics.K
        rows.append([
            100 * abs(K2[0, 0] / K[0, 0] - 1), 100 * abs(K2[1, 1] / K[1, 1] - 1),
            max(abs(K2[:2, 2] - K[:2, 2])), direct.max(), turned.max(), np.median(direct),
            2 * np.nanmax(fit.rays), fit.rms, took, len(views),
        ])  # fmt: skip
    names = ("fx (%)", "fy (%)", "centre (px)", "worst ray (px)", "worst ray, turned (px)",
             "median ray (px)", "worst ray, 2 deviations as said", "RMS (px)", "seconds", "pictures")  # fmt: skip
    show(names, np.array(rows))


def show(names: tuple[str, ...], rows: np.ndarray) -> None:
    """Median, 95 % and the worst of each column."""
    for name, column in zip(names, rows.T, strict=True):
        middle, most = np.nanmedian(column), np.nanquantile(column, 0.95)
        print(f"{name:34} median {middle:8.3f}   95 % {most:8.3f}   worst {np.nanmax(column):8.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("form", choices=["lens"])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--kind", choices=["opencv", "fisheye"], default="opencv")
    asked = parser.parse_args()
    lens(asked.trials, asked.kind)


if __name__ == "__main__":
    main()
