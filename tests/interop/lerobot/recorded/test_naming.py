"""Which features are states, actions and views, and how their numbers are called."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

from lerobot_datasets import (
    LENGTHS,
    TOP,
    edit_feature,
    edit_info,
    edit_table,
    refused,
)
from pyarrow import parquet

from jaxcam.interop.lerobot.reading import read_lerobot


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        (["a", "b", "c"], ("a", "b", "c")),
        (None, ("state_0", "state_1", "state_2")),
        (["state"], ("state_0", "state_1", "state_2")),
        ({"motors": ["a", "b", "c"]}, ("a", "b", "c")),
        ({"left": ["x"], "right": ["x", "y"]}, ("left.x", "right.x", "right.y")),
        ({"x": 1, "y": 0, "z": 2}, ("y", "x", "z")),
    ],
)
def test_names_of_numbers(copied, names, wanted):
    root = copied()
    edit_feature(root, "observation.state", names=names)
    assert read_lerobot(root).state_names == wanted


def test_states_in_other_columns(copied):
    root = copied("v2.1")
    for path in (root / "data").rglob("*.parquet"):
        state = parquet.read_table(path).column("observation.state").to_pylist()
        extra = {"observation.state": None, "observation.state.arm": state}
        edit_table(path, **extra, **{"observation.state.hand": [s[0] for s in state]})
    features = json.loads((root / "meta/info.json").read_text())["features"]
    arm = features.pop("observation.state")
    hand = {"dtype": "float32", "shape": [1], "names": None}
    parts = {"observation.state.arm": arm, "observation.state.hand": hand}
    edit_info(root, features=features | parts)
    recording = read_lerobot(root)
    assert recording.state_names == ("arm.a", "arm.b", "arm.c", "hand.hand")
    both = ["action", "observation.state.arm"]
    chosen = read_lerobot(root, state=["observation.state.hand"], action=both)
    assert chosen.state_names == ("hand",)
    np.testing.assert_array_equal(chosen.episodes[1].state, recording.episodes[1].state[:, 3:])
    assert chosen.episodes[1].action.shape == (LENGTHS[1], 5)


def test_no_pictures(copied):
    root = copied()
    features = json.loads((root / "meta/info.json").read_text())["features"]
    numbers = {k: v for k, v in features.items() if v["dtype"] != "video"}
    edit_info(root, features=numbers)
    refused(root, "no videos and no images: there is nothing to see")
    depth = {"dtype": "video", "shape": [48, 64, 1], "info": {"video.is_depth_map": True}}
    edit_info(root, features=numbers | {TOP: depth})
    refused(root, "no videos and no images")


def test_names_that_clash(copied):
    root = copied()
    edit_feature(root, "observation.top", dtype="video", shape=[48, 64, 3])
    refused(root, r"'observation\.images\.top' and 'observation\.top' both are the view 'top'")
    root = shutil.copytree(root, root.parent / "again")
    edit_feature(root, "observation.top", dtype="float32")
    edit_feature(root, "action", names=["x", "x"])
    refused(root, "action has two numbers called 'x'")
    edit_feature(root, "action", names=["x", "y", "z"])
    refused(root, "'action' has 2 numbers and 3 names")
    edit_feature(root, "action", shape=[3])
    refused(root, r"'action' is said to be \[3\], and its rows have 2 numbers")
    deep = ["x"]
    for _ in range(300):
        deep = [deep]
    edit_feature(root, "action", shape=[2], names=deep)
    refused(root, "names in lists in lists")
    edit_feature(root, "observation.images.a/b", dtype="video", shape=[48, 64, 3])
    refused(root, "has a name that is a path")


def test_states_that_are_not_there(copied):
    root = copied()
    refused(root, r"no numbers called 'observation\.stat', did you", state=["observation.stat"])
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["qpos"] = features.pop("observation.state")
    edit_info(root, features=features)
    refused(root, r"no feature 'observation\.state'.*: action, qpos")
    refused(root, r"has no column 'qpos'. It has ", state=["qpos"])
