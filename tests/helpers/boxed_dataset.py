"""A LeRobot dataset of the arm of three boxes, on disk."""

import json

import lerobot_datasets
import numpy as np
from boxed_arm import JOINTS, SIDE, XML, K, film

from jaxcam.interop.cameras.writing import pose_json

LENGTH = 8
VIEW = {
    "K": {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]},
    "size": [SIDE, SIDE],
    "pixel_centers": 0.5,
    "lens": "pinhole",
}


def write_boxed(root, monkeypatch, cameras, pose=None):
    """An episode of LENGTH steps for each camera in root/data, beside cameras.json and arm.xml."""
    shown = film(cameras, count=LENGTH)
    for name, value in (("LENGTHS", (LENGTH,) * len(cameras)), ("HEIGHT", SIDE), ("WIDTH", SIDE)):
        monkeypatch.setattr(lerobot_datasets, name, value)
    monkeypatch.setattr(lerobot_datasets, "picture", lambda e, t, v: shown.rgb[LENGTH * e + t])
    lerobot_datasets.write_folder(root / "data", dtype="image", keys=("observation.images.front",))
    states = shown.angles.astype(np.float32)
    ends = range(2 * LENGTH, len(states), LENGTH)  # the first file has two episodes
    for file, rows in enumerate(np.split(states, ends)):
        path = root / f"data/data/chunk-000/file-{file:03d}.parquet"
        lerobot_datasets.edit_table(path, **{"observation.state": list(map(list, rows))})
    names = [f"joint_{i + 1}" for i in range(len(JOINTS))]
    lerobot_datasets.edit_feature(root / "data", "observation.state", shape=[3], names=names)
    view = VIEW | (pose_json(pose) if pose is not None else {})
    (root / "cameras.json").write_text(json.dumps({"format": 1, "views": {"front": view}}))
    (root / "arm.xml").write_text(XML)
