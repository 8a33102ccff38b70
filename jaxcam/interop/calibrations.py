"""Calibrations of recorded cameras, from wherever there is one.

Of each view, K with the lens, and the pose, are each taken from the first of these that has it:
columns `camera.<view>.*` of the dataset, which its reader has taken already; `meta/jaxcam.json` in
its folder; the file of `--cameras`; and what its format says by itself (DROID's six numbers).
"""

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.names import ActionFrame, Conditioning
from jaxcam.data.recorded.recording import Calibration, Episode, Placement, Recording, Sight
from jaxcam.errors import CameraError, ConfigError, DatasetError, closest
from jaxcam.files.paths import home
from jaxcam.interop.cameras.files import CamerasFile, Entry, read_cameras, read_notes
from jaxcam.interop.cameras.grips import (
    GripEntries,
    grip_numbers,
    poses_between,
    poses_of_grip,
)
from jaxcam.rays import Camera
from jaxcam.rays.lens import PACKED

NOTES = "meta/jaxcam.json"
"""A dataset's own file of calibrations, in its folder."""
PAGE = "docs/calibrated-datasets.md"


def calibrated(
    recording: Recording, cameras: str | Path | None = None, console: Console | None = None
) -> Recording:
    """A recording whose cameras are calibrated as far as anybody says.

    Args:
        recording: As its reader gives it.
        cameras: A file of calibrations, as `docs/calibrated-datasets.md` describes it.
        console: Where to tell each view's source; silent when None.

    Returns:
        The recording with calibrations, each checked, and with a fingerprint that covers them.
        Where half of one is missing, the other half is the camera's `placement`, so that
        `require_calibrated` can say what is.

    Raises:
        ConfigError: A file of calibrations has a name or a value that is none.
        CameraError: A camera is impossible, its K is for pictures of another shape, or the number
            of its poses is not that of the pictures.
        DatasetError: A file cannot be read.
    """
    notes = read_notes(recording.path / NOTES) if recording.path.is_dir() else None
    files = [notes] if notes else []
    if cameras is not None:
        files.append(read_cameras(home(cameras)))
    for file in files:
        _check_names(file, recording)
    episodes = [
        replace(
            episode,
            sights={
                view: _calibrated(sight, episode, number, view, files, recording)
                for view, sight in episode.sights.items()
            },
        )
        for number, episode in enumerate(recording.episodes)
    ]
    result = replace(recording, episodes=episodes)
    if _cameras_of(result) != _cameras_of(recording):
        seal = f"{recording.fingerprint} {_cameras_of(result)}"
        result = replace(result, fingerprint=hashlib.sha256(seal.encode()).hexdigest()[:16])
    if console:
        for line in sources(result):
            console.print(line, highlight=False, soft_wrap=True)
        if cameras is not None:
            for line in _unused(files[-1], result):
                console.print(line, highlight=False, soft_wrap=True)
    return result


def sources(recording: Recording) -> list[str]:
    """Where each view's calibration is from, a line each."""
    lines = []
    for view in recording.views:
        cameras = [e.sights[view] for e in recording.episodes if view in e.sights]
        counts = Counter(
            s.calibration.source or "its columns" if s.calibration else f"nobody says {_lacks(s)}"
            for s in cameras
        )
        words = [
            source + (f" ({count} episodes)" if len(counts) > 1 else "")
            for source, count in counts.items()
        ]
        lines.append(f"View {view}: {'; '.join(words) or 'in no episode'}.")
    return lines


def pose_before(recording: Recording, view: str, path: Path) -> str:
    """Who says a view's pose before a file of calibrations is asked; empty where nobody does.

    Args:
        recording: As `calibrated` leaves it, with the file or without.
        view: The camera's name.
        path: Of the file.
    """
    sights = [e.sights[view] for e in recording.episodes if view in e.sights]
    if any(s.calibration is not None and not s.calibration.source for s in sights):
        return f"the dataset's columns camera.{view}.*"
    own = recording.path / NOTES
    notes = read_notes(own) if own.is_file() else None
    if notes is None or (path.exists() and own.samefile(path)):
        return ""
    entries = [of.get(view) for of in (notes.views, *notes.episodes.values())]
    return str(own) if any(entry and entry.pose for entry in entries) else ""


def require_calibrated(
    recording: Recording, conditioning: Conditioning, action_frame: ActionFrame = "base"
) -> None:
    """Refuses a recording whose cameras a policy would not be told.

    Args:
        recording: After `calibrated`.
        conditioning: How the policy is told where its cameras are.
        action_frame: What it predicts actions in.

    Raises:
        DatasetError: Naming the views without a calibration, what is missing, and the shortest way
            to get one.
    """
    needs = "--action-frame camera" if action_frame == "camera" else ""
    if conditioning != "none":
        needs = f"--conditioning {conditioning}"
    if not needs:
        return
    missing = []
    for view in recording.views:
        episodes = [e for e in recording.episodes if view in e.sights]
        without = [e for e in episodes if e.sights[view].calibration is None]
        if without:
            sight = without[0].sights[view]
            words = f"{view} (in {len(without)} of {len(episodes)} episodes): {_lacks(sight)}"
            missing.append((words, _entries(view, sight)))
    if missing:
        raise DatasetError(
            f"{recording.path}: cameras without a calibration, which {needs} "
            f"needs: {'; '.join(words for words, _ in missing)}. The shortest way: measure them, "
            f"write cameras.json, and give --cameras cameras.json, for example {missing[0][1]} "
            f"({PAGE} has the conventions). Or train without: --conditioning none"
            f"{' --action-frame base' if action_frame == 'camera' else ''}."
        )


def _lacks(sight: Sight) -> str:
    """What nobody says of a camera, and who says the rest."""
    known = sight.placement
    if known and known.K is not None and known.base_from_camera is None:
        return f"its pose (K: {known.K_source})"
    if known and known.base_from_camera is not None:
        return f"K (its pose: {known.source})"
    return "K and its pose"


def _entries(view: str, sight: Sight) -> str:
    """The entries of a `cameras.json` with what nobody says of a camera."""
    size = f'"size": [{sight.width}, {sight.height}]'
    K = f'"K": {{"fx": …, "fy": …, "cx": …, "cy": …}}, {size}'
    pose = '"base_from_camera": {"position": [x, y, z], "quaternion_wxyz": [w, x, y, z]}'
    known = sight.placement
    entries = [
        text
        for text, value in ((K, known and known.K), (pose, known and known.base_from_camera))
        if value is None
    ]
    return f'{{"format": 1, "views": {{"{view}": {{{", ".join(entries)}}}}}}}'


def _calibrated(
    sight: Sight,
    episode: Episode,
    number: int,
    view: str,
    files: Sequence[CamerasFile],
    recording: Recording,
) -> Sight:
    """What a camera saw of an episode, with its calibration if anybody says one."""
    where = f"episode '{episode.name}', view '{view}'"
    result = sight.calibration
    if result is None:
        names = episode.name, str(number)
        entries = [(str(file.path), file.of(names, view)) for file in files]
        optics, pose = (
            _optics(sight, entries, where),
            _pose(sight, entries, names, (recording, episode)),
        )
        K, distortion, K_source = optics or (None, None, "")
        base_from_camera, source = pose or (None, "")
        if K is None or distortion is None or base_from_camera is None:
            half = Placement(base_from_camera, source, K, K_source, distortion)
            return replace(sight, placement=half if optics or pose else None)
        words = source if source == K_source else f"K: {K_source}; pose: {source}"
        result = Calibration(K, base_from_camera, distortion, words)
    _check(result, sight, episode.length, f"{where}, from {result.source or 'its columns'}")
    return replace(sight, calibration=result)


def _optics(
    sight: Sight, entries: list[tuple[str, Entry]], where: str
) -> tuple[np.ndarray, np.ndarray, str] | None:
    """K for the recorded pictures, the lens, and who says so first."""
    for path, entry in entries:
        if entry.optics:
            K = entry.optics.at(sight.height, sight.width, f"{path}: {where}")
            return K, entry.optics.distortion, path
    own = sight.placement
    if own and own.K is not None:
        distortion = np.zeros(PACKED) if own.distortion is None else own.distortion
        return own.K, distortion, own.K_source
    return None


def _pose(
    sight: Sight,
    entries: list[tuple[str, Entry]],
    names: tuple[str, ...],
    of: tuple[Recording, Episode],
) -> tuple[np.ndarray, str] | None:
    """Base from camera, and who says so first."""
    for path, entry in entries:
        if entry.pose and (pose := entry.pose.of(names, partial(_hand, *of))) is not None:
            return pose, path
    if sight.placement and sight.placement.base_from_camera is not None:
        return sight.placement.base_from_camera, sight.placement.source
    return None


def _hand(recording: Recording, episode: Episode, grip: GripEntries, where: str) -> np.ndarray:
    """The grip's poses at the moments of an episode's pictures, [T, 4, 4]."""
    columns = grip_numbers(recording.state_names, grip, f"{where}, grip")
    poses = poses_of_grip(episode.state, columns, f"{where}, episode '{episode.name}'")
    steps = np.arange(episode.length) + grip.delay_ms / 1000 * recording.rate
    return poses_between(poses, steps)


def _check(calibration: Calibration, sight: Sight, length: int, where: str) -> None:
    """Refuses a camera that cannot be, or poses for another number of pictures."""
    for what, array in (("K", calibration.K), ("poses", calibration.base_from_camera)):
        if array.ndim > 2 and len(array) != length:
            raise CameraError(
                f"{where}: {what} picture by picture: expected {length}, as there are pictures, "
                f"got {len(array)}."
            )
    Camera(
        calibration.K,
        calibration.base_from_camera,
        sight.height,
        sight.width,
        calibration.distortion,
    ).validate(where)


def _check_names(file: CamerasFile, recording: Recording) -> None:
    """Refuses names of views and episodes that a recording does not have."""
    for view in [*file.views, *(view for views in file.episodes.values() for view in views)]:
        if view not in recording.views:
            raise ConfigError(
                f"{file.path}: unknown view {view!r:.80}{closest(view, recording.views)}."
            )
    numbers = {str(number): e.name for number, e in enumerate(recording.episodes)}
    names = set(numbers.values())
    for number, name in numbers.items():
        if number != name and {number, name} <= file.episodes.keys():
            raise ConfigError(f"{file.path}: episodes '{number}' and '{name}' are one.")
    for episode in file.episodes:
        if episode not in numbers and episode not in names:
            raise ConfigError(
                f"{file.path}: unknown episode {episode!r:.80}. Known: 0 to {len(numbers) - 1}, "
                f"and their names, such as {min(names)!r:.80}."
            )


def _unused(file: CamerasFile, recording: Recording) -> list[str]:
    """Views of a file that was given, for which others come first."""
    lines = []
    for view in recording.views:
        cameras = [e.sights[view].calibration for e in recording.episodes if view in e.sights]
        used = {c.source for c in cameras if c}
        if view in file.views and used and not any(str(file.path) in source for source in used):
            first = "; ".join(sorted(used)) or "its columns"
            lines.append(f"{file.path} is not used for view {view}: {first} comes first.")
    return lines


def _cameras_of(recording: Recording) -> str:
    """Hash of all calibrations."""
    seal = hashlib.sha256()
    for number, episode in enumerate(recording.episodes):
        for view, sight in sorted(episode.sights.items()):
            if (camera := sight.calibration) is not None:
                seal.update(f"{number} {view!r} ".encode())
                for array in (camera.K, camera.base_from_camera, camera.distortion):
                    seal.update(f"{array.shape} ".encode())
                    seal.update(np.ascontiguousarray(array, np.float64).tobytes())
    return seal.hexdigest()
