"""What a path leads to, as episodes that can be looked at: a dataset, a run, a file of cameras."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from jaxcam.config.commands import ViewConfig
from jaxcam.data.demos import Demos, read_demos
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import absolute
from jaxcam.interop.formats import read, recognise
from jaxcam.interop.recordings import is_recording, read_recording
from jaxcam.runs.foreign import has_foreign
from jaxcam.viewer.exhibit import Exhibit, overlaid
from jaxcam.viewer.recorded import calibrated_cameras, episode
from jaxcam.viewer.rollouts import Rolled
from jaxcam.viewer.simulated import demonstration


@dataclass(frozen=True)
class Viewed:
    """Episodes that can be looked at.

    Attributes:
        name: What they are of.
        episodes: Each in words, by its number.
        exhibit: Makes what is to be seen of one.
        still: Whether there is no time in it, so that it goes with any episode of something else.
    """

    name: str
    episodes: Mapping[int, str]
    exhibit: Callable[[int], Exhibit]
    still: bool = False


def open_viewed(config: ViewConfig, console: Console | None = None) -> Viewed:
    """The episodes of what the settings name; of two things, those that both have.

    Args:
        config: The settings.
        console: For progress; silent when None.

    Raises:
        ConfigError: A path leads to nothing that can be looked at, or settings do not go with it.
        DatasetError: It is missing, damaged or empty, or two things share no episode.
        CameraError: A calibration is impossible.
    """
    opened = [_open(absolute(target), config, console) for target in config.target]
    if len(opened) == 1:
        return opened[0]
    first, second = opened
    names = _told_apart(first.name, second.name)
    if first.still:
        both = second.episodes
    elif second.still:
        both = first.episodes
    else:
        both = {n: text for n, text in first.episodes.items() if n in second.episodes}
    if not both:
        raise DatasetError(
            f"{names[0]} and {names[1]} have no episode of one number: "
            f"{sorted(first.episodes)[:5]}… and {sorted(second.episodes)[:5]}…"
        )

    def exhibit(number: int) -> Exhibit:
        parts = [one.exhibit(0 if one.still else number) for one in opened]
        return overlaid(parts[0], parts[1], names)

    return Viewed(f"{names[0]} and {names[1]}", both, exhibit)


def _told_apart(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first != second else (f"{first} (first)", f"{second} (second)")


def _open(path: Path, config: ViewConfig, console: Console | None) -> Viewed:
    if not os.path.lexists(path):
        raise DatasetError(f"{path}: there is no dataset, no run and no file of cameras.")
    if path.is_dir():
        return _open_folder(path, config, console)
    if path.suffix.lower() == ".json":
        cameras = calibrated_cameras(path)
        return Viewed(path.name, {0: "all cameras"}, lambda _: cameras, still=True)
    if recognise(path) not in ("robomimic", "maniskill"):
        return _of_demos(read_demos(path))
    with TemporaryDirectory() as folder:  # an import is read whole, and is not kept
        return _of_demos(read(path, Path(folder) / f"{path.stem}.hdf5", console))


def _of_demos(demos: Demos) -> Viewed:
    train = len(demos.train)
    episodes = {
        i: f"{'training' if i < train else 'validation'}, {demo.length} steps"
        for i, demo in enumerate(demos.episodes)
    }
    return Viewed(demos.path.stem, episodes, lambda number: demonstration(demos, number))


def _open_folder(path: Path, config: ViewConfig, console: Console | None) -> Viewed:
    if (path / "config.json").is_file() or has_foreign(path):
        rolled = Rolled.open(path, config.split, config.step)
        return Viewed(path.name, rolled.pairs(), rolled.exhibit)
    if not is_recording(path):
        raise ConfigError(
            f"{path}: not a run folder, since it has no config.json, and no recorded dataset: it "
            "has neither meta/info.json (LeRobot) nor trajectory.h5 (DROID). Datasets of "
            "demonstrations that were simulated are files."
        )
    cameras = absolute(config.cameras) if config.cameras else None
    recording = read_recording(path, cameras, console)
    if not recording.episodes:
        raise DatasetError(f"{path}: it has no episodes, so there is nothing to show.")
    episodes = {i: f"{one.name}, {one.length} steps" for i, one in enumerate(recording.episodes)}
    return Viewed(path.name, episodes, lambda number: episode(recording, number, config.grip))
