"""Exports in LeRobot's format, read back as LeRobot does: by the paths and rows of the metadata.

LeRobot's own loader reads one by hand: tests/golden/check_lerobot.py.
"""

import json
import subprocess
import sys
import time
from dataclasses import replace

import av
import numpy as np
import pytest
from many_cameras import with_errors, with_optics
from scipy.spatial.transform import Rotation

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

from pyarrow import parquet

from jaxcam.config.datasets import LerobotConfig
from jaxcam.data.batches import make_dataset
from jaxcam.data.demos import read_demos
from jaxcam.data.writer import DemoWriter
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.interop.calibrations import calibrated, require_calibrated, sources
from jaxcam.interop.lerobot import format as lerobot_format
from jaxcam.interop.lerobot.dataset import export_dataset
from jaxcam.interop.lerobot.format import Writer, column_of, feature, statistics_of, video_feature
from jaxcam.interop.lerobot.reading import read_lerobot

PIXELS = 24
SCALARS = {"timestamp", "frame_index", "episode_index", "index", "task_index"}


@pytest.fixture(scope="module")
def data(demos, pictures, lift):
    return make_dataset(demos, pictures, "eef_abs", lift.scene("randomized"))


@pytest.fixture(scope="module")
def folder(demos, pictures, tmp_path_factory):
    out = tmp_path_factory.mktemp("lerobot") / "out"
    return export_dataset(config(demos, out))


def config(demos, out, **settings):
    settings = {"resolution": PIXELS, "action_space": "eef_abs"} | settings
    return LerobotConfig(dataset=str(demos.path), out=str(out), **settings)


def read_json(folder, name):
    return json.loads((folder / "meta" / f"{name}.json").read_text())


def episodes(folder):
    return parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()


def pictures_of(folder, episode, key):
    """An episode's pictures in one video, by the times that its metadata gives."""
    info = read_json(folder, "info")
    where = {k: episode[f"videos/{key}/{k}_index"] for k in ("chunk", "file")}
    path = info["video_path"].format(
        video_key=key, chunk_index=where["chunk"], file_index=where["file"]
    )
    first, last = (
        round(episode[f"videos/{key}/{k}_timestamp"] * info["fps"]) for k in ("from", "to")
    )
    with av.open(str(folder / path)) as video:
        shown = list(video.decode(video=0))
    times = [float(f.time) for f in shown]
    np.testing.assert_allclose(times, np.arange(len(times)) / info["fps"], atol=1e-4)
    return np.stack([f.to_ndarray(format="rgb24") for f in shown[first:last]])


def test_info_names_what_there_is(folder, data):
    info = read_json(folder, "info")
    assert info["codebase_version"] == "v3.0"
    assert info["total_episodes"] == data.train
    assert info["total_frames"] == data.lengths[: data.train].sum()
    assert info["splits"] == {"train": f"0:{data.train}"}
    features = info["features"]
    assert features["action"]["names"] == ["x", "y", "z", "rx", "ry", "rz", "gripper"]
    assert features["observation.state"]["shape"] == [11]
    assert len(features["observation.state"]["names"]) == 11
    for view in range(3):
        assert features[f"observation.images.view_{view}"]["shape"] == [PIXELS, PIXELS, 3]
    assert not [k for k in features if "/" in k]  # LeRobot refuses these
    # LeRobot takes whatever has "image" in its name for a picture.
    pictures = [k for k in features if "image" in k]
    assert all(features[k]["dtype"] == "video" for k in pictures)


def test_rows_are_the_demonstrations(folder, data):
    info, at = read_json(folder, "info"), 0
    for e, episode in enumerate(episodes(folder)):
        length = int(data.lengths[e])
        assert episode["episode_index"] == e
        assert (episode["dataset_from_index"], episode["length"]) == (at, length)
        path = info["data_path"].format(
            chunk_index=episode["data/chunk_index"], file_index=episode["data/file_index"]
        )
        table = parquet.read_table(folder / path)
        assert set(table.column_names) == {
            k for k, f in info["features"].items() if f["dtype"] != "video"
        }
        rows = table.slice(at, length).to_pydict()
        np.testing.assert_array_equal(rows["action"], data.actions[e, :length])
        np.testing.assert_array_equal(rows["observation.state"], data.proprio[e, :length])
        assert rows["frame_index"] == list(range(length))
        assert rows["index"] == list(range(at, at + length))
        np.testing.assert_allclose(rows["timestamp"], np.arange(length) / 20, atol=1e-6)
        for v, camera in enumerate(data.windows[e]):
            poses = np.array(rows[f"camera.view_{v}.base_from_camera"])
            np.testing.assert_array_equal(poses, [data.base_from_camera[camera]] * length)
            K = np.array(rows[f"camera.view_{v}.intrinsics"])
            np.testing.assert_array_equal(K, [data.K[camera]] * length)
        at += length
    assert parquet.ParquetFile(folder / path).num_row_groups == data.train


def test_videos_are_the_pictures(folder, data):
    for e, episode in enumerate(episodes(folder)):
        t = np.arange(data.lengths[e])
        for v in range(3):
            shown = pictures_of(folder, episode, f"observation.images.view_{v}")
            drawn = data.pictures.rgb[data.pictures.layout.at(np.array(e), t, np.array(v))]
            assert shown.shape == drawn.shape
            error = np.mean((shown.astype(float) - drawn) ** 2, (1, 2, 3))
            others = np.mean((shown.astype(float) - drawn[::-1]) ** 2)
            assert (10 * np.log10(255**2 / error) > 28).all()
            assert error.mean() < others  # the order is told apart


def test_statistics_are_those_of_all_rows(folder, data):
    stats = read_json(folder, "stats")
    assert set(stats) == set(read_json(folder, "info")["features"])
    real = np.concatenate([data.actions[e, : data.lengths[e]] for e in range(data.train)])
    real = real.astype(float)
    for name, value in (("mean", real.mean(0)), ("std", real.std(0)), ("max", real.max(0))):
        np.testing.assert_allclose(stats["action"][name], value, atol=1e-6)
    np.testing.assert_allclose(stats["action"]["q50"], np.median(real, 0), atol=1e-6)
    assert stats["action"]["count"] == [len(real)]
    assert np.shape(stats["timestamp"]["mean"]) == (1,)
    drawn = []
    for e in range(data.train):
        t = np.arange(data.lengths[e])
        drawn.append(data.pictures.rgb[data.pictures.layout.at(np.array(e), t, np.array(1))])
    pixels = np.concatenate(drawn).reshape(-1, 3) / 255
    picture = stats["observation.images.view_1"]
    assert np.shape(picture["mean"]) == (3, 1, 1)
    for name, value in (
        ("mean", pixels.mean(0)),
        ("std", pixels.std(0)),
        ("min", pixels.min(0)),
        ("max", pixels.max(0)),
        ("q10", np.quantile(pixels, 0.1, 0)),
    ):
        np.testing.assert_allclose(np.ravel(picture[name]), value, atol=2e-3, err_msg=name)


def test_metadata_tells_the_cameras(folder, data, demos, lift):
    about = read_json(folder, "jaxcam")
    np.testing.assert_allclose(about["intrinsics"], data.K[0])
    np.testing.assert_allclose(
        about["world_from_base"], lift.scene("randomized").world_from_base, atol=1e-12
    )
    assert (about["task"], about["action_space"]) == ("lift", "eef_abs")
    assert about["source"]["fingerprint"] == demos.fingerprint


@pytest.mark.parametrize(
    ("optics", "is_one_k"),
    [({"fovy": "30:60", "lens": "opencv:-0.3:0"}, False), ({"fovy": "60"}, True)],
)
def test_metadata_has_no_k_of_all_cameras_where_they_differ(demos, tmp_path, optics, is_one_k):
    """Each row has its camera's own, and the metadata says so."""
    varied = with_optics(demos, **optics)
    header = replace(varied.header, train=1, valid=0)
    with DemoWriter(tmp_path / "varied.hdf5", header) as writer:
        writer.append(0, demos.train[0])
        writer.finish()
    varied = read_demos(tmp_path / "varied.hdf5")
    folder = export_dataset(config(varied, tmp_path / "out"))
    about, K = read_json(folder, "jaxcam"), varied.header.intrinsics(PIXELS)
    assert "camera.<view>.intrinsics" in about["conventions"]["intrinsics"]
    assert f"drawn from fovy {optics['fovy']}" in about["conventions"]["intrinsics"]
    if is_one_k:
        np.testing.assert_allclose(about["intrinsics"], K[0], rtol=1e-6)
        assert about["fovy_deg"] == pytest.approx(60)
    else:
        assert about["intrinsics"] is about["fovy_deg"] is None
        assert "camera.<view>.distortion" in about["conventions"]["intrinsics"]
    sight = next(iter(read_lerobot(folder).episodes[0].sights.values()))
    np.testing.assert_allclose(sight.calibration.K, K[demos.train[0].cameras[0]], rtol=1e-6)


def test_errors_have_a_column_and_nothing_has_it_without(folder, demos, tmp_path):
    assert "errors" not in read_json(folder, "info")["features"]
    erring = with_errors(demos.train[0])
    with DemoWriter(tmp_path / "erring.hdf5", replace(demos.header, train=2, valid=0)) as writer:
        for i, demo in enumerate((erring, demos.train[1])):
            writer.append(i, demo)
        writer.finish()
    out = export_dataset(config(read_demos(tmp_path / "erring.hdf5"), tmp_path / "out"))
    assert read_json(out, "info")["features"]["errors"] == feature("bool", (1,))
    column = parquet.read_table(out / "data/chunk-000/file-000.parquet")["errors"].to_pylist()
    assert column == erring.errors.tolist() + [False] * demos.train[1].length
    again = read_lerobot(out)
    assert again.state_names == read_lerobot(folder).state_names
    np.testing.assert_array_equal(again.episodes[0].errors, erring.errors)
    assert again.episodes[1].errors is None
    assert all(episode.errors is None for episode in read_lerobot(folder).episodes)


def test_metadata_tells_what_rotations_are_counted_from(folder, data, demos):
    about = read_json(folder, "jaxcam")
    assert "R_world = exp(r) @ nominal_grip" in about["conventions"]["actions"]
    for demo, actions in zip(demos.episodes, data.actions, strict=True):
        turned = Rotation.from_rotvec(actions[: demo.length, 3:6])
        reached = turned * Rotation.from_matrix(about["nominal_grip"])
        apart = reached * Rotation.from_rotvec(demo.actions[:, 3:6]).inv()
        assert apart.magnitude().max() < 1e-6


def test_tasks_are_indexed_by_their_words(folder, lift):
    table = parquet.read_table(folder / "meta/tasks.parquet")
    about = json.loads(table.schema.metadata[b"pandas"])
    assert about["index_columns"] == ["task"]
    assert table.to_pylist() == [{"task_index": 0, "task": lift.prompt}]


def test_validation_joints_and_words(demos, pictures, tmp_path):
    out = tmp_path / "valid"
    export_dataset(
        config(
            demos, out, validation=True, action_space="joint_delta", instruction="Lift the cube."
        )
    )
    info = read_json(out, "info")
    assert info["total_episodes"] == len(demos.valid)
    assert info["features"]["action"]["names"][0] == "joint_1"
    assert [k for k in info["features"] if "images" in k] == ["observation.images.view_0"]
    assert episodes(out)[0]["tasks"] == ["Lift the cube."]


def test_nothing_is_overwritten_and_what_a_killed_export_left_goes(demos, pictures, tmp_path):
    out = tmp_path / "out"
    dead, theirs = tmp_path / ".out.0123456789ab.part", tmp_path / "out.part"
    for folder in (dead, theirs):
        (folder / "data").mkdir(parents=True)
        (folder / "data" / "old").write_text("half")
    export_dataset(config(demos, out, validation=True))
    assert not dead.exists()
    assert (theirs / "data" / "old").exists()
    assert not list(out.rglob("old"))
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*")}
    with pytest.raises(DatasetError, match=r"out exists. Choose another folder"):
        export_dataset(config(demos, out))
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*")} == before


def test_full_disk_is_told_and_leaves_no_dataset(demos, pictures, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "finish", full)
    with pytest.raises(DatasetError, match=r"No space left on device. Make room"):
        export_dataset(config(demos, tmp_path / "out", validation=True))
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.glob(".out*"))


def test_files_that_grow_too_large_are_followed_by_others(tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot_format, "DATA_MB", 1e-6)
    monkeypatch.setattr(lerobot_format, "VIDEO_MB", 1e-6)
    monkeypatch.setattr(lerobot_format, "CHUNK", 2)
    features = {"action": feature("float32", (2,)), "v": video_feature(16, 16, 20)}
    rng = np.random.default_rng(0)
    with Writer(tmp_path, features, 20, "try") as writer:
        for _ in range(3):
            noise = rng.integers(0, 255, (5, 16, 16, 3), np.uint8)
            writer.add({"action": np.zeros((5, 2), np.float32)}, {"v": noise})
        writer.finish("panda")
    places = [(e["data/chunk_index"], e["data/file_index"]) for e in episodes(tmp_path)]
    assert places == [(0, 0), (0, 1), (1, 0)]
    for episode in episodes(tmp_path):
        assert pictures_of(tmp_path, episode, "v").shape == (5, 16, 16, 3)
    assert not list(tmp_path.rglob("*.part"))


def test_a_column_of_matrices():
    values = np.random.default_rng(0).normal(size=(7, 3, 4))
    stats = statistics_of(values)
    assert stats["q99"].shape == (3, 4)
    assert column_of(values).to_pylist() == values.tolist()
    np.testing.assert_allclose(stats["std"], values.std(0))


@pytest.mark.parametrize("bad", [{"resolution": 85}, {"resolution": 8}, {"action_space": "joint"}])
def test_bad_settings(bad):
    with pytest.raises(ConfigError):
        LerobotConfig(dataset="a", out="b", **bad)


def test_without_validation_demonstrations(demos, pictures, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "jaxcam.interop.lerobot.dataset.read_demos", lambda _: replace(demos, valid=[])
    )
    with pytest.raises(DatasetError, match="no validation demonstrations"):
        export_dataset(config(demos, tmp_path / "out", validation=True))


def without_pyarrow(*args):
    code = (
        f"import sys, runpy; sys.modules['pyarrow'] = None; sys.argv = ['x', *{args}];"
        "runpy.run_module('jaxcam.lerobot', run_name='__main__')"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def test_help_is_fast_and_needs_no_pyarrow():
    began = time.perf_counter()
    assert "--instruction" in without_pyarrow("--help").stdout
    assert time.perf_counter() - began < 3


def test_missing_pyarrow_is_told():
    shown = without_pyarrow("data.hdf5", "out")
    assert shown.returncode == 2
    assert "pip install 'jaxcam[lerobot]'" in shown.stderr
    assert "Traceback" not in shown.stderr


def test_what_is_exported_is_read_back(folder, data):
    recording = read_lerobot(folder)
    assert recording.action_names == ("x", "y", "z", "rx", "ry", "rz", "gripper")
    assert len(recording.episodes) == data.train
    intrinsics = np.broadcast_to(data.K, (len(data.base_from_camera), 3, 3)).astype(np.float32)
    for e, episode in enumerate(recording.episodes):
        t = np.arange(data.lengths[e])
        np.testing.assert_array_equal(episode.state, data.proprio[e, t])
        np.testing.assert_array_equal(episode.action, data.actions[e, t])
        for v, camera in enumerate(data.windows[e]):
            sight = episode.sights[f"view_{v}"]
            pose = sight.calibration.base_from_camera
            np.testing.assert_array_equal(pose, data.base_from_camera[camera])
            np.testing.assert_array_equal(sight.calibration.K, intrinsics[camera])
            drawn = data.pictures.rgb[data.pictures.layout.at(np.array(e), t, np.array(v))]
            error = np.mean((np.stack(list(sight.decode())).astype(float) - drawn) ** 2)
            assert 10 * np.log10(255**2 / error) > 28


def test_its_cameras_are_read_from_its_columns(folder):
    """And what it notes in `meta/jaxcam.json` is no calibration."""
    recording = calibrated(read_lerobot(folder))
    require_calibrated(recording, "late")
    expected = [f"View {view}: the columns camera.{view}.*." for view in recording.views]
    assert sources(recording) == expected
    assert recording.fingerprint == read_lerobot(folder).fingerprint
