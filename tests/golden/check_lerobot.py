"""Read an exported dataset with LeRobot's own loader and hold it against what it was made from.

LeRobot brings PyTorch and other versions of most packages, so it lives in an environment of its
own and this check is run by hand; last with LeRobot 0.4.4 (Python 3.11) and 0.6.1 (Python 3.12)::

    python -m jaxcam.collect --demos 6 --validation 2
    python -m jaxcam.lerobot data/lift-randomized-n3m1-6+2-seed0.hdf5 out --resolution 96 \
        --action-space eef_abs
    python3.12 -m venv lerobot-env
    lerobot-env/bin/pip install 'lerobot[dataset]==0.6.1' h5py
    lerobot-env/bin/python tests/golden/check_lerobot.py out \
        data/lift-randomized-n3m1-6+2-seed0.hdf5 data/frames/lift-*-96px-*.npy

It needs the action space eef_abs, whose actions are the file's commands, with rotations counted
from another grip (`nominal_grip` of meta/jaxcam.json). Every row is compared, and of every episode
the pictures at its ends and in its middle; chunks of actions and a batch of a DataLoader are read
as training does. It prints what it found or stops.
"""

import argparse
import json
import pathlib
from importlib.metadata import version

import h5py
import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

BACKEND = "pyav"
"""LeRobot's decoder that needs no FFmpeg of the system's."""
LEAST_PSNR = 30.0
"""Likeness (dB) of a decoded picture to the rendered one; the video is lossy."""


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio (dB) of two pictures of 256 levels."""
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b.astype(float)) ** 2))


def turn(rotvec: np.ndarray) -> np.ndarray:
    """The matrix of a rotation vector, as a power series."""
    x, y, z = rotvec.astype(float)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    total, term = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ cross / k
        total = total + term
    return total


def check_rows(data: LeRobotDataset, file: h5py.File, pictures: np.ndarray, about: dict) -> float:
    """Compares rows and pictures of every training demonstration; the least likeness."""
    base_from_world = np.linalg.inv(np.array(about["world_from_base"]))
    row, at, worst = 0, 0, np.inf
    for e, name in enumerate(n.decode() for n in file["mask/train"][:]):
        demo = file[f"data/{name}"]
        length, cameras = int(demo.attrs["num_samples"]), demo.attrs["cameras"]
        states, actions = demo["states"][:], demo["actions"][:]
        for t in range(length):
            is_shown = t in (0, length // 2, length - 1)
            item = data[row + t] if is_shown else data.hf_dataset[row + t]
            assert (int(item["episode_index"]), int(item["frame_index"])) == (e, t)
            action = item["action"].numpy()
            np.testing.assert_allclose(action[[0, 1, 2, 6]], actions[t][[0, 1, 2, 6]], atol=1e-6)
            turned = turn(action[3:6]) @ np.array(about["nominal_grip"])
            np.testing.assert_allclose(turned, turn(actions[t][3:6]), atol=1e-5)
            np.testing.assert_allclose(item["observation.state"][:7], states[t, 1:8], atol=1e-6)
            for v, camera in enumerate(cameras):
                pose = base_from_world @ file["cameras/world_from_camera"][camera]
                stored = item[f"camera.view_{v}.base_from_camera"]
                np.testing.assert_allclose(stored, pose, atol=1e-6)
                K = item[f"camera.view_{v}.intrinsics"]
                np.testing.assert_allclose(K, np.array(about["intrinsics"]), rtol=1e-6)
                if is_shown:
                    image = item[f"observation.images.view_{v}"].permute(1, 2, 0).numpy() * 255
                    worst = min(worst, psnr(image, pictures[at + t * len(cameras) + v]))
                    assert item["task"] == "lift"
        row, at = row + length, at + length * len(cameras)
    assert row == len(data) == data.meta.total_frames
    return worst


def check_training(folder: str) -> None:
    """Reads chunks of actions in batches, as LeRobot's training does."""
    times = {"action": [t / 20 for t in range(4)]}
    data = LeRobotDataset("check", folder, delta_timestamps=times, video_backend=BACKEND)
    batch = next(iter(torch.utils.data.DataLoader(data, batch_size=8, shuffle=True)))
    assert batch["action"].shape[:2] == (8, 4)
    assert batch["action_is_pad"].shape == (8, 4)
    assert batch["camera.view_0.base_from_camera"].shape == (8, 4, 4)
    assert all(k in data.meta.stats for k in data.meta.features)


def main() -> None:
    """Check one export."""
    parser = argparse.ArgumentParser(description="Hold an export against its dataset.")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("pictures", type=pathlib.Path)
    args = parser.parse_args()
    about = json.loads((args.folder / "meta/jaxcam.json").read_text())
    assert about["action_space"] == "eef_abs", "export it with --action-space eef_abs"
    data = LeRobotDataset("check", root=args.folder, video_backend=BACKEND)
    pictures = np.load(args.pictures, mmap_mode="r")
    with h5py.File(args.dataset) as file:
        worst = check_rows(data, file, pictures, about)
    assert worst > LEAST_PSNR, f"a picture is only {worst:.1f} dB like the rendered one"
    check_training(str(args.folder))
    print(
        f"LeRobot {version('lerobot')}: {data.num_episodes} episodes, {len(data)} frames, "
        f"{len(data.meta.video_keys)} views; pictures at least {worst:.1f} dB alike."
    )


if __name__ == "__main__":
    main()
