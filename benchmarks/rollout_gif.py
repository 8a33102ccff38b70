"""A run's rollout video as a small GIF, for pages that play no videos.

python benchmarks/rollout_gif.py RUN/videos/test-004000.mp4 docs/rollouts.gif
"""

import argparse

import av
import cv2
import numpy as np
from PIL import Image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video")
    parser.add_argument("gif")
    parser.add_argument("--scale", type=float, default=0.42)
    parser.add_argument("--frames", type=int, default=56)
    args = parser.parse_args()

    with av.open(args.video) as container:
        pictures = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)][: args.frames]
    size = [int(args.scale * n) for n in reversed(pictures[0].shape[:2])]
    small = [cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in pictures]
    # One palette for all pictures; an octree keeps small objects' colours, a median cut loses them.
    plain = {"dither": Image.Dither.NONE}
    several = Image.fromarray(np.concatenate(small[::8]))
    palette = several.quantize(128, method=Image.Quantize.FASTOCTREE, **plain)
    first, *rest = (Image.fromarray(p).quantize(palette=palette, **plain) for p in small)
    duration = [100] * len(rest) + [2000]
    first.save(
        args.gif, save_all=True, append_images=rest, duration=duration, loop=0, optimize=True
    )


if __name__ == "__main__":
    main()
