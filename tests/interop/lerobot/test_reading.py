"""LeRobot folders of both versions, read whole.

LeRobot's own loader is held against the reading by hand: tests/golden/check_lerobot_reading.py.
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

import pyarrow as pa
from lerobot_datasets import (
    HEIGHT,
    LENGTHS,
    RATE,
    TOP,
    VERSIONS,
    WIDTH,
    check_pictures,
    data_file,
    edit_feature,
    edit_info,
    edit_table,
    picture,
    psnr,
    shown,
    video_file,
    write_mp4,
)
from pyarrow import parquet
from rights import no_rights

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.format import Writer, feature
from jaxcam.interop.lerobot.reading import read_lerobot


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


def test_a_folder_that_is_read_only(read_only):
    before = {p: p.stat().st_mtime_ns for p in read_only.rglob("*")}
    with no_rights():
        recording = read_lerobot(read_only)
        assert len(shown(recording.episodes[1])) == LENGTHS[1]
    assert {p: p.stat().st_mtime_ns for p in read_only.rglob("*")} == before


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


def test_the_fingerprint_is_of_all_that_training_sees(copied, originals, tmp_path):
    root = copied()
    recording = read_lerobot(root)
    whole, pictures = recording.fingerprint, recording.pictures
    assert len(whole) == len(pictures) == 16
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
    assert read_lerobot(root).pictures == pictures
    write_mp4(video_file(root), [picture(3, t, 0) for t in range(10)])
    assert read_lerobot(root).pictures != pictures
    prints.add(read_lerobot(root).fingerprint)
    rows = parquet.read_table(data_file(root)).column("action").to_pylist()
    edit_table(data_file(root), action=[*rows[:-1], [0.0, 1.0]])
    prints.add(read_lerobot(root).fingerprint)
    assert len(prints) == 6


def test_statistics_are_not_needed_and_images_may_be_the_only_pictures(originals):
    root, _ = originals("v3.0", "image")
    assert not (root / "meta/stats.json").exists()
    assert not (root / "videos").exists()
    assert len(read_lerobot(root).episodes) == len(LENGTHS)


def with_errors(root, errors, dtype="bool"):
    """The folder with a column `errors`, whose values follow from the step."""
    edit_feature(root, "errors", dtype=dtype, shape=[1])
    for path in (root / "data").rglob("*.parquet"):
        steps = parquet.read_table(path)["frame_index"].to_pylist()
        edit_table(path, errors=[errors(step) for step in steps])
    return root


@pytest.mark.parametrize("version", VERSIONS)
def test_a_column_says_which_actions_err(originals, copied, version):
    recording = read_lerobot(with_errors(copied(version), lambda step: step in (1, 2)))
    for episode in recording.episodes:
        np.testing.assert_array_equal(np.flatnonzero(episode.errors), [1, 2])
    assert recording.fingerprint != read_lerobot(originals(version)[0]).fingerprint


def test_errors_that_are_none_or_of_somebody_else(originals, copied):
    usual = read_lerobot(originals()[0]).fingerprint
    root = with_errors(copied(), lambda step: False)
    recordings = [read_lerobot(root), read_lerobot(with_errors(root, float, "float32"))]
    for recording in recordings:
        assert all(episode.errors is None for episode in recording.episodes)
        assert recording.fingerprint == usual


@pytest.mark.parametrize("value", [[True, False], 0.5, float("nan"), 3])
def test_errors_that_are_not_what_was_declared_are_refused(copied, value):
    with pytest.raises(DatasetError, match=r"episode 0: 'errors' is a column of [12] number"):
        read_lerobot(with_errors(copied(), lambda step: value))


def test_an_episode_of_errors_alone_is_refused(copied):
    with pytest.raises(DatasetError, match=r"episode 0: all .* steps are 'errors'.* Leave the ep"):
        read_lerobot(with_errors(copied(), lambda step: True))
