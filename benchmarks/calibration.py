"""How exact `jaxcam.calibrate` is, on drawn pictures whose truth is known.

    python benchmarks/calibration.py lens [--trials 20] [--kind opencv|fisheye]
    python benchmarks/calibration.py tags [--trials 20] [--tags 1|2|3|4] [--pictures 5]
    python benchmarks/calibration.py hand-eye [--trials 20] [--pictures 15] [--mount fixed|grip]
    python benchmarks/calibration.py arm [--cameras 50] [--held-out] [--films FOLDER]
    python benchmarks/calibration.py drift [--cameras 50] [--held-out] [--films FOLDER]
    python benchmarks/calibration.py policy RUN --errors FOLDER/errors-50.npy [--pairs 200]

Pictures are drawn by following each pixel's rays through a camera and its lens, with blur, noise,
light from one side, and boards that are seen in part; 640x480, a metre away. The tags' places and
the grip's poses are off by what a robot is off: 0.5 mm and 0.1 degrees for hand-eye.
"""

import argparse
import sys
import time
from pathlib import Path

import calibration_arm
import calibration_policy
import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays import look_at
from jaxcam.rays.lens import distort, normalised, pack, sight_lines
from jaxcam.robot.calibration.boards import Board
from jaxcam.robot.calibration.hand_eye.fit import Seen, fit_hand_eye
from jaxcam.robot.calibration.lens.fit import LensFit, fit_lens, ray_pixels
from jaxcam.robot.calibration.pictures import NamedPicture
from jaxcam.robot.calibration.projection import apart, moved, placed, pose_of
from jaxcam.robot.calibration.tags.fit import locate, middle_corners
from jaxcam.robot.calibration.tags.pictures import find_tags
from jaxcam.robot.calibration.tags.places import Tags, square

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from drawn import boards_shown, draw, rays_of, tag_print

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
    sight = np.stack(
        sight_lines(*normalised(K, pixels[..., 0], pixels[..., 1]), packed, "opencv"), -1
    )
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
             "median ray (px)", "worst ray, 2 deviations as said", "RMS (px)", "seconds",
             "pictures")  # fmt: skip
    show(names, np.array(rows))


WEBCAM = (np.array([[600.0, 0, 322], [0, 601, 238], [0, 0, 1]]), SIZE,
          [-0.25, 0.08, 5e-4, -3e-4, -0.01], "opencv")  # fmt: skip
PLACES = ((0.0, 0.0), (0.2, 0.15), (-0.2, 0.15), (0.05, -0.2))


def optics_of(camera: tuple) -> Optics:
    K, (height, width), coefficients, kind = camera
    return Optics(K, width, height, np.asarray(pack(np.array(coefficients), kind)))


def from_above(rng: np.random.Generator, aim: np.ndarray) -> np.ndarray:
    """A camera a metre away that looks at a point, not from straight above."""
    azimuth, elevation = rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(30, 60))
    flat = np.cos(elevation)
    way = [np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)]
    return np.asarray(look_at(aim + way, aim + rng.normal(0, 0.05, 3) * [1, 1, 0]), float)


def tags(trials: int, count: int, pictures: int) -> None:
    """Tags of 8 cm, flat on a table."""
    optics, rays, rows = optics_of(WEBCAM), rays_of(*WEBCAM[:1], *SIZE, WEBCAM[2]), []
    for trial in range(trials):
        rng = np.random.default_rng(trial)
        turns = Rotation.from_rotvec(rng.uniform(-3, 3, (count, 1)) * [0, 0, 1]).as_matrix()
        places = {i: pose_of(turns[i], np.array([*PLACES[i], 0])) for i in range(count)}
        known = Tags("36h11", {i: placed(f, square(0.08)) for i, f in places.items()},
                     dict.fromkeys(places, 0.08), 0.0)  # fmt: skip
        pose = from_above(rng, np.zeros(3))
        prints = [tag_print("36h11", i, 0.08, f) for i, f in places.items()]
        shown = [NamedPicture("", draw(rays, pose, prints, rng)) for _ in range(pictures)]
        began = time.process_time()
        sights = [find_tags(picture, "36h11", optics) for picture in shown]
        try:
            fit = locate(middle_corners(sights), known, optics)
        except DatasetError as error:
            print(f"trial {trial}: {error}")
            rows.append([np.nan] * 6)
            continue
        took = (time.process_time() - began) / pictures
        rows.append([*_off(pose, fit.base_from_camera), 1000 * fit.spread[0],
                     np.rad2deg(fit.spread[1]), fit.rms, took])  # fmt: skip
    show(("position (mm)", "rotation (degrees)", "deviation as said (mm)",
          "deviation as said (degrees)", "RMS (px)", "CPU seconds a picture"),
         np.array(rows))  # fmt: skip


def hand_eye(trials: int, count: int, mount: str) -> None:
    """A tag of 6 cm on the hand, or on the table below a camera on the hand."""
    optics, rays, rows = optics_of(WEBCAM), rays_of(*WEBCAM[:1], *SIZE, WEBCAM[2]), []
    aim = np.array([0.45, 0, 0.2])
    for trial in range(trials):
        rng = np.random.default_rng(trial)
        pose = from_above(rng, aim)
        down = Rotation.from_euler("x", np.pi)
        facing = Rotation.from_matrix(pose[:3, :3] @ np.diag([1.0, -1, -1]))
        own = facing * Rotation.from_rotvec(rng.normal(0, 0.3, 3))
        at = aim - 0.06 * pose[:3, 2]
        tag = np.linalg.inv(pose_of(down.as_matrix(), aim)) @ pose_of(own.as_matrix(), at)
        turn, reach = (0.6, 0.15) if mount == "fixed" else (0.4, 0.08)
        turns = Rotation.from_rotvec(rng.uniform(-turn, turn, (count, 3)))
        grips = pose_of((turns * down).as_matrix(), aim + rng.uniform(-reach, reach, (count, 3)))
        read = np.stack([
            moved(g, np.r_[rng.normal(0, 5e-4, 3), rng.normal(0, np.deg2rad(0.1), 3)])
            for g in grips
        ])  # fmt: skip
        eyes, papers, carried = [pose] * count, grips @ tag, read
        if mount == "grip":  # 30 cm above the tag, looking at it
            pose = moved(np.eye(4), np.array([0.05, 0.02, aim[2] - 0.3, *rng.normal(0, 0.1, 3)]))
            eyes, papers = grips @ pose, [pose_of(np.eye(3), aim * [1, 1, 0])] * count
            carried = np.linalg.inv(read)
        sights = [
            find_tags(NamedPicture("", draw(rays, eye, [tag_print("36h11", 5, 0.06, paper)], rng)),
                      "36h11", optics)
            for eye, paper in zip(eyes, papers, strict=True)
        ]  # fmt: skip
        there = [i for i, some in enumerate(sights) if 5 in some]
        sights = [Seen(square(0.06), sights[i][5]) for i in there]
        fit = fit_hand_eye(carried[there], sights, optics)
        rows.append([*_off(pose, fit.mount_from_camera), 1000 * fit.spread[0],
                     np.rad2deg(fit.spread[1]), fit.rms, len(there)])  # fmt: skip
    show(("position (mm)", "rotation (degrees)", "deviation as said (mm)",
          "deviation as said (degrees)", "RMS (px)", "pictures with the tag"),
         np.array(rows))  # fmt: skip


def _off(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    place, turn = apart(one, other)
    return 1000 * float(place), float(np.rad2deg(turn))


def show(names: tuple[str, ...], rows: np.ndarray) -> None:
    """Median, 95 % and the worst of each column."""
    for name, column in zip(names, rows.T, strict=True):
        middle, most = np.nanmedian(column), np.nanquantile(column, 0.95)
        print(f"{name:34} median {middle:8.3f}   95 % {most:8.3f}   worst {np.nanmax(column):8.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("form", choices=["lens", "tags", "hand-eye", "arm", "drift", "policy"])
    parser.add_argument("run", nargs="?", type=Path)
    parser.add_argument("--errors", type=Path, default=Path("films/errors-50.npy"))
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--kind", choices=["opencv", "fisheye"], default="opencv")
    parser.add_argument("--tags", type=int, choices=[1, 2, 3, 4], default=4)
    parser.add_argument("--pictures", type=int)
    parser.add_argument("--mount", choices=["fixed", "grip"], default="fixed")
    parser.add_argument("--cameras", type=int, default=50)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--films", type=Path, default=Path("films"))
    asked = parser.parse_args()
    match asked.form:
        case "lens":
            lens(asked.trials, asked.kind)
        case "tags":
            tags(asked.trials, asked.tags, asked.pictures or 5)
        case "arm" | "drift":
            first = 50 if asked.held_out else 0
            cameras = range(first, first + min(asked.cameras, 50))
            asked.films.mkdir(exist_ok=True)
            if asked.form == "arm":
                show(*calibration_arm.arm(cameras, asked.films))
            else:
                calibration_arm.drift(cameras, asked.films)
        case "policy":
            calibration_policy.policy(asked.run, asked.errors, asked.pairs)
        case _:
            hand_eye(asked.trials, asked.pictures or 15, asked.mount)


if __name__ == "__main__":
    main()
