"""The schema of `cameras.json` and its reader agree."""

import json
import re
from dataclasses import fields

import numpy as np
import pytest
from places import REPO

from jaxcam.errors import JaxcamError
from jaxcam.interop.cameras.files import CamerasEntries, ViewEntries, read_cameras

SCHEMA = json.loads((REPO / "docs/cameras.schema.json").read_text("utf-8"))
EYE = np.eye(4).tolist()
VIEW = {"K": {"fx": 60, "fy": 60, "cx": 32, "cy": 24}, "size": [64, 48], "base_from_camera": EYE}
HAND = {"K": VIEW["K"], "size": [64, 48], "grip_from_camera": EYE}
GOOD = (
    {"format": 1},
    {"format": 1, "views": {"a": VIEW}, "$schema": "cameras.schema.json", "about": [1, None]},
    {"format": 1, "views": {"a": VIEW | {"K": [[60, 0, 32], [0, 60, 24], [0, 0, 1.0]]}}},
    {"format": 1, "views": {"a": VIEW | {"base_from_camera": [EYE, EYE], "axes": "opengl"}}},
    {"format": 1, "views": {"a": VIEW | {"base_from_camera": "poses/a.npz"}}},
    {"format": 1, "views": {"a": VIEW | {"lens": "fisheye", "distortion": [0, 0, 0, 0.1]}}},
    {"format": 1, "views": {"a": VIEW | {"pixel_centers": 0, "lens": None}}},
    {"format": 1, "views": {"a": HAND}},
    {"format": 1, "views": {"a": HAND | {"grip": {"pose": "state[0:7]", "delay_ms": -33.3}}}},
    {
        "format": 1,
        "views": {"a": {"world_from_camera": EYE}},
        "world_from_base": {"position": [0, 0, 1], "quaternion_wxyz": [1, 0, 0, 0]},
        "episodes": {"3": {"a": {"size": [32, 24], "K": VIEW["K"]}}, "night": {}},
    },
)
BAD = (
    {"format": 1, "views": {"a": HAND | {"base_from_camera": EYE}}},
    {"format": 1, "views": {"a": HAND | {"grip_from_camera": [EYE, EYE]}}},
    {"format": 1, "views": {"a": HAND | {"grip_from_camera": "a.npy"}}},
    {"format": 1, "views": {"a": HAND | {"grip": {"rotation": "euler"}}}},
    {"format": 1, "views": {"a": HAND | {"grip": {"delay_ms": 1e9}}}},
    {"format": 1, "views": {"a": HAND | {"grip": {"delay_ms": "late"}}}},
    {},
    {"format": "1"},
    {"format": 2},
    {"format": 1, "veiws": {}},
    {"format": 1, "views": {"a": {"focal": 60}}},
    {"format": 1, "views": {"a": VIEW | {"K": {"fx": 60, "fy": 60}}}},
    {"format": 1, "views": {"a": VIEW | {"K": [[60, 0], [0, 60]]}}},
    {"format": 1, "views": {"a": VIEW | {"size": [64]}}},
    {"format": 1, "views": {"a": VIEW | {"size": [64, 0]}}},
    {"format": 1, "views": {"a": VIEW | {"size": "64x48"}}},
    {"format": 1, "views": {"a": VIEW | {"pixel_centers": 1}}},
    {"format": 1, "views": {"a": VIEW | {"lens": "pinhol"}}},
    {"format": 1, "views": {"a": VIEW | {"distortion": "none"}}},
    {"format": 1, "views": {"a": VIEW | {"base_from_camera": "poses.pkl"}}},
    {"format": 1, "views": {"a": VIEW | {"base_from_camera": EYE[:3]}}},
    {"format": 1, "views": {"a": VIEW | {"base_from_camera": {"position": [0, 0, 1]}}}},
    {"format": 1, "views": {"a": VIEW | {"world_from_camera": EYE}}, "world_from_base": EYE},
    {"format": 1, "views": {"a": VIEW | {"axes": "maya"}}},
    {"format": 1, "views": [VIEW]},
    {"format": 1, "world_from_base": "base.npy"},
    {"format": 1, "episodes": {"0": [VIEW]}},
    {"format": 1, "episodes": {"0": {"a": {"K": 60}}}},
)


def accepts(path, content):
    path.write_text(json.dumps(content))
    try:
        read_cameras(path)
    except JaxcamError:
        return False
    return True


def test_the_reader_accepts_and_refuses(tmp_path):
    assert [accepts(tmp_path / "cameras.json", c) for c in GOOD] == [True] * len(GOOD)
    assert [accepts(tmp_path / "cameras.json", c) for c in BAD] == [False] * len(BAD)


def test_the_schema_has_the_readers_names():
    top = {f.name for f in fields(CamerasEntries)}
    assert set(SCHEMA["properties"]) == top | {"$schema"}
    assert set(SCHEMA["$defs"]["view"]["properties"]) == {f.name for f in fields(ViewEntries)}


def test_the_schema_accepts_and_refuses_the_same():
    jsonschema = pytest.importorskip("jsonschema")  # of the extra `test`
    schema = jsonschema.Draft202012Validator(SCHEMA)
    schema.check_schema(SCHEMA)
    assert [schema.is_valid(content) for content in GOOD] == [True] * len(GOOD)
    assert [schema.is_valid(content) for content in BAD] == [False] * len(BAD)


def test_the_examples_of_the_page_are_read(tmp_path):
    page = (REPO / "docs/calibrated-datasets.md").read_text("utf-8")
    (example,) = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    (snippet,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names = {}
    exec(compile(snippet, "page", "exec"), names)
    for text in (example, names["text"]):
        (tmp_path / "cameras.json").write_text(text)
        file = read_cameras(tmp_path / "cameras.json")
        front = file.views["front"]
        assert front.optics.K[0, 2] == 320.9
        assert front.pose.of(()).shape == (4, 4)
    np.testing.assert_allclose(front.pose.of(())[:3, 3], [0, 0, 1.2])
    assert accepts(tmp_path / "cameras.json", json.loads(example))
