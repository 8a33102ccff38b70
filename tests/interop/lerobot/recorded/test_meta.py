"""What a LeRobot folder says of itself, of either version, and what it cannot say."""

import shutil

import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

import pyarrow as pa
from lerobot_datasets import (
    EPISODES,
    TOP,
    VERSIONS,
    data_file,
    edit_info,
    edit_table,
    refused,
    video_file,
)

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.reading import read_lerobot


def test_the_dataset_says_what_it_holds_out(copied):
    root = copied()
    edit_info(root, splits={"train": "0:1", "val": "1:3"})
    assert read_lerobot(root).valid == (1, 2)
    edit_info(root, splits={"val": "1:4"})
    with pytest.raises(DatasetError, match="split 'val' is '1:4'"):
        read_lerobot(root)


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


def test_indices_that_disagree_with_lengths(copied):
    root = copied()
    edit_table(root / EPISODES, dataset_to_index=[6, 11, 19])
    refused(root, "episode 1 has 4 steps, and the indices 6 to 11")


def test_a_view_that_did_not_see_an_episode(copied):
    root = copied()
    keys = ("chunk_index", "file_index", "from_timestamp")
    edit_table(root / EPISODES, **{f"videos/{TOP}/{k}": pa.array([0, 0, None]) for k in keys})
    recording = read_lerobot(root)
    assert [sorted(e.sights) for e in recording.episodes] == [["top", "wrist"]] * 2 + [["wrist"]]
    edit_table(root / EPISODES, **{f"videos/{TOP}/from_timestamp": pa.array([0.0, None, None])})
    refused(root, "two whole numbers and a time")
