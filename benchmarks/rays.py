"""Time of `jaxcam.rays.plucker` against a plain fill of the same output array, and of lenses.

    python benchmarks/rays.py [--maps 64] [--size 256] [--repeats 30]

A fill is what it costs to write the numbers and nothing else, so the ratio says how much the
arithmetic and the checks add. All are measured in turn; medians are printed, and of ratios the
median over rounds.
"""

import argparse
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.rays import POSE_RANGES, Camera, plucker, sample_poses

FIVE = [-0.3, 0.1, 1e-3, -5e-4, -0.02]
FISHEYE = [-0.03, 0.01, 1e-3, -5e-4]


def seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description="Time of plucker against a fill.")
    parser.add_argument("--maps", type=int, default=64)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=30)
    args = parser.parse_args()

    poses = sample_poses(POSE_RANGES["robosuite"], args.maps, seed=0)
    camera = Camera.from_fovy(np.full(args.maps, np.pi / 4), args.size, args.size, poses)
    K, size = camera.K, (args.size, args.size)
    fill = jax.jit(lambda value: jnp.full((args.maps, *size, 6), value, jnp.float32))
    programs: dict[str, Callable[[], object]] = {
        "fill": lambda: fill(1.0),
        "plucker": lambda: plucker(K, poses, *size),
        "five": lambda: plucker(K, poses, *size, distortion=FIVE),
        "fisheye": lambda: plucker(K, poses, *size, distortion=FISHEYE, lens="fisheye"),
        "checks alone": lambda: camera.validate(),
    }
    for run in programs.values():
        seconds(run)
    times = {name: [] for name in programs}
    for _ in range(args.repeats):
        for name, run in programs.items():
            times[name].append(seconds(run))

    device = jax.devices()[0].device_kind
    print(f"{args.maps} ray-maps of {args.size} x {args.size} on {device}, medians:")
    for name, values in times.items():
        print(f"  {name:13} {1e3 * np.median(values):8.2f} ms")
    for one, other in (("plucker", "fill"), ("five", "plucker"), ("fisheye", "plucker")):
        ratio = np.median(np.array(times[one]) / np.array(times[other]))
        print(f"  {one} / {other} {ratio:.2f}")


if __name__ == "__main__":
    main()
