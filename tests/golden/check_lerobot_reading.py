"""Hold our reading of LeRobot's datasets against LeRobot's own loader.

LeRobot lives in an environment of its own and this check is run by hand; last with LeRobot 0.4.4
(Python 3.11) and 0.6.1 (Python 3.12), both with PyAV 15, against PyAV 18::

    lerobot-env/bin/python tests/golden/check_lerobot_reading.py make OUT
    python tests/golden/check_lerobot_reading.py dump OUT
    lerobot-env/bin/python tests/golden/check_lerobot_reading.py compare OUT

LeRobot writes datasets of version 3.0 with two cameras and two tasks: H.264, HEVC and AV1 videos,
and images. Ours reads them and keeps what it found as arrays; of version 2.1, which LeRobot no
longer reads, `dump` writes a folder of the tests', and `compare` brings it on with LeRobot's own
script and reads that. Every row is compared, and every picture. Any folder of 3.0 can be put into
OUT as well. It prints what it found or stops.
"""

import argparse
import inspect
import json
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np

CODECS = {"h264": "h264", "hevc": "hevc", "av1": "libsvtav1", "images": ""}
LENGTHS, RATE = (23, 11, 34), 15
SIZES = {"observation.images.top": (96, 128), "observation.images.wrist": (72, 80)}
LEAST_PSNR = 40.0
"""Likeness (dB) of pictures that are not the same to the last bit."""
OLD = "old"


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio (dB) of pictures of 256 levels."""
    error = np.mean((a.astype(float) - b.astype(float)) ** 2)
    return 10 * np.log10(255**2 / error) if error else np.inf


def make(out: pathlib.Path) -> None:
    """Lets LeRobot write datasets."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    for name, codec in CODECS.items():
        kind = "video" if codec else "image"
        axes = ["height", "width", "channels"]
        features = {k: {"dtype": kind, "shape": (*s, 3), "names": axes} for k, s in SIZES.items()}
        motors = [f"joint_{i}" for i in range(5)]
        for key, size in (("observation.state", 5), ("action", 4)):
            features[key] = {"dtype": "float32", "shape": (size,), "names": motors[:size]}
        settings = {"use_videos": bool(codec)}
        if codec and "vcodec" in inspect.signature(LeRobotDataset.create).parameters:
            settings["vcodec"] = codec
        elif codec:
            from lerobot.configs.video import RGBEncoderConfig

            settings["rgb_encoder"] = RGBEncoderConfig(vcodec=codec)
        data = LeRobotDataset.create(name, RATE, features, root=out / name, **settings)
        rng = np.random.default_rng(0)
        for e, length in enumerate(LENGTHS):
            for t in range(length):
                row = {k: rng.normal(size=n).astype(np.float32) for k, n in
                       (("observation.state", 5), ("action", 4))}  # fmt: skip
                for key, (height, width) in SIZES.items():
                    y, x = np.mgrid[:height, :width]
                    shown = [x + 3 * t, y + 40 * e, (x + y) // 2 + t]
                    row[key] = np.stack(shown, -1).astype(np.uint8)
                data.add_frame(row | {"task": f"Task {e % 2}."})
            data.save_episode()
        data.finalize()


def dump(out: pathlib.Path) -> None:
    """Reads each folder with jaxcam."""
    sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "helpers"))
    from lerobot_folders import write_folder

    from jaxcam.interop.lerobot.reading import read_lerobot

    if not (out / OLD).exists():
        write_folder(out / OLD, "v2.1")
    for folder in sorted(p for p in out.iterdir() if (p / "meta/info.json").is_file()):
        recording = read_lerobot(folder)
        arrays = {"views": recording.views, "tasks": [e.instruction for e in recording.episodes]}
        for e, episode in enumerate(recording.episodes):
            arrays |= {f"{e}/state": episode.state, f"{e}/action": episode.action}
            for view, sight in episode.sights.items():
                arrays[f"{e}/{view}"] = np.stack(list(sight.decode()))
        np.savez(out / f"{folder.name}.npz", **arrays)
        print(f"{folder.name}: {len(recording.episodes)} episodes, {recording.state_names}")


def migrated(folder: pathlib.Path) -> pathlib.Path:
    """A copy of a folder of version 2.1 that LeRobot has brought on to 3.0."""
    from importlib.util import find_spec

    import pyarrow.parquet as parquet

    new = folder.parent / "migrated" / folder.name
    shutil.rmtree(new, ignore_errors=True)
    shutil.copytree(folder, new)
    features = json.loads((new / "meta/info.json").read_text())["features"]
    lines = []
    for e, path in enumerate(sorted(new.glob("data/*/*.parquet"))):  # its script needs statistics
        table, stats = parquet.read_table(path), {}
        for key, feature in features.items():
            values = np.zeros((1, 3, 1, 1))
            if feature["dtype"] != "video":
                values = np.array(table.column(key).to_pylist(), float).reshape(len(table), -1)
            stats[key] = {n: getattr(values, n)(0).tolist() for n in ("min", "max", "mean", "std")}
            stats[key]["count"] = [len(values)]
        lines.append(json.dumps({"episode_index": e, "stats": stats}))
    (new / "meta/episodes_stats.jsonl").write_text("\n".join(lines) + "\n")
    old = find_spec("lerobot.datasets.v30") is not None  # LeRobot 0.4 adds the name to the root
    place = "lerobot.datasets.v30" if old else "lerobot.scripts"
    command = [sys.executable, "-m", f"{place}.convert_dataset_v21_to_v30", "--push-to-hub=false"]
    command += ["--repo-id", new.name, "--root", str(new.parent if old else new)]
    subprocess.run(command, check=True, env=os.environ | {"HF_HUB_OFFLINE": "1"})
    return new


def compare(out: pathlib.Path) -> None:
    """Reads each folder with LeRobot, and holds it against what jaxcam found."""
    from importlib.metadata import version

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    for file in sorted(out.glob("*.npz")):
        ours, folder = np.load(file), out / file.stem
        if json.loads((folder / "meta/info.json").read_text())["codebase_version"] == "v2.1":
            folder = migrated(folder)
        data = LeRobotDataset(file.stem, root=folder, video_backend="pyav")
        keys = data.meta.camera_keys
        views = [key.removeprefix("observation.images.") for key in keys]
        assert sorted(views) == sorted(ours["views"].tolist()), views
        worst, same, count = np.inf, 0, 0
        for row in range(len(data)):
            item = data[row]
            e, t = int(item["episode_index"]), int(item["frame_index"])
            np.testing.assert_array_equal(item["observation.state"], ours[f"{e}/state"][t])
            np.testing.assert_array_equal(item["action"], ours[f"{e}/action"][t])
            assert item["task"] == ours["tasks"][e]
            for key, view in zip(keys, views, strict=True):
                theirs = np.rint(item[key].permute(1, 2, 0).numpy() * 255)
                found = ours[f"{e}/{view}"][t]
                assert theirs.shape == found.shape
                worst, count = min(worst, psnr(theirs, found)), count + 1
                same += bool((theirs == found).all())
        assert sum(len(ours[f"{e}/action"]) for e in range(len(ours["tasks"]))) == len(data)
        assert worst >= LEAST_PSNR, f"{file.stem}: a picture is only {worst:.1f} dB alike"
        print(
            f"LeRobot {version('lerobot')}, {file.stem}: {len(data)} rows are equal; of {count} "
            f"pictures {same} are the same to the last bit, and all at least {worst:.1f} dB alike."
        )


def main() -> None:
    """Run one of the three parts."""
    parser = argparse.ArgumentParser(description="Hold our reading against LeRobot's.")
    parser.add_argument("part", choices=("make", "dump", "compare"))
    parser.add_argument("out", type=pathlib.Path)
    args = parser.parse_args()
    {"make": make, "dump": dump, "compare": compare}[args.part](args.out)


if __name__ == "__main__":
    main()
