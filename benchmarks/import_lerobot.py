"""Seconds to read a LeRobot dataset and decode all of it, against PyAV alone on the same files.

    python benchmarks/import_lerobot.py [--episodes 200] [--views 2] [--length 150]
        [--height 480] [--width 640] [--rounds 3] [--folder FOLDER] [--json]

Both decode every picture of every file to RGB, in turn, round by round; the medians of the ratios
within a round count. PyAV is measured as it comes and with the threads that jaxcam asks it for. By
how much jaxcam's memory grows after its first episodes is printed too. The dataset (H.264, several
episodes a file) is made first, which takes longer than all the rest; with --folder it is kept, and
found there the next time. `--episodes 6` runs in a minute.
"""

import argparse
import json
import os
import resource
import tempfile
import time
from pathlib import Path

import av
import cv2
import numpy as np

from jaxcam.interop.lerobot.format import Writer, feature
from jaxcam.interop.lerobot.reading import read_lerobot

RATE = 20


def make(folder: Path, args: argparse.Namespace) -> None:
    """Writes a dataset of a texture that moves, with noise as cameras have it."""
    names = [f"observation.images.view_{v}" for v in range(args.views)]
    features = {
        "observation.state": feature("float32", (8,)),
        "action": feature("float32", (7,)),
    }
    shape = (args.height, args.width, 3)
    axes = ["height", "width", "channels"]
    features |= {name: feature("video", shape, axes) for name in names}
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (16, 16, 3), np.uint8)
    texture = cv2.resize(coarse, (2 * args.width, args.height), interpolation=cv2.INTER_CUBIC)
    noise = rng.integers(0, 8, (8, *shape), np.uint8)
    with Writer(folder, features, RATE, "Measure.") as writer:
        for _ in range(args.episodes):
            rows = {
                "observation.state": rng.normal(size=(args.length, 8)).astype(np.float32),
                "action": rng.normal(size=(args.length, 7)).astype(np.float32),
            }
            videos = {}
            for name in names:
                shifts = (rng.integers(args.width) + 2 * np.arange(args.length)) % args.width
                videos[name] = np.stack(
                    [texture[:, s : s + args.width] // 2 + noise[s % 8] for s in shifts]
                )
            writer.add(rows, videos)
        writer.finish("none")


def read_all(folder: Path) -> tuple[int, float]:
    """Reads a dataset and decodes it, as the first training does; pictures, and MiB it grew by."""
    count, before = 0, 0
    for e, episode in enumerate(read_lerobot(folder).episodes):
        for sight in episode.sights.values():
            count += sum(1 for _ in sight.decode())
        if e == 1:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return count, (after - before) / 1024 if before else 0.0


def decode_all(folder: Path, threads: str | None) -> int:
    """Decodes all videos of a folder with PyAV alone; the pictures there were."""
    count = 0
    for file in sorted(folder.glob("videos/*/*/*.mp4")):
        with av.open(str(file)) as container:
            stream = container.streams.video[0]
            if threads:
                stream.thread_type = threads
            count += sum(1 for f in container.decode(stream) if len(f.to_ndarray(format="rgb24")))
    return count


def measure(folder: Path, args: argparse.Namespace) -> None:
    """Times all in turn and prints the table and, if asked, the JSON."""
    wanted = args.episodes * args.views * args.length
    growth = []

    def ours() -> int:
        count, grown = read_all(folder)
        growth.append(grown)
        return count

    programs = {
        "jaxcam": ours,
        "PyAV": lambda: decode_all(folder, None),
        "PyAV, its threads": lambda: decode_all(folder, "AUTO"),
    }
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(args.rounds):
        for name, run in programs.items():
            began = time.perf_counter()
            count = run()
            seconds[name].append(time.perf_counter() - began)
            if count != wanted:
                raise SystemExit(f"{name} decoded {count} pictures, not {wanted}")
    one = np.array(seconds["jaxcam"])
    ratios = {name: float(np.median(one / np.array(s))) for name, s in seconds.items()}
    size = f"{args.width} x {args.height}, load {os.getloadavg()[0]:.1f}"
    print(f"{args.episodes} episodes x {args.views} views x {args.length} pictures of {size}:")
    for name, values in seconds.items():
        print(f"  {name:20} {np.median(values):8.1f} s   jaxcam takes {ratios[name]:.2f} times it")
    print(f"  jaxcam's memory grew by {growth[0]:.0f} MiB after the first two episodes")
    if args.json:
        figures = {"seconds": seconds, "ratios": ratios, "grown_mib": growth[0]}
        print(json.dumps({"what": "import of a LeRobot dataset", **figures}))


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of the import of LeRobot datasets.")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--length", type=int, default=150, help="pictures an episode and view")
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where the dataset is made and kept")
    parser.add_argument("--json", action="store_true", help="print one JSON object as well")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.folder or Path(scratch) / "dataset"
        if not folder.exists():
            make(folder, args)
        measure(folder, args)


if __name__ == "__main__":
    main()
