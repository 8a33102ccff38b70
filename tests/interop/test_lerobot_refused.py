"""What is wrong with spoilt LeRobot folders, told in one line before anything is decoded."""

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

import pyarrow as pa
from lerobot_folders import (
    LENGTHS,
    RATE,
    VERSIONS,
    data_file,
    edit_feature,
    edit_info,
    edit_table,
    picture,
    video_file,
    write_mp4,
)
from pyarrow import parquet

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.interop.lerobot.reading import read_lerobot

EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TOP = "observation.images.top"


def shown(episode, view="top"):
    return np.stack(list(episode.sights[view].decode()))


def refused(root, match, **asked):
    """Reading ends in one line, before any episode is decoded."""
    with pytest.raises(DatasetError, match=match) as caught:
        read_lerobot(root, **asked)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("version", "words"),
    [
        ("v4.0", "A newer LeRobot wrote it"),
        ("v3.1", "A newer LeRobot wrote it"),
        ("v2.0", r"convert_dataset_v20_to_v21\.py"),
        ("v1.6", r"convert_dataset_v1_to_v2\.py"),
        ("three", "'three'; v3.0 and v2.1 are read"),
        (None, "format None"),
        (3, "format 3"),
    ],
)
def test_other_versions(copied, version, words):
    root = copied()
    edit_info(root, codebase_version=version)
    refused(root, words)


def test_folders_that_are_none(tmp_path):
    refused(tmp_path, "no LeRobot dataset: it has no meta/info.json")
    refused(tmp_path / "missing", "no LeRobot dataset")
    (tmp_path / "meta_data").mkdir()
    (tmp_path / "meta_data/info.json").write_text("{}")
    refused(tmp_path, r"convert_dataset_v1_to_v2\.py")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not JSON"),
        ("[" * 100000, "not JSON"),
        ("[1]", "is a JSON list, not an object"),
        ('{"codebase_version": "v3.0"}', "features are names with what each one is, got None"),
    ],
)
def test_json_that_is_none(copied, text, words):
    root = copied()
    (root / "meta/info.json").write_text(text)
    refused(root, words)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fps": "fast"}, "fps must be float, got 'fast'"),
        ({"fps": 0}, "fps and chunks_size are more than 0"),
        ({"fps": float("nan")}, "fps must be finite"),
        ({"total_episodes": 4}, "says 4 episodes, and its lists have 3"),
        ({"total_episodes": 10**30}, "more than 64 bits"),
        ({"data_path": None}, "has no 'data_path'"),
        ({"video_path": None}, "no video_path"),
        ({"features": {"action": 3}}, "feature 'action' is a JSON int, not an object"),
        ({"features": {"action": {"shape": [2]}}}, "feature 'action' has no 'dtype'"),
        ({"splits": ["train"]}, "splits must be dict"),
        ({"chunks_size": 2.5}, "chunks_size must be int"),
        ({"data_path": "../{chunk_index}.parquet"}, "leads out of the folder"),
        ({"data_path": "/etc/{chunk_index}"}, "leads out of the folder"),
        ({"video_path": "{video_key}/../../../x.mp4"}, "leads out of the folder"),
        ({"data_path": "data/{episode}.parquet"}, "no {episode} is known"),
        ({"data_path": "data/{chunk_index:99999999d}"}, "braces around what is no field"),
        ({"data_path": "data/{chunk_index.__class__}"}, "braces around what is no field"),
    ],
)
def test_values_that_cannot_be(copied, changes, words):
    root = copied()
    edit_info(root, **changes)
    refused(root, words)


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


def test_columns_that_clash(copied):
    root = copied()
    table = parquet.read_table(data_file(root))
    parquet.write_table(table.append_column("action", table.column("action")), data_file(root))
    refused(root, "has two columns 'action'")


def test_indices_that_disagree_with_lengths(copied):
    root = copied()
    edit_table(root / EPISODES, dataset_to_index=[6, 11, 19])
    refused(root, "episode 1 has 4 steps, and the indices 6 to 11")


def test_states_that_are_not_there(copied):
    root = copied()
    refused(root, r"no numbers called 'observation\.stat', did you", state=["observation.stat"])
    features = json.loads((root / "meta/info.json").read_text())["features"]
    features["qpos"] = features.pop("observation.state")
    edit_info(root, features=features)
    refused(root, r"no feature 'observation\.state'.*: action, qpos")
    refused(root, r"has no column 'qpos'. It has ", state=["qpos"])


@pytest.mark.parametrize("version", VERSIONS)
def test_missing_files(originals, tmp_path, version):
    meta = ["meta/tasks.parquet", EPISODES]
    if version == "v2.1":
        meta = ["meta/tasks.jsonl", "meta/episodes.jsonl"]
    source = originals(version)[0]
    for file in (*meta, data_file(source), video_file(source)):
        root = shutil.copytree(source, tmp_path / "copy")
        (root / file if isinstance(file, str) else root / file.relative_to(source)).unlink()
        refused(root, "is missing|has no table of its episodes")
        shutil.rmtree(root)


def test_damaged_tables(copied):
    root = copied()
    content = data_file(root).read_bytes()
    data_file(root).write_bytes(content[: len(content) // 2])
    refused(root, r"file-000\.parquet is no whole table")
    data_file(root).write_bytes(content[:200] + b"\0" * 800 + content[1000:])
    refused(root, r"file-000\.parquet (is damaged|is no whole table)")


def test_damaged_lines(copied):
    root = copied("v2.1")
    path = root / "meta/episodes.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "{", lines[2]]))
    refused(root, r"episodes\.jsonl, line 2, is damaged")
    path.write_text("\n".join([lines[0], '{"episode_index": 1}', lines[2]]))
    refused(root, r"episodes\.jsonl: The row 2 has no 'length'")
    path.write_text("\n".join([lines[0], lines[0], lines[2]]))
    refused(root, "episode 0 is listed twice")
    path.write_text("\n".join([*lines[:2], lines[2].replace("9", "0")]))
    refused(root, "episode 2 has 0 steps")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"episode_index": [0] * 5 + [1] * 5}, "episode 0 has 5 rows, and meta says 6 steps"),
        ({"episode_index": [0] * 6 + [1] * 3 + [7]}, "rows of episode 7, which meta does not"),
        ({"episode_index": [0, 1] * 5}, "rows of one episode_index are not together"),
        ({"frame_index": [0, 1, 3, 2, 4, 5, 0, 1, 2, 3]}, "frame_index 3 in its row 2"),
        ({"episode_index": [0.0] * 6 + [float("inf")] * 4}, "whole numbers, got float64"),
        ({"episode_index": [[0, 1]] * 10}, "'episode_index' has 2 numbers a row"),
        ({"index": list(range(1, 11))}, "the index of episode 0 counts from 1"),
        ({"timestamp": [0.0] * 10}, "timestamps of episode 0 do not rise"),
        ({"timestamp": [float("inf")] * 10}, "timestamps of episode 0 do not rise"),
        ({"task_index": [5] * 10}, "episode 0 has the task_index 5"),
        ({"timestamp": None}, "has no column 'timestamp'"),
        ({"action": [[0.0, 1.0]] * 9 + [[0.0]]}, "'action' has rows of 1 to 2 numbers"),
        ({"action": [[0.0, 1.0]] * 9 + [None]}, "'action' has 1 empty places"),
        ({"action": ["left"] * 10}, "'action' are no numbers but string"),
        ({"action": [[0.0, float("nan")]] * 10}, "episode 0: 'y' of action is nan in step 0"),
        ({"action": [[0.0, 1e300]] * 10}, "episode 0: 'y' of action is inf in step 0"),
        ({"observation.state": [[float("nan")] * 3] * 10}, "'a' of observation.state is nan"),
    ],
)
def test_rows_that_cannot_be(copied, columns, words):
    root = copied()
    edit_table(data_file(root), **columns)
    refused(root, words)


def test_a_video_that_is_cut_short(copied):
    root = copied()
    path = video_file(root)
    content = path.read_bytes()
    path.write_bytes(content[:-40])
    message = refused(root, r"mp4 is cut short: .* first those of episode 1 of view 'top'")
    assert str(path) in message
    path.write_bytes(content[:300])
    refused(root, r"file-000\.mp4 (cannot be|has no video).*\(episode 0 of view 'top'")
    path.write_bytes(b"")
    refused(root, r"file-000\.mp4 cannot be decoded")
    path.write_bytes(b"no video at all" * 100)
    refused(root, r"file-000\.mp4 cannot be decoded")


def test_a_codec_that_cannot_be_decoded(copied):
    root = copied()
    path = video_file(root)
    path.write_bytes(path.read_bytes().replace(b"avc1", b"xyz1").replace(b"avcC", b"xyzC"))
    refused(root, r"file-000\.mp4 is coded in a way that PyAV [\d.]+ cannot decode .*episode 0")


def test_a_video_that_is_damaged_within(copied):
    root = copied("v2.1")
    path = video_file(root)
    content = bytearray(path.read_bytes())
    for i in range(content.index(b"mdat") + 700, len(content)):
        content[i] ^= 0x5A
    path.write_bytes(content)
    with pytest.raises(DatasetError, match=r"episode_000000\.mp4.*episode 0 of view 'top'"):
        shown(read_lerobot(root).episodes[0])


def test_times_that_do_not_fit(copied):
    root = copied()
    times = [t / 15 for t in range(6)] + [t / RATE for t in range(4)]
    edit_table(data_file(root), timestamp=times)
    words = r"episode 0 of view 'top': no picture for step 1 at 0\.0667 s; the nearest is 0\.0167 s"
    refused(root, words)
    assert shown(read_lerobot(root, tolerance=0.02).episodes[0]).shape[0] == LENGTHS[0]
    for tolerance in (0.025, 0.0, float("nan")):
        with pytest.raises(ConfigError, match="tolerance is more than 0 and less than half a step"):
            read_lerobot(root, tolerance=tolerance)


def test_too_few_pictures(copied):
    root = copied()
    write_mp4(video_file(root), [picture(0, t, 0) for t in range(7)])
    refused(root, r"episode 1 of view 'top': no picture for step 1 at .* has 7 pictures from 0\.0")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"bytes": b"no picture", "path": "x.png"}, "step 0 cannot be decoded"),
        ({"bytes": None, "path": "images/x.png"}, "step 0 is not in the table"),
        ("x.png", "has no PNG or JPEG but string"),
        (None, r"has no column 'observation\.images\.top'. It has "),
    ],
)
def test_images_that_are_none(copied, content, words):
    root = copied("v3.0", "image")
    edit_table(data_file(root), **{TOP: [content] * 10 if content else None})
    refused(root, words)


def test_an_image_that_is_damaged_is_told_as_it_is_decoded(copied):
    root = copied("v3.0", "image")
    images = parquet.read_table(data_file(root)).column(TOP).to_pylist()
    images[7] = {"bytes": images[7]["bytes"][:40], "path": ""}
    edit_table(data_file(root), **{TOP: images})
    recording = read_lerobot(root)
    assert len(shown(recording.episodes[0])) == LENGTHS[0]
    with pytest.raises(DatasetError, match="episode 1 of view 'top': the picture of step 1"):
        shown(recording.episodes[1])


def test_a_view_that_did_not_see_an_episode(copied):
    root = copied()
    keys = ("chunk_index", "file_index", "from_timestamp")
    edit_table(root / EPISODES, **{f"videos/{TOP}/{k}": pa.array([0, 0, None]) for k in keys})
    recording = read_lerobot(root)
    assert [sorted(e.sights) for e in recording.episodes] == [["top", "wrist"]] * 2 + [["wrist"]]
    edit_table(root / EPISODES, **{f"videos/{TOP}/from_timestamp": pa.array([0.0, None, None])})
    refused(root, "two whole numbers and a time")
