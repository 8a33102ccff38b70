"""Six robots that never were, each as a LeRobot folder beside a file of calibrations."""

import json
from dataclasses import dataclass

import numpy as np

from jaxcam.interop.lerobot.format import Writer, feature, video_feature
from jaxcam.rays import look_at

LENSES = {
    "pinhole": {},
    "opencv": {"distortion": [-0.2, 0.05, 0.001, -0.002, 0.0]},
    "rational": {"distortion": [-0.2, 0.05, 0.001, 0.0, 0.01, 0.1, 0.01, 0.0]},
    "fisheye": {"lens": "fisheye", "distortion": [0.05, -0.01, 0.002, 0.0]},
}
"""What entries of `cameras.json` say of a lens."""


@dataclass(frozen=True)
class Robot:
    """What makes a robot's dataset differ from another's.

    Attributes:
        actions: Numbers of an action.
        states: Their names; how many there are.
        eyes: By view, rows and columns of its pictures, its lens, and whether it moves.
        lengths: Steps of its episodes.
    """

    actions: int
    states: tuple[str, ...]
    eyes: dict[str, tuple[int, int, str, bool]]
    lengths: tuple[int, ...] = (8, 5, 7)


GRIP = ("ee_x", "ee_y", "ee_z")
ROBOTS = {
    "plotter": Robot(5, ("x",), {"top": (32, 32, "pinhole", False)}),
    "arm": Robot(
        7,
        tuple("abcdefg"),
        {"front": (24, 32, "opencv", False), "wrist": (32, 40, "pinhole", True)},
    ),
    "gripper": Robot(8, (*GRIP, "gripper"), {"front": (48, 32, "fisheye", False)}, (6, 6)),
    "bowls": Robot(
        6,
        tuple("abcdef"),
        {"left": (24, 40, "rational", False), "right": (40, 24, "opencv", False)},
    ),
    "two hands": Robot(
        14,
        tuple(f"joint {i}" for i in range(14)),
        {
            "top": (24, 32, "pinhole", False),
            "left": (32, 32, "fisheye", True),
            "right": (32, 48, "opencv", True),
        },
    ),
    "crane": Robot(
        10,
        (*GRIP, "load"),
        {"a": (36, 48, "opencv", False), "b": (48, 36, "pinhole", True)},
        (9, 4),
    ),
}


def write_robot(name, folder):
    """Writes `folder/<name>` and `folder/<name>.json`, and returns their paths."""
    robot, rng, root = ROBOTS[name], np.random.default_rng(0), folder / name
    actions = [f"motor {i}" for i in range(robot.actions - 1)] + ["gripper"]
    features = {
        "observation.state": feature("float32", (len(robot.states),), list(robot.states)),
        "action": feature("float32", (robot.actions,), actions),
    }
    for view, (rows, columns, _, _) in robot.eyes.items():
        features[f"observation.images.{view}"] = video_feature(rows, columns, 10)
    with Writer(root, features, 10, f"Use the {name}.") as writer:
        for length in robot.lengths:
            numbers = {
                "observation.state": rng.normal(size=(length, len(robot.states))),
                "action": rng.normal(size=(length, robot.actions)),
            }
            pictures = {
                f"observation.images.{view}": rng.integers(
                    0, 256, (length, rows, columns, 3), np.uint8
                )
                for view, (rows, columns, _, _) in robot.eyes.items()
            }
            writer.add({k: v.astype(np.float32) for k, v in numbers.items()}, pictures)
        writer.finish(name)
    file = folder / f"{name}.json"
    file.write_text(json.dumps(_cameras(robot)))
    return root, file


def _cameras(robot):
    """What `cameras.json` says: K for pictures of twice the size, and poses."""
    views, episodes = {}, {str(e): {} for e in range(len(robot.lengths))}
    for number, (view, (rows, columns, lens, moves)) in enumerate(robot.eyes.items()):
        focal = 1.8 * columns + 3 * number
        views[view] = {
            "K": {"fx": focal, "fy": 1.02 * focal, "cx": columns - 1.0, "cy": rows + 0.5},
            "size": [2 * columns, 2 * rows],
            **LENSES[lens],
        }
        for episode, length in enumerate(robot.lengths):
            angles = 0.7 * number + 0.1 * episode + 0.02 * np.arange(length if moves else 1)
            eyes = np.stack([np.cos(angles), np.sin(angles), np.full_like(angles, 0.6)], -1)
            poses = np.asarray(look_at(eyes, np.zeros(3))).tolist()
            episodes[str(episode)][view] = {"base_from_camera": poses if moves else poses[0]}
    return {"format": 1, "views": views, "episodes": episodes}
