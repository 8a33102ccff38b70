"""Rollout videos of runs, side by side, as a small GIF, for pages that play no videos.

python benchmarks/rollout_gif.py rollouts.gif RUN/videos/test-004000.mp4

python benchmarks/rollout_gif.py docs/pose.gif NONE/videos/test-004000.mp4 \
    TOLD/videos/test-004000.mp4 --titles "pose not given" "pose given" --rows 2 --scale 0.36

Videos of two runs show the same held-out pairs in the same places.
"""

import argparse

import av
import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

GRID = 4
"""Rows of rollouts in a run's video."""
GAP, BAR = 8, 22
"""Pixels between videos, and of the bar with their titles."""


def pictures_of(video: str, scale: float, rows: int) -> list[np.ndarray]:
    """A video's pictures, smaller, of its first rows of rollouts."""
    with av.open(video) as container:
        pictures = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    height, width = pictures[0].shape[:2]
    cut = height * rows // GRID
    size = (int(scale * width), int(scale * cut))
    return [cv2.resize(p[:cut], size, interpolation=cv2.INTER_AREA) for p in pictures]


def beside(pictures: list[np.ndarray], titles: list[str]) -> np.ndarray:
    """Pictures of one time side by side, below their titles if there are some."""
    height = pictures[0].shape[0]
    gap = np.full((height, GAP, 3), 255, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)][1:]
    row = np.concatenate(parts, 1)
    if not titles:
        return row
    bar = Image.new("RGB", (row.shape[1], BAR), "white")
    draw, font, left = ImageDraw.Draw(bar), ImageFont.load_default(15), 0
    for picture, title in zip(pictures, titles, strict=True):
        draw.text((left + picture.shape[1] / 2, BAR / 2), title, "black", font, anchor="mm")
        left += picture.shape[1] + GAP
    return np.concatenate([np.asarray(bar), row])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("gif")
    parser.add_argument("videos", nargs="+")
    parser.add_argument("--titles", nargs="+", default=[])
    parser.add_argument("--rows", type=int, default=GRID)
    parser.add_argument("--scale", type=float, default=0.42)
    parser.add_argument("--frames", type=int, default=56)
    args = parser.parse_args()

    films = [pictures_of(video, args.scale, args.rows) for video in args.videos]
    count = min(args.frames, max(map(len, films)))
    small = [beside([film[min(t, len(film) - 1)] for film in films], args.titles)
             for t in range(count)]  # fmt: skip
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
