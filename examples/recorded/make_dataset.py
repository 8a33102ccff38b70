"""Makes a recorded dataset of a robot that pretends to be real.

    python examples/recorded/make_dataset.py example

writes what somebody who has a robot has:

    example/lift_robot     a LeRobot dataset (v3.0): numbers and videos, and no word about cameras
    example/cameras.json   where its cameras stood and how they saw, as a calibration would give it
    example/wrist.npz      poses of the camera on the wrist, picture by picture
    example/overlays.png   where the calibration says that the grip is, drawn into pictures

Behind it is the simulator's Lift, in its fixed scene. Three cameras watch: `front` through a wide
lens that bends straight lines, `side`, and `wrist` on the hand. The first has other pictures than
the others, none is square, and the two tripods are moved after some episodes. The state is seven
joints and the gripper's opening, then where the grip is; the action is seven joint targets and the
gripper.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import numpy as np
import tyro
from rich.console import Console

from jaxcam.config.datasets import CollectConfig
from jaxcam.data.batches import demo_actions
from jaxcam.data.collection import collect
from jaxcam.data.demos import Demo, Demos
from jaxcam.interop.lerobot.format import Writer, feature, video_feature
from jaxcam.rays import Camera, invert, look_at
from jaxcam.rays.lens import normalised, sight_lines
from jaxcam.rays.rotations import quaternion_from_matrix
from jaxcam.sim import make_painter
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import View

ROBOT = "lift_robot"
"""Folder of the dataset."""
SESSION = 6
"""Episodes after which the tripods are moved."""
WORKPLACE = np.array([0.56, 0.0, -0.06])
"""About what the tripods' cameras look at, in the robot's base frame (m)."""
LENS = np.array([-0.33, 0.11, 0.001, -0.0015, -0.015])
"""k1, k2, p1, p2, k3 of the front camera, as `cv2.calibrateCamera` would give them."""
JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
STATE = (*JOINTS, "gripper", "grip_x", "grip_y", "grip_z")
ACTION = (*JOINTS, "gripper")


@dataclass(frozen=True)
class Settings:
    """A recorded dataset of a robot that pretends to be real."""

    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FOLDER")]] = Path("example")
    """Folder to write, new."""
    episodes: int = 18
    """Demonstrations."""
    rows: int = 72
    """Rows of the side's and the wrist's pictures, an even number; the front has a quarter more."""
    quick: bool = False
    """A toy: two episodes of small pictures."""
    data_dir: Path = Path("data")
    """Where the simulator's demonstrations are kept."""


class Eye(NamedTuple):
    """How a camera sees."""

    K: np.ndarray
    """Intrinsics in pixels of its pictures [3, 3]."""
    height: int
    width: int
    lens: np.ndarray
    """Coefficients of OpenCV's model [5]; zeros are a pinhole."""


def eyes_of(rows: int) -> dict[str, Eye]:
    """How the three cameras see, by their names."""
    wide = rows * 5 // 8 * 2
    columns, wide_columns = (side * 2 // 3 * 2 for side in (rows, wide))  # even, as videos want it
    return {
        "front": _eye(wide, wide_columns, focal=0.75, shift=(1.8, -1.2), lens=LENS),
        "side": _eye(rows, columns, focal=1.15, shift=(-0.7, 0.4)),
        "wrist": _eye(rows, columns, focal=0.75, shift=(0.0, 0.9)),
    }


def _eye(
    height: int,
    width: int,
    focal: float,
    shift: tuple[float, float],
    lens: np.ndarray | None = None,
) -> Eye:
    """An eye whose focal length is a share of its width, with its middle aside by some pixels."""
    fx, fy = focal * width, 1.01 * focal * width  # no real one has just square pixels
    K = np.array([[fx, 0, width / 2 + shift[0]], [0, fy, height / 2 + shift[1]], [0, 0, 1]])
    return Eye(K, height, width, np.zeros(5) if lens is None else lens)


def tripod(view: str, session: int) -> np.ndarray:
    """Where a tripod's camera stands in a session, base from camera [4, 4]."""
    rng = np.random.default_rng([session, view == "side"])
    azimuth = np.deg2rad((0 if view == "front" else 70) + rng.uniform(-12, 12))
    distance, height = rng.uniform(0.62, 0.72), rng.uniform(0.4, 0.55)
    target = WORKPLACE + rng.uniform(-0.03, 0.03, 3)
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0])
    return np.asarray(look_at(target + distance * ahead + [0, 0, height], target))


def on_hand() -> np.ndarray:
    """Where the camera on the wrist sits, grip from camera [4, 4]."""
    return np.asarray(look_at(np.array([0, 0.1, -0.08]), np.array([0, 0.01, 0.03]), (0, -1, 0)))


def film(demo: Demo, demos: Demos, painter: Painter, eye: Eye, poses: np.ndarray) -> np.ndarray:
    """What a camera saw of a demonstration before each action, uint8 [T, height, width, 3].

    The renderer knows no lenses. So a pinhole picture is drawn that shows all that the lens lets
    in, and each pixel takes the colour that lies there in the direction in which it looks.

    Args:
        demo: The demonstration.
        demos: Its dataset.
        painter: For pictures of `pinhole(eye)`.
        eye: The camera.
        poses: Base from camera [4, 4] or [T, 4, 4].
    """
    K, height, width = pinhole(eye)
    count = demo.length
    world_from_camera = demos.world.world_from_base @ poses
    drawn = painter.rgb(
        View(
            qpos=demo.qpos[:count],
            geom_size=np.broadcast_to(demo.geom_size, (count, *demo.geom_size.shape)),
            fixtures=np.broadcast_to(demo.fixtures, (count, *demo.fixtures.shape)),
            K=np.broadcast_to(K, (count, 3, 3)),
            world_from_camera=np.broadcast_to(world_from_camera, (count, 4, 4)),
        )
    )
    assert drawn.shape[1:3] == (height, width)
    if not eye.lens.any():
        return drawn
    columns, rows = bending(eye)
    return np.stack([cv2.remap(p, columns, rows, cv2.INTER_LINEAR) for p in drawn])


def sight(eye: Eye) -> np.ndarray:
    """Where each pixel of a camera looks, X/Z and Y/Z in camera axes [2, height, width]."""
    v, u = np.mgrid[: eye.height, : eye.width] + 0.5
    x, y, z = sight_lines(*normalised(eye.K, u, v), eye.lens, "opencv")
    if not (z > 0).all():
        raise ValueError("The lens has pixels that see nothing.")
    return np.stack([x / z, y / z])


def pinhole(eye: Eye) -> tuple[np.ndarray, int, int]:
    """K, rows and columns of a pinhole's pictures that show all that a camera sees, no coarser."""
    if not eye.lens.any():
        return eye.K, eye.height, eye.width
    x, y = np.abs(sight(eye)).max((1, 2))
    fx, fy = eye.K[0, 0], eye.K[1, 1]
    height, width = 2 * int(np.ceil(fy * y + 1)), 2 * int(np.ceil(fx * x + 1))
    return np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1]]), height, width


def bending(eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of `pinhole` at which each pixel looks, as `cv2.remap` counts them."""
    K, _, _ = pinhole(eye)
    x, y = sight(eye)
    u, v = K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]
    return (u - 0.5).astype(np.float32), (v - 0.5).astype(np.float32)


def record(demos: Demos, out: Path, eyes: dict[str, Eye], console: Console) -> None:
    """Films demonstrations and writes the dataset, the calibration and pictures to look at.

    Args:
        demos: What the robot does.
        out: Folder to write, new.
        eyes: How the cameras see, by their names.
        console: For progress.
    """
    world, task = demos.world, demos.task
    painters = {
        view: make_painter(world, *pinhole(eye)[1:], varied=task.varied)
        for view, eye in eyes.items()
    }
    features = {
        "observation.state": feature("float32", (len(STATE),), list(STATE)),
        "action": feature("float32", (len(ACTION),), list(ACTION)),
    }
    features |= {f"observation.images.{v}": video_feature(e.height, e.width, CONTROL_HZ)
                 for v, e in eyes.items()}  # fmt: skip
    base_from_world = np.asarray(invert(world.world_from_base))
    wrist: dict[str, np.ndarray] = {}
    samples = []
    with Writer(out / ROBOT, features, CONTROL_HZ, task.prompt) as writer:
        for number, demo in enumerate(demos.episodes):
            grips = base_from_world @ demo.world_from_grip()[: demo.length]
            poses = {view: tripod(view, number // SESSION) for view in ("front", "side")}
            poses["wrist"] = wrist[str(number)] = grips @ on_hand()
            pictures = {v: film(demo, demos, painters[v], e, poses[v]) for v, e in eyes.items()}
            felt = world.proprio(demo.qpos, demo.eef_pos)[: demo.length]
            rows = {
                "observation.state": felt[:, [*range(7), 10, 7, 8, 9]],
                "action": demo_actions(demo, "joint_abs", world).astype(np.float32),
            }
            writer.add(rows, {f"observation.images.{v}": p for v, p in pictures.items()})
            if number % SESSION == 0:
                samples.append(overlay(eyes, poses, pictures, grips[:, :3, 3]))
            console.print(f"Episode {number + 1} of {len(demos.episodes)}: {demo.length} steps.")
        writer.finish("a simulated arm")
    np.savez(out / "wrist.npz", **wrist)
    calibration = calibrations(eyes, len(demos.episodes))
    (out / "cameras.json").write_text(json.dumps(calibration, indent=1) + "\n")
    cv2.imwrite(str(out / "overlays.png"), cv2.cvtColor(np.concatenate(samples), cv2.COLOR_RGB2BGR))


def calibrations(eyes: dict[str, Eye], episodes: int) -> dict[str, object]:
    """What `cameras.json` says: how cameras see, and where tripods stood in each episode."""
    views: dict[str, dict[str, object]] = {}
    for view, eye in eyes.items():
        # As OpenCV gives it: whole numbers are the centres of pixels.
        K = eye.K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        views[view] = {"K": K.tolist(), "size": [eye.width, eye.height], "pixel_centers": 0}
        if eye.lens.any():
            views[view] |= {"lens": "opencv", "distortion": eye.lens.tolist()}
    views["wrist"]["base_from_camera"] = "wrist.npz"
    moved = {
        str(e): {
            v: {"base_from_camera": _entry(tripod(v, e // SESSION))} for v in ("front", "side")
        }
        for e in range(episodes)
    }
    return {"format": 1, "views": views, "episodes": moved, "about": "made by a simulator"}


def _entry(pose: np.ndarray) -> dict[str, list[float]]:
    return {
        "position": pose[:3, 3].tolist(),
        "quaternion_wxyz": quaternion_from_matrix(pose[:3, :3]).tolist(),
    }


def overlay(
    eyes: dict[str, Eye],
    poses: dict[str, np.ndarray],
    pictures: dict[str, np.ndarray],
    grip: np.ndarray,
    height: int = 240,
) -> np.ndarray:
    """Cameras side by side in the middle of an episode, with the way of the grip [T, 3] in them."""
    shown, t = [], len(grip) // 2
    for view, eye in eyes.items():
        pose = poses[view] if poses[view].ndim == 2 else poses[view][t]
        camera = Camera(eye.K, pose, eye.height, eye.width, eye.lens)
        zoom = height / eye.height
        pixels, depth = camera.project(grip)
        size = (round(zoom * eye.width), height)
        picture = cv2.resize(pictures[view][t], size, interpolation=cv2.INTER_NEAREST)
        for i in np.flatnonzero(np.asarray(depth) > 0):
            place = np.round(np.asarray(pixels[i]) * zoom - 0.5).astype(int).tolist()
            cv2.circle(picture, place, 5 if i == t else 1, (255, 60, 220), 1 if i == t else -1)
        shown.append(picture)
    return np.concatenate(shown, 1)


def main(settings: Settings, console: Console) -> None:
    """Makes the dataset."""
    if settings.out.exists():
        raise SystemExit(f"{settings.out} exists. Choose another folder, or delete it first.")
    if settings.rows % 2:
        raise SystemExit(f"--rows is even, as videos want it; got {settings.rows}.")
    episodes, rows = (2, 24) if settings.quick else (settings.episodes, settings.rows)
    config = CollectConfig(
        scene="fixed", demos=episodes, validation=0, n=1, m=0, data_dir=str(settings.data_dir)
    )
    record(collect(config, console), settings.out, eyes_of(rows), console)
    console.print(
        f"{settings.out}: look at overlays.png, where the circle is on the grip, then\n"
        f"  python -m jaxcam.train --dataset {settings.out / ROBOT} "
        f"--cameras {settings.out / 'cameras.json'} --hold-out-view side",
        soft_wrap=True,
    )


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__), Console())
