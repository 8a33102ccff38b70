"""LeRobot folders of both versions, read; and what is wrong with spoilt ones, told at once.

LeRobot's own loader is held against the reading by hand: tests/golden/check_lerobot_reading.py.
"""

import json
import shutil
import tracemalloc

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

import pyarrow as pa
from lerobot_folders import (
    HEIGHT,
    LENGTHS,
    RATE,
    VERSIONS,
    WIDTH,
    data_file,
    edit_feature,
    edit_info,
    edit_table,
    picture,
    video_file,
    write_folder,
    write_mp4,
)
from pyarrow import parquet
from rights import no_rights

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.video import write_video
from jaxcam.interop.lerobot.format import Writer, feature
from jaxcam.interop.lerobot.reading import read_lerobot

EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TOP = "observation.images.top"


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """Folders to copy, by version and kind of pictures."""
    made = {}

    def original(version="v3.0", dtype="video"):
        if (version, dtype) not in made:
            root = tmp_path_factory.mktemp("lerobot") / "folder"
            made[version, dtype] = root, write_folder(root, version, dtype)
        return made[version, dtype]

    return original


@pytest.fixture
def copied(originals, tmp_path):
    """A folder of one's own."""

    def copy(version="v3.0", dtype="video"):
        return shutil.copytree(originals(version, dtype)[0], tmp_path / "copy")

    return copy


def shown(episode, view="top"):
    return np.stack(list(episode.sights[view].decode()))


def psnr(a, b):
    error = np.mean((a.astype(float) - b) ** 2)
    return 10 * np.log10(255**2 / error) if error else np.inf


def check_pictures(recording, made, least=35.0):
    for e, episode in enumerate(recording.episodes):
        for view, key in zip(recording.views, made.pictures, strict=True):
            found, wanted = shown(episode, view), np.stack(made.pictures[key][e])
            assert found.shape == wanted.shape
            assert found.dtype == np.uint8
            assert psnr(found, wanted) >= least


@pytest.mark.parametrize("dtype", ["video", "image"])
@pytest.mark.parametrize("version", VERSIONS)
def test_rows_names_and_pictures(originals, version, dtype):
    root, made = originals(version, dtype)
    recording = read_lerobot(root)
    assert recording.views == ("top", "wrist")
    assert (recording.state_names, recording.action_names) == (("a", "b", "c"), ("x", "y"))
    assert recording.rate == RATE
    assert recording.valid == ()
    assert [e.length for e in recording.episodes] == list(LENGTHS)
    assert [e.instruction for e in recording.episodes] == made.tasks
    for episode, state, action in zip(recording.episodes, made.states, made.actions, strict=True):
        np.testing.assert_array_equal(episode.state, state)
        np.testing.assert_array_equal(episode.action, action)
        assert all((s.height, s.width) == (HEIGHT, WIDTH) for s in episode.sights.values())
        assert all(s.calibration is None for s in episode.sights.values())
    check_pictures(recording, made, np.inf if dtype == "image" else 35)


@pytest.mark.parametrize(
    ("codec", "options"), [("libx264", {"g": "2"}), ("libx265", {}), ("libsvtav1", {"g": "2"})]
)
def test_codecs(tmp_path, codec, options):
    made = write_folder(tmp_path / "x", codec=codec, options=options, keys=(TOP,))
    check_pictures(read_lerobot(tmp_path / "x"), made, 30)


@pytest.mark.parametrize("dtype", ["video", "image"])
def test_episodes_in_any_order_and_beside_each_other(originals, dtype):
    recording = read_lerobot(originals("v3.0", dtype)[0])
    wanted = [shown(episode) for episode in recording.episodes]
    for e in (2, 1, 0, 0, 2, 1):
        np.testing.assert_array_equal(shown(recording.episodes[e]), wanted[e])
    pairs = zip(*(recording.episodes[e].sights["top"].decode() for e in (1, 0)), strict=False)
    for t, (second, first) in enumerate(pairs):
        np.testing.assert_array_equal(second, wanted[1][t])
        np.testing.assert_array_equal(first, wanted[0][t])
    left = recording.episodes[0].sights["top"].decode()
    next(left)
    left.close()
    np.testing.assert_array_equal(shown(recording.episodes[1]), wanted[1])


def test_a_videos_own_times(tmp_path):
    made = write_folder(tmp_path / "x", start=0.35, keys=(TOP,))
    check_pictures(read_lerobot(tmp_path / "x"), made)


def test_a_video_of_another_rate_gives_the_nearest_pictures(copied):
    root = copied("v2.1")
    pictures = [picture(0, t // 2 if t % 2 == 0 else 9, 0) for t in range(2 * LENGTHS[0])]
    write_mp4(video_file(root), pictures, rate=2 * RATE)
    found = shown(read_lerobot(root).episodes[0])
    assert psnr(found, np.stack([picture(0, t, 0) for t in range(LENGTHS[0])])) > 35


def test_reading_writes_nothing_and_needs_no_rights_to(copied):
    root = copied()
    read_lerobot(root)  # imports what it needs
    before = {p: p.stat().st_mtime_ns for p in root.rglob("*")}
    for path in (root, *root.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    root.parent.chmod(0o755)
    with no_rights() if _may_be_entered(root) else open(root / "meta/info.json"):
        recording = read_lerobot(root)
        assert len(shown(recording.episodes[1])) == LENGTHS[1]
    assert {p: p.stat().st_mtime_ns for p in root.rglob("*")} == before


def _may_be_entered(root):
    return all(parent.stat().st_mode & 0o5 == 0o5 for parent in root.parents)


def test_memory_does_not_grow_with_the_video(tmp_path):
    root = tmp_path / "x"
    write_folder(root, "v2.1", keys=(TOP,))
    sight = read_lerobot(root).episodes[2].sights["top"]
    tracemalloc.start()
    for _ in sight.decode():
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 6 * HEIGHT * WIDTH * 3 < LENGTHS[2] * HEIGHT * WIDTH * 3


def test_written_and_read_are_inverse(tmp_path):
    rng, rate = np.random.default_rng(1), 15
    features = {
        "observation.state": feature("float32", (2,), ["p", "q"]),
        "action": feature("float32", (1,), ["u"]),
        TOP: feature("video", (HEIGHT, WIDTH, 3), ["height", "width", "channels"]),
        "camera.top.base_from_camera": feature("float32", (4, 4)),
        "camera.top.intrinsics": feature("float32", (3, 3)),
    }
    K = np.array([[61.3, 0, 31.7], [0, 60.9, 24.2], [0, 0, 1]], np.float32)
    made = []
    with Writer(tmp_path / "x", features, rate, "Do it.") as writer:
        for e, length in enumerate(LENGTHS):
            poses = np.tile(np.eye(4, dtype=np.float32), (length, 1, 1))
            poses[:, :3, 3] = rng.normal(size=(length if e else 1, 3))
            rows = {
                "observation.state": rng.normal(size=(length, 2)).astype(np.float32),
                "action": rng.normal(size=(length, 1)).astype(np.float32),
                "camera.top.base_from_camera": poses,
                "camera.top.intrinsics": np.broadcast_to(K, (length, 3, 3)),
            }
            pictures = np.stack([picture(e, t, 0) for t in range(length)])
            writer.add(rows, {TOP: pictures})
            made.append((rows, pictures))
        writer.finish("none")
    recording = read_lerobot(tmp_path / "x")
    assert recording.rate == rate
    for e, (episode, (rows, pictures)) in enumerate(zip(recording.episodes, made, strict=True)):
        np.testing.assert_array_equal(episode.state, rows["observation.state"])
        np.testing.assert_array_equal(episode.action, rows["action"])
        assert episode.instruction == "Do it."
        camera = episode.sights["top"].calibration
        np.testing.assert_array_equal(camera.K, K)
        poses = rows["camera.top.base_from_camera"]
        np.testing.assert_array_equal(camera.base_from_camera, poses if e else poses[0])
        assert camera.source == "the columns camera.top.*"
        assert psnr(shown(episode), pictures) > 35


def test_colours_of_a_video_that_says_how_they_are_coded(tmp_path):
    """BT.709 read as BT.601 would be up to 23 levels off, as LeRobot's with PyAV 15 are."""
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 120, 40)]
    bars = np.repeat(np.array([colours], np.uint8), 16, axis=1).repeat(HEIGHT, axis=0)
    root = tmp_path / "x"
    write_folder(root, "v2.1", keys=(TOP,))
    write_video(video_file(root), np.stack([bars] * LENGTHS[0]), RATE, crf=5)
    middle = shown(read_lerobot(root).episodes[0])[3, HEIGHT // 2, 8::16]
    np.testing.assert_allclose(middle.astype(int), colours, atol=3)


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


def test_the_dataset_says_what_it_holds_out(copied):
    root = copied()
    edit_info(root, splits={"train": "0:1", "val": "1:3"})
    assert read_lerobot(root).valid == (1, 2)
    edit_info(root, splits={"val": "1:4"})
    with pytest.raises(DatasetError, match="split 'val' is '1:4'"):
        read_lerobot(root)


def test_the_fingerprint_is_of_all_that_training_sees(copied, originals, tmp_path):
    root = copied()
    whole = read_lerobot(root).fingerprint
    assert len(whole) == 16
    assert read_lerobot(originals()[0]).fingerprint == whole  # wherever the folder is
    prints = {whole}
    edit_info(root, fps=10)
    prints.add(read_lerobot(root, tolerance=0.04).fingerprint)
    edit_info(root, fps=RATE)
    edit_feature(root, "action", names=["x", "z"])
    prints.add(read_lerobot(root).fingerprint)
    edit_feature(root, "action", names=["x", "y"])
    assert read_lerobot(root).fingerprint == whole
    tasks = pa.table({"task_index": [0, 1], "task": ["Another.", "Two."]})
    parquet.write_table(tasks, root / "meta/tasks.parquet")
    prints.add(read_lerobot(root).fingerprint)
    write_mp4(video_file(root), [picture(3, t, 0) for t in range(10)])
    prints.add(read_lerobot(root).fingerprint)
    rows = parquet.read_table(data_file(root)).column("action").to_pylist()
    edit_table(data_file(root), action=[*rows[:-1], [0.0, 1.0]])
    prints.add(read_lerobot(root).fingerprint)
    assert len(prints) == 6


def test_a_changed_image_changes_the_fingerprint(copied):
    root = copied("v3.0", "image")
    before = read_lerobot(root).fingerprint
    column = parquet.read_table(data_file(root)).column(TOP)
    edit_table(data_file(root), **{TOP: [column[1].as_py(), *column.to_pylist()[1:]]})
    assert read_lerobot(root).fingerprint != before


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
        ({"index": list(range(1, 11))}, "the index of episode 0 counts from 1"),
        ({"timestamp": [0.0] * 10}, "timestamps of episode 0 do not rise"),
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


def test_times_out_of_order_of_decoding_are_looked_up(copied):
    root = copied("v2.1")
    pictures = [picture(0, t // 2, 0) for t in range(2 * LENGTHS[0])]
    write_mp4(video_file(root), pictures, rate=2 * RATE)
    assert len(shown(read_lerobot(root).episodes[0])) == LENGTHS[0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"bytes": b"no picture", "path": "x.png"}, "step 0 cannot be decoded"),
        ({"bytes": None, "path": "images/x.png"}, "step 0 is not in the table"),
        ("x.png", "has no PNG or JPEG but string"),
    ],
)
def test_images_that_are_none(copied, content, words):
    root = copied("v3.0", "image")
    edit_table(data_file(root), **{TOP: [content] * 10})
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


def test_statistics_are_not_needed_and_images_may_be_the_only_pictures(originals):
    root, _ = originals("v3.0", "image")
    assert not (root / "meta/stats.json").exists()
    assert not (root / "videos").exists()
    assert len(read_lerobot(root).episodes) == len(LENGTHS)
