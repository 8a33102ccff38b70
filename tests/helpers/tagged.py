"""Tags before cameras: their corners by numbers, drawn pictures, and datasets of those."""

import functools
import json

import lerobot_datasets
import numpy as np
from drawn import Look, draw, rays_of, tag_print
from scipy.spatial.transform import Rotation

from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays import look_at
from jaxcam.rays.lens import pack
from jaxcam.robot.calibration.projection import pixels_of, placed, pose_of
from jaxcam.robot.calibration.tags.places import Tags, square

FAMILY, SIZE = "36h11", 0.08
WIDTH, HEIGHT = 320, 240
LENS = (-0.2, 0.05, 4e-4, -3e-4)
K = np.array([[330.0, 0, 161], [0, 331, 119], [0, 0, 1]])
OPTICS = Optics(K, WIDTH, HEIGHT, np.asarray(pack(np.array(LENS))))
PLACES = {0: (0.0, 0.0), 1: (0.15, 0.1), 2: (-0.15, 0.1), 3: (0.04, -0.15)}
VIEW = {
    "K": {"fx": 330.0, "fy": 331.0, "cx": 161.0, "cy": 119.0},
    "size": [WIDTH, HEIGHT],
    "distortion": [*LENS],
}
"""Entries of a view with that camera."""


def tag_frames(numbers=(0, 1, 2, 3)):
    """Poses of tags that lie flat, each turned otherwise."""
    turns = Rotation.from_rotvec([[0, 0, 0.7 * n] for n in numbers]).as_matrix()
    return {n: pose_of(turns[i], np.array([*PLACES[n], 0.0])) for i, n in enumerate(numbers)}


def tags_at(places, size=SIZE, accuracy=0.0):
    corners = {n: placed(frame, square(size)) for n, frame in places.items()}
    return Tags(FAMILY, corners, dict.fromkeys(places, size), accuracy)


def eye(azimuth=0.4, elevation=0.8, far=0.8, aim=(0.0, 0.0, 0.0)):
    """Base from camera, which looks at a point."""
    way = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation),
           np.sin(elevation)]  # fmt: skip
    return np.asarray(look_at(np.array(aim) + far * np.array(way), np.array(aim)), float)


def corners_seen(pose, places, rng, noise=0.05, size=SIZE):
    """Corners of tags in a picture, by numbers alone."""
    camera = np.linalg.inv(pose)
    return {
        n: pixels_of(placed(camera @ frame, square(size)), OPTICS) + rng.normal(0, noise, (4, 2))
        for n, frame in places.items()
    }


@functools.cache
def all_rays():
    return rays_of(K, HEIGHT, WIDTH, LENS, samples=2)


def drawn_tags(poses, places, seed=0, size=SIZE, look=Look()):  # noqa: B008
    """Pictures [n, H, W, 3] of tags, from a camera's poses; places may be one dict a picture."""
    rng, rays = np.random.default_rng(seed), all_rays()
    each = places if isinstance(places, list) else [places] * len(poses)
    return np.stack([
        draw(rays, pose, [tag_print(FAMILY, n, size, f) for n, f in some.items()], rng, look, 2)
        for pose, some in zip(poses, each, strict=True)
    ])  # fmt: skip


def grip_states(grips):
    """Poses of the grip [n, 4, 4] as a robot says them: places and rotation vectors, [n, 6]."""
    turns = Rotation.from_matrix(grips[:, :3, :3]).as_rotvec()
    return np.concatenate([grips[:, :3, 3], turns], -1).astype(np.float32)


def write_hand(folder, monkeypatch, states, pictures):
    """What `calibrate hand-eye` is given: a dataset, `data`, and its camera's K; goes there."""
    monkeypatch.chdir(folder)
    (folder / "cameras.json").write_text(json.dumps({"format": 1, "views": {"front": VIEW}}))
    names = ("ee_x", "ee_y", "ee_z", "ee_rx", "ee_ry", "ee_rz")
    write_dataset(folder / "data", monkeypatch, pictures, states, names)
    return folder


def write_dataset(root, monkeypatch, pictures, states=None, names=None):
    """A LeRobot dataset of one view, front: pictures and states by episode."""
    lengths = tuple(len(some) for some in pictures)
    assert len(lengths) == 3
    for name, value in (("LENGTHS", lengths), ("HEIGHT", HEIGHT), ("WIDTH", WIDTH)):
        monkeypatch.setattr(lerobot_datasets, name, value)
    monkeypatch.setattr(lerobot_datasets, "picture", lambda e, t, v: pictures[e][t])
    lerobot_datasets.write_folder(root, dtype="image", keys=("observation.images.front",))
    if states is not None:
        for file, some in enumerate((np.concatenate(states[:2]), states[2])):
            path = root / f"data/chunk-000/file-{file:03d}.parquet"
            lerobot_datasets.edit_table(path, **{"observation.state": list(map(list, some))})
        lerobot_datasets.edit_feature(
            root, "observation.state", shape=[states[0].shape[1]], names=list(names)
        )
    return root
