"""A recorded dataset as the arrays that batches are cut from.

One demonstration of a `Dataset` is an episode as some of its views saw it, a `Part`. Training sees
some episodes through the views for training; the others are for validation, and so are held-out
views, which training never sees. So validation tells new episodes from new cameras.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from jaxcam.config.sizes import size_name
from jaxcam.data.batches import Dataset, keyframe_errors
from jaxcam.data.pictures import Pictures
from jaxcam.data.recorded.fitting import Fit, fit
from jaxcam.data.recorded.recording import Calibration, Episode, Recording
from jaxcam.data.samples import Layout, Samples, errors_of
from jaxcam.errors import ConfigError, closest

Group = Literal["training", "new episodes", "new cameras"]
LARGEST_SHARE = 5
"""At most one episode of so many is held out where nobody says how many."""
_GRIP = re.compile(
    r"^(?:.*[._ ])?(?:grip|gripper|eef|ee|tcp|hand|end_effector)[._ ]?(?:pos(?:ition)?)?[._ ]?"
    r"([xyz])$"
)
"""Names of the numbers that say where the grip is."""
_PLACE = re.compile(
    r".*(?:[._ ](?:pos(?:ition)?[._ ]?)?[xyz]|[._ ]r[xyz]|[._ ]q[wxyz]|roll|pitch|yaw)$"
)
"""Names of numbers that are a position's or a rotation's."""


@dataclass(frozen=True)
class Part:
    """An episode as some of its views saw it."""

    episode: int
    views: tuple[str, ...]
    group: Group


@dataclass(frozen=True)
class HeldOut:
    """What training does not see.

    Attributes:
        views: Names of cameras.
        episodes: Numbers of episodes; those that the dataset holds out, or `count`, when empty.
        count: Episodes that are held out where neither says which, evenly spaced.
    """

    views: tuple[str, ...] = ()
    episodes: tuple[int, ...] = ()
    count: int = 10


@dataclass(frozen=True)
class Meaning:
    """What is known of the numbers of a recorded dataset.

    Attributes:
        grip: Columns of the state that are the grip's position (x, y, z; base frame, m).
        gripper: Column of the action that opens and closes the gripper.
    """

    grip: tuple[int, int, int] | None = None
    gripper: int | None = None


def meaning_of(recording: Recording, grip: str = "") -> Meaning:
    """What is known of the numbers of a dataset, by their names and by what a setting says.

    Args:
        recording: The dataset.
        grip: Where its state has the grip's position, such as "observation.state[0:3]"; by names
            when empty.

    Raises:
        ConfigError: The setting names no three columns of the state.
    """
    columns = _grip_asked(grip, recording) if grip else grip_named(recording.state_names)
    grippers = [i for i, name in enumerate(recording.action_names) if opens_gripper(name)]
    return Meaning(columns, grippers[-1] if grippers else None)


def opens_gripper(name: str) -> bool:
    """Whether a number of that name is the gripper's opening, and not where the grip is."""
    return "grip" in name.lower() and not _PLACE.match(name.lower())


def grip_named(names: Sequence[str]) -> tuple[int, int, int] | None:
    """Columns of a state whose names say that they are the grip's x, y and z."""
    axes = {m[1]: i for i, n in enumerate(names) if (m := _GRIP.match(n.lower()))}
    return (axes["x"], axes["y"], axes["z"]) if len(axes) == 3 else None


def _grip_asked(text: str, recording: Recording) -> tuple[int, int, int]:
    """Columns of the state that a setting such as "observation.state[0:3]" names."""
    match = re.fullmatch(r"(?:observation\.)?state\[([0-9]{1,6}):([0-9]{1,6})\]", text.strip())
    if match and int(match[2]) - int(match[1]) == 3 and int(match[2]) <= len(recording.state_names):
        first = int(match[1])
        return first, first + 1, first + 2
    raise ConfigError(
        f"--grip names three columns of the state as observation.state[0:3] does, of "
        f"{len(recording.state_names)} that there are; got {text[:80]!r}."
    )


@dataclass(frozen=True)
class Parts:
    """The demonstrations of a dataset, those for training first."""

    all: tuple[Part, ...] = field(repr=False)
    train: int
    """Number of those for training."""

    @property
    def digest(self) -> str:
        """Hash of which episodes and views they are, in which order."""
        names = json.dumps([(p.episode, p.views) for p in self.all])
        return hashlib.sha256(names.encode()).hexdigest()[:8]

    def episodes(self, recording: Recording) -> list[Episode]:
        """What they are of."""
        return [recording.episodes[part.episode] for part in self.all]

    def layout(self, recording: Recording) -> Layout:
        """The order of their pictures."""
        return Layout(
            np.array([episode.length for episode in self.episodes(recording)]),
            np.array([len(p.views) for p in self.all]),
        )

    def samples(self, recording: Recording) -> Samples:
        """Which of their samples a run takes."""
        errors = errors_of(self.episodes(recording))
        return Samples(self.layout(recording), self.train, ordered=True, errors=errors)


def parts_of(recording: Recording, held_out: HeldOut, views: int) -> Parts:
    """Which episodes and views are for training, and which for validation.

    Args:
        recording: The dataset.
        held_out: What training does not see.
        views: Cameras that a policy sees at once.

    Raises:
        ConfigError: A name or number is not of the dataset, or too little remains.
    """
    path = recording.path
    for view in held_out.views:
        if view not in recording.views:
            raise ConfigError(f"{path} has no view '{view}'{closest(view, recording.views)}.")
    usual = [v for v in recording.views if v not in held_out.views]
    if not usual:
        raise ConfigError(f"{path}: no view remains for training. Hold fewer out.")
    validation = _episodes(recording, held_out)
    training = [i for i in range(len(recording.episodes)) if i not in validation]
    if not training:
        raise ConfigError(f"{path}: no episode remains for training. Hold fewer out.")
    seen_by = {i: _sighted(recording.episodes[i], usual) for i in range(len(recording.episodes))}
    for i in (*training, *validation):
        if len(seen_by[i]) < views:
            some = f"Give --views {len(seen_by[i])}" if seen_by[i] else "Leave the episode out"
            name = recording.episodes[i].name
            raise ConfigError(
                f"{path}: episode '{name}' is seen by {len(seen_by[i])} views for training "
                f"({', '.join(seen_by[i]) or 'none'}), but the policy sees {views}. "
                f"{some}, or hold fewer views out."
            )
    parts = [Part(i, tuple(seen_by[i]), "training") for i in training]
    parts += [Part(i, tuple(seen_by[i][:views]), "new episodes") for i in validation]
    for view in dict.fromkeys(held_out.views):
        for i in validation or training[-1:]:
            if view in recording.episodes[i].sights:
                company = seen_by[i][: views - 1]
                parts.append(Part(i, (view, *company), "new cameras"))
    return Parts(tuple(parts), len(training))


def _sighted(episode: Episode, views: Sequence[str]) -> list[str]:
    return [view for view in views if view in episode.sights]


def _episodes(recording: Recording, held_out: HeldOut) -> tuple[int, ...]:
    """Numbers of the episodes that are held out, ascending."""
    count = len(recording.episodes)
    for number in held_out.episodes:
        if not 0 <= number < count:
            raise ConfigError(
                f"{recording.path} has no episode {number}: its {count} are 0 to {count - 1}."
            )
    if named := held_out.episodes or recording.valid:
        return tuple(sorted(set(named)))
    some = min(held_out.count, max(1, count // LARGEST_SHARE) if held_out.count else 0, count - 1)
    return tuple(int(i) for i in np.linspace(0, count - 1, some + 2)[1:-1].round()) if some else ()


def make_recorded(
    recording: Recording, parts: Parts, pictures: Pictures, meaning: Meaning
) -> Dataset:
    """Turns a recorded dataset into arrays.

    Args:
        recording: The dataset.
        parts: Its demonstrations.
        pictures: Of those.
        meaning: What is known of its numbers.
    """
    cameras = _Cameras(pictures.rgb.shape[1:3])
    episodes = parts.episodes(recording)
    windows = [
        cameras.window(episode, part.views)
        for episode, part in zip(episodes, parts.all, strict=True)
    ]
    longest = max(e.length for e in episodes)
    errors = errors_of(episodes)
    keyframes = unknown_keyframes = None
    if meaning.grip is not None and meaning.gripper is not None:
        changes = [_next_changes(e, meaning.gripper) for e in episodes]
        reached = [
            e.state[np.minimum(steps, e.length - 1)][:, list(meaning.grip)]
            for e, steps in zip(episodes, changes, strict=True)
        ]
        keyframes = _padded(reached, longest)
        unknown_keyframes = None if errors is None else keyframe_errors(errors, changes)
    lenses = np.stack(cameras.lenses).astype(np.float32)
    asked = np.array([recording.instructions.index(e.instruction) for e in episodes], np.int32)
    return Dataset(
        pictures=pictures,
        K=np.stack(cameras.K).astype(np.float32),
        base_from_camera=np.stack(cameras.poses).astype(np.float32),
        actions=_padded([e.action for e in episodes], longest),
        proprio=_padded([e.state for e in episodes], longest),
        windows=windows,
        train=parts.train,
        fingerprint=f"{recording.fingerprint}-{parts.digest}-{size_name(*pictures.rgb.shape[1:3])}px",
        keyframes=keyframes,
        errors=errors,
        keyframe_errors=unknown_keyframes,
        distortion=lenses if lenses.any() else None,
        instruction=asked if len(recording.instructions) > 1 else None,
        ordered=True,
    )


def _padded(arrays: Sequence[np.ndarray], longest: int) -> np.ndarray:
    return np.stack([np.pad(a, ((0, longest - len(a)), (0, 0))) for a in arrays]).astype(np.float32)


def _next_changes(episode: Episode, gripper: int) -> np.ndarray:
    """The step at which the gripper's command next crosses the middle of its range, or T, [T]."""
    command = episode.action[:, gripper]
    closed = command > (command.min() + command.max()) / 2
    changes = np.append(np.flatnonzero(np.diff(closed)) + 1, episode.length)
    return changes[np.searchsorted(changes, np.arange(episode.length), side="right")]


class _Cameras:
    """The table of cameras, which grows episode by episode."""

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self.K: list[np.ndarray] = []
        self.poses: list[np.ndarray] = []
        self.lenses: list[np.ndarray] = []

    def window(self, episode: Episode, views: Sequence[str]) -> np.ndarray:
        """Rows of the cameras of some views [n], or [T, n] where one of them moves."""
        rows = [self._add(episode, view) for view in views]
        if all(len(r) == 1 for r in rows):
            return np.concatenate(rows)
        return np.stack([np.broadcast_to(r, episode.length) for r in rows], 1)

    def _add(self, episode: Episode, view: str) -> np.ndarray:
        sight = episode.sights[view]
        fitted = fit((sight.height, sight.width), self._size)
        calibration = sight.calibration or unknown(sight.height, sight.width)
        K, poses = fitted.intrinsics(calibration.K), calibration.base_from_camera
        count = episode.length if K.ndim == 3 or poses.ndim == 3 else 1
        first = len(self.K)
        self.K += list(np.broadcast_to(K, (count, 3, 3)))
        self.poses += list(np.broadcast_to(poses, (count, 4, 4)))
        self.lenses += [calibration.distortion] * count
        return np.arange(first, first + count)


def unknown(height: int, width: int) -> Calibration:
    """What stands for a camera that nobody has calibrated; only conditioning none may see it."""
    side = float(max(height, width))
    K = np.array([[side, 0, width / 2], [0, side, height / 2], [0, 0, 1]])
    return Calibration(K, np.eye(4), source="nobody")


def fits_of(
    recording: Recording, parts: Parts, size: tuple[int, int]
) -> dict[tuple[int, str], Fit]:
    """How the pictures of each episode and view that is used are brought to a size."""
    used = {(p.episode, v) for p in parts.all for v in p.views}
    sights = {(e, v): recording.episodes[e].sights[v] for e, v in used}
    return {key: fit((s.height, s.width), size) for key, s in sights.items()}
