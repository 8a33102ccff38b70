"""LeRobot folders of both versions, read; and what is wrong with spoilt ones, told at once.

LeRobot's own loader is held against the reading by hand: tests/golden/check_lerobot_reading.py.
"""

import json
import shutil
import tempfile
import tracemalloc
from pathlib import Path

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

from jaxcam.errors import DatasetError
from jaxcam.files.video import write_video
from jaxcam.interop.lerobot.format import Writer, feature
from jaxcam.interop.lerobot.reading import read_lerobot

EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TOP = "observation.images.top"


def shown(episode, view="top"):
    return np.stack(list(episode.sights[view].decode()))


def psnr(a, b):
    error = np.mean((a.astype(float) - b) ** 2)
    return 10 * np.log10(255**2 / error) if error else np.inf


def check_pictures(recording, made, least=35.0):
    for e, episode in enumerate(recording.episodes):
        for view, key in zip(recording.views, made.pictures, strict=True):
            decoded, wanted = shown(episode, view), np.stack(made.pictures[key][e])
            assert decoded.shape == wanted.shape
            assert decoded.dtype == np.uint8
            assert psnr(decoded, wanted) >= least


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
    unfinished = recording.episodes[0].sights["top"].decode()
    next(unfinished)
    unfinished.close()
    np.testing.assert_array_equal(shown(recording.episodes[1]), wanted[1])


def test_a_videos_own_times(tmp_path):
    made = write_folder(tmp_path / "x", start=0.35, keys=(TOP,))
    check_pictures(read_lerobot(tmp_path / "x"), made)


def test_a_video_of_another_rate_gives_the_nearest_pictures(copied):
    root = copied("v2.1")
    pictures = [picture(0, t // 2 if t % 2 == 0 else 9, 0) for t in range(2 * LENGTHS[0])]
    write_mp4(video_file(root), pictures, rate=2 * RATE)
    decoded = shown(read_lerobot(root).episodes[0])
    assert psnr(decoded, np.stack([picture(0, t, 0) for t in range(LENGTHS[0])])) > 35


@pytest.fixture
def read_only(originals):
    """A folder that nobody may write into, at a place that anybody may enter."""
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)
        root = shutil.copytree(originals()[0], Path(place) / "folder")
        for path in (root, *root.rglob("*")):
            path.chmod(0o555 if path.is_dir() else 0o444)
        yield root
        for path in (root, *root.rglob("*")):
            path.chmod(0o755)


def test_a_folder_that_is_read_only(read_only):
    before = {p: p.stat().st_mtime_ns for p in read_only.rglob("*")}
    with no_rights():
        recording = read_lerobot(read_only)
        assert len(shown(recording.episodes[1])) == LENGTHS[1]
    assert {p: p.stat().st_mtime_ns for p in read_only.rglob("*")} == before


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


def test_episodes_keep_their_order_wherever_their_rows_are(copied, originals):
    root, made = copied(), originals()[1]
    first, second = sorted((root / "data").rglob("*.parquet"))
    rows = pa.concat_tables([parquet.read_table(first), parquet.read_table(second)])
    parquet.write_table(pa.concat_tables([rows[6:10]]), second)
    parquet.write_table(pa.concat_tables([rows[:6], rows[10:]]), first)
    edit_table(root / EPISODES, **{"data/file_index": [0, 1, 0]})
    recording = read_lerobot(root)
    for episode, state in zip(recording.episodes, made.states, strict=True):
        np.testing.assert_array_equal(episode.state, state)
    check_pictures(recording, made)


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


def test_statistics_are_not_needed_and_images_may_be_the_only_pictures(originals):
    root, _ = originals("v3.0", "image")
    assert not (root / "meta/stats.json").exists()
    assert not (root / "videos").exists()
    assert len(read_lerobot(root).episodes) == len(LENGTHS)


def test_pictures_at_uneven_times(copied):
    """Of such videos the index, which has times of decoding, does not tell when each is shown."""
    root = copied("v2.1")
    moments = np.array([0, 1, 4, 5, 11, 12])
    edit_table(data_file(root), timestamp=(moments / RATE).astype(np.float32))
    pictures = [picture(0, t, 0) for t in range(LENGTHS[0])]
    for file in sorted((root / "videos").rglob("*_000000.mp4")):
        write_mp4(file, pictures, "libx265", moments=moments)
    assert psnr(shown(read_lerobot(root).episodes[0]), np.stack(pictures)) > 30
