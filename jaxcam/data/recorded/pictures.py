"""The pictures of a recorded dataset: decoded once, brought to a size, and kept in a cache.

The cache is that of rendered pictures (`jaxcam.data.caches`): an interrupted decoding goes on, and
what a run will look at is held against its checksums first. Its name is that of the pictures, so
that neither a new calibration nor another name of the folder makes anybody decode them again.
"""

from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.sizes import size_name
from jaxcam.console.progress import progress
from jaxcam.data.caches import Cache
from jaxcam.data.pictures import Pictures
from jaxcam.data.recorded.parts import Parts, fits_of
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import DatasetError
from jaxcam.files.locks import exclusive

AT_ONCE = 128
"""Pictures that are kept together while an episode is decoded."""


def load_recorded_pictures(
    recording: Recording,
    parts: Parts,
    size: tuple[int, int],
    folder: Path,
    console: Console | None = None,
    wanted: np.ndarray | None = None,
) -> Pictures:
    """Decodes what is missing of a recorded dataset's pictures and opens them.

    Args:
        recording: The dataset.
        parts: Its demonstrations.
        size: Rows and columns of the pictures.
        folder: Where caches are, which need not be beside the dataset.
        console: For progress; silent when None.
        wanted: Those that will be looked at, bool [pictures]; the others may stay empty. All when
            None.

    Raises:
        DatasetError: A picture cannot be decoded, the disk has no room, or a cache is damaged.
    """
    layout = parts.layout(recording)
    wanted = np.ones(layout.total, bool) if wanted is None else wanted
    which = f"{recording.pictures_fingerprint}-{parts.digest}-{size_name(*size)}px.npy"
    path, shape = folder / "frames" / f"recorded-{which}", (layout.total, *size, 3)
    cache = Cache(path, shape)
    if not (cache.complete and not cache.damaged(wanted).any()):
        with exclusive(path, console):
            cache = Cache(path, shape)
            _decode(cache, recording, parts, size, wanted, console)
    assert cache.rgb is not None
    return Pictures(cache.rgb, layout, cache.drawn)


def _decode(
    cache: Cache,
    recording: Recording,
    parts: Parts,
    size: tuple[int, int],
    wanted: np.ndarray,
    console: Console | None,
) -> None:
    """Decodes the episodes of which a wanted picture is missing or damaged, view by view."""
    layout, fits = parts.layout(recording), fits_of(recording, parts, size)
    missing = cache.begin(cache.damaged(wanted), wanted)
    demos, _, cameras = layout.where(missing)
    films = sorted(set(zip(demos.tolist(), cameras.tolist(), strict=True)))
    total = sum(int(layout.lengths[demo]) for demo, _ in films)
    with progress(console, "decoding", total, job="decoding") as advance:
        for demo, camera in films:
            part = parts.all[demo]
            view = part.views[camera]
            episode = recording.episodes[part.episode]
            rows = layout.at(np.array(demo), np.arange(episode.length), np.array(camera))
            fitted, done, batch = fits[part.episode, view], 0, []
            for picture in episode.sights[view].decode():
                batch.append(fitted.picture(picture))
                if len(batch) == AT_ONCE or done + len(batch) == episode.length:
                    cache.write(rows[done : done + len(batch)], np.stack(batch))
                    advance(len(batch))
                    done, batch = done + len(batch), []
            if done != episode.length or batch:
                raise DatasetError(
                    f"{recording.path}: episode '{episode.name}' has {episode.length} steps, but "
                    f"view {view} has {done + len(batch)} pictures."
                )
    cache.finish()
