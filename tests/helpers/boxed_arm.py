"""An arm of three boxes, and films of it, drawn as filled hulls of the boxes' corners."""

import cv2
import mujoco
import numpy as np

from jaxcam.rays import look_at
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.model import ArmModel

XML = """
<mujoco>
  <worldbody>
    <body name="base">
      <geom type="box" size="0.1 0.1 0.05"/>
      <body name="one" pos="0 0 0.1">
        <joint name="j1" axis="0 0 1"/>
        <geom type="box" size="0.05 0.07 0.15" pos="0 0 0.15"/>
        <body name="two" pos="0 0 0.3">
          <joint name="j2" axis="0 1 0"/>
          <geom type="box" size="0.16 0.045 0.05" pos="0.16 0 0"/>
          <body name="three" pos="0.32 0 0">
            <joint name="j3" axis="0 1 0"/>
            <geom type="box" size="0.12 0.06 0.035" pos="0.12 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
JOINTS = ("j1", "j2", "j3")
BOXES = (
    ((0.05, 0.07, 0.15), (0, 0, 0.15)),
    ((0.16, 0.045, 0.05), (0.16, 0, 0)),
    ((0.12, 0.06, 0.035), (0.12, 0, 0)),
)
COLOURS = ((225, 225, 215), (205, 210, 220), (230, 220, 210))
SIDE = 160
K = np.array([[170.0, 0, 80], [0, 170, 80], [0, 0, 1]])
CAMERA = np.asarray(look_at(np.array([1.15, 0.75, 0.85]), np.array([0.15, 0.0, 0.25])), float)


def boxed_arm() -> ArmModel:
    return ArmModel(mujoco.MjModel.from_xml_string(XML), "base", JOINTS)


def _turn(axis: int, angle: float) -> np.ndarray:
    pose = np.eye(4)
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    pose[a, a] = pose[b, b] = np.cos(angle)
    pose[a, b], pose[b, a] = -np.sin(angle), np.sin(angle)
    return pose


def _shift(*by: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = by
    return pose


def links(angles: np.ndarray) -> list[np.ndarray]:
    """Poses of the three links, by hand."""
    one = _shift(0, 0, 0.1) @ _turn(2, angles[0])
    two = one @ _shift(0, 0, 0.3) @ _turn(1, angles[1])
    return [one, two, two @ _shift(0.32, 0, 0) @ _turn(1, angles[2])]


def hulls(angles: np.ndarray, camera: np.ndarray) -> list[np.ndarray]:
    """Corners of the boxes' outlines in the picture, [n, 2] each."""
    outlines = []
    for pose, (size, middle) in zip(links(angles), BOXES, strict=True):
        corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * size + middle
        there = np.linalg.inv(camera) @ pose @ np.c_[corners, np.ones(8)].T
        pixels = (K @ there[:3] / there[2]).T[:, :2]
        outlines.append(cv2.convexHull(pixels.astype(np.float32))[:, 0])
    return outlines


def draw(angles: np.ndarray, camera: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """A picture, uint8 [SIDE, SIDE, 3]; what an outline covers of a pixel is by its distance."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    shown = ground.astype(float)
    for outline, colour in zip(hulls(angles, camera), COLOURS, strict=True):
        ends = np.roll(outline, -1, 0)
        along = (ends - outline) / np.linalg.norm(ends - outline, axis=-1, keepdims=True)
        inside = [
            a[0] * (y - p[1]) - a[1] * (x - p[0]) for p, a in zip(outline, along, strict=True)
        ]
        middle = outline.mean(0)
        turn = np.sign(along[0, 0] * (middle[1] - outline[0, 1])
                       - along[0, 1] * (middle[0] - outline[0, 0]))  # fmt: skip
        covers = np.clip(0.5 + (turn * np.array(inside)).min(0), 0, 1)[..., None]
        shown = covers * np.array(colour) + (1 - covers) * shown
    return shown.round().astype(np.uint8)


def way(episode: int, count: int) -> np.ndarray:
    """Joint angles of an episode, [count, 3]."""
    rng = np.random.default_rng(100 + episode)
    ends = rng.uniform([-0.9, -0.6, -0.2], [0.9, 0.7, 1.0], (3, 3))
    at = np.linspace(0, 2, count)
    return np.stack([np.interp(at, [0, 1, 2], column) for column in ends.T], -1)


def ground(episode: int) -> np.ndarray:
    rng = np.random.default_rng(episode)
    coarse = rng.uniform(40, 130, (10, 10, 3)).astype(np.uint8)
    return cv2.resize(coarse, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)


def film(
    cameras: list[np.ndarray],
    count: int = 6,
    off: tuple[float, float, float] = (0, 0, 0),
    lag: float = 0.0,
) -> Film:
    """A film of episodes, each from a camera of its own; states are off, or of another time."""
    rgb, angles, speeds, episodes, steps = [], [], [], [], []
    for episode, camera in enumerate(cameras):
        path = way(episode, count)
        speed = np.gradient(path, axis=0) * 5
        for step, row in enumerate(path):
            noise = np.random.default_rng(1000 * episode + step).normal(0, 2, (SIDE, SIDE, 3))
            shown = draw(row + lag * speed[step], camera, ground(episode)) + noise
            rgb.append(np.clip(shown, 0, 255).astype(np.uint8))
            angles.append(row + off)
            speeds.append(speed[step])
            episodes.append(episode)
            steps.append(step)
    return Film(K, np.stack(rgb), np.array(angles), np.array(speeds), None, np.array(episodes),
                np.array(steps))  # fmt: skip
