"""What was found of one view: which of its episodes were looked at, and where it stood in them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxcam.data.recorded.recording import Recording, Sight
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.writing import Changes, pose_json
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.joints import JointNumbers
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.shooting import take_film
from jaxcam.robot.calibration.drift.change import (
    AskedChange,
    Tested,
    ask,
    judged_changes,
    runs_of,
    with_common_joints,
)
from jaxcam.robot.calibration.drift.still import are_unsure, single_spread
from jaxcam.robot.calibration.projection import moved

POSE_OFF = 0.02, np.deg2rad(1.0)
"""Changes (m, rad) that all episodes ask for from which on the given pose is called off; faults of
joints of half a degree ask for less."""

LookedAt = dict[int, tuple[Film, AskedChange]]
"""Pictures of episodes that were looked at, and what each asks for with its joints free."""


@dataclass(frozen=True)
class ViewDrift:
    """What was found of one view."""

    view: str
    episodes: list[Tested] = field(repr=False)
    """Those whose pictures say something."""
    silent: list[AskedChange] = field(repr=False)
    """Those whose pictures do not show the arm where the pose, or one near it, has it."""
    optics: Optics
    left_out: dict[int, np.ndarray] = field(default_factory=dict, repr=False)
    """Poses that are given of episodes that were not looked at, [4, 4]."""

    @property
    def runs(self) -> list[list[Tested]]:
        """Episodes in a row in which the camera had moved."""
        return runs_of(self.episodes)

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations (m, rad) of what single episodes ask for, in the median."""
        return single_spread(self._spreads)

    @property
    def unsure(self) -> bool:
        """Whether episodes ask for too different things to tell that the camera stood still."""
        return bool(self.episodes) and are_unsure(self._spreads)

    @property
    def alone(self) -> bool:
        """Whether one episode alone says something, which can be held against no other."""
        return len(self.episodes) == 1

    @property
    def together(self) -> tuple[float, float]:
        """What all episodes ask for (m, rad)."""
        one = self.episodes[0]
        asked = one.asked.change - one.change
        return float(np.linalg.norm(asked[:3])), float(np.linalg.norm(asked[3:]))

    @property
    def pose_off(self) -> bool:
        """Whether the pose that is given is off in all episodes, by more than joints may be."""
        return bool(self.episodes) and any(np.greater(self.together, POSE_OFF))

    @property
    def stood_still(self) -> bool:
        """Whether the camera is known to have stood still, and where it is said to stand."""
        doubts = self.runs or self.unsure or self.alone or self.pose_off
        return bool(self.episodes) and not doubts

    @property
    def open_ends(self) -> list[int]:
        """Episodes not looked at, next to a run: nobody knows on which side of its ends they are.

        Ascending; those inside a run are not among them.
        """
        looked = sorted(one.asked.episode for one in self.episodes)
        nobody = [e for run in self.runs for e in self._beside(run, looked)]
        return sorted(set(nobody))

    def _beside(self, run: list[Tested], looked: list[int]) -> list[int]:
        first, last = run[0].asked.episode, run[-1].asked.episode
        before = max((e for e in looked if e < first), default=-1)
        after = min((e for e in looked if e > last), default=max(self.left_out, default=last) + 1)
        return [e for e in self.left_out if before < e < first or last < e < after]

    @property
    def _spreads(self) -> np.ndarray:
        return np.stack([one.asked.covariance for one in self.episodes])

    def poses(self, run: list[Tested]) -> dict[int, np.ndarray]:
        """Where the camera stood in each episode from a run's first to its last, [4, 4].

        Also in those between whose pictures say nothing, or at which nobody looked, unless they
        are given another pose than the run's.
        """
        first, last = run[0].asked.episode, run[-1].asked.episode
        given = self.left_out | {a.episode: a.given for a in self.silent}
        between = {
            e: moved(pose, run[0].change)
            for e, pose in given.items()
            if first < e < last and any(np.allclose(pose, one.asked.given) for one in run)
        }
        return dict(sorted((between | {one.asked.episode: one.pose for one in run}).items()))


def episodes_standing(recording: Recording, view: str) -> list[int]:
    """Episodes in which a view has a pose at which it stands still.

    Args:
        recording: The dataset.
        view: The camera's name.
    """
    return [
        i for i, e in enumerate(recording.episodes) if view in e.sights and _stands(e.sights[view])
    ]


def _stands(sight: Sight) -> bool:
    return sight.calibration is not None and sight.calibration.base_from_camera.ndim == 2


def drift_of(
    recording: Recording,
    view: str,
    episodes: Sequence[int],
    arm: ArmModel,
    columns: JointNumbers,
    most: int,
    advance: Callable[[], None] = lambda: None,
    looks: LookedAt | None = None,
) -> ViewDrift:
    """What one view's episodes ask for.

    Args:
        recording: The dataset.
        view: The camera's name.
        episodes: Those that are looked at.
        arm: The robot.
        columns: Which numbers of the state are joints.
        most: Pictures of each episode.
        advance: Called after each.
        looks: Episodes that were looked at before, which are among those that are held against
            one another; new ones are put in.
    """
    looks, optics = {} if looks is None else looks, None
    for number in episodes:
        sight = recording.episodes[number].sights[view]
        assert sight.calibration is not None
        K = np.reshape(sight.calibration.K, (-1, 3, 3))[0].astype(float)
        lens = np.asarray(sight.calibration.distortion)
        optics = Optics(K, sight.width, sight.height, lens)
        film = take_film(recording, view, columns, optics, [number], most)
        looks[number] = film, ask(arm, film, _given(sight))
        advance()
    assert optics is not None
    films, first = zip(*(looks[number] for number in sorted(looks)), strict=True)
    asked = with_common_joints(arm, films, first)
    silent = [a for a in asked if not a.clear]
    left_out = {
        e: _given(recording.episodes[e].sights[view])
        for e in episodes_standing(recording, view)
        if e not in looks
    }
    return ViewDrift(view, judged_changes(asked), silent, optics, left_out)


def _given(sight: Sight) -> np.ndarray:
    assert sight.calibration is not None
    return np.asarray(sight.calibration.base_from_camera, float)


def pose_overrides(drifts: Sequence[ViewDrift]) -> Changes:
    """Poses of episodes in which a camera had moved, for the file of calibrations.

    Args:
        drifts: Of the views.
    """
    episodes: dict[str, dict] = {}
    about: dict[str, dict] = {}
    for drift in drifts:
        for run in drift.runs:
            for number, pose in drift.poses(run).items():
                episodes.setdefault(str(number), {})[drift.view] = pose_json(pose)
                poses = about.setdefault(drift.view, {"drift": {"by": "arm", "episodes": []}})
                poses["drift"]["episodes"].append(number)
    return Changes(episodes=episodes, about=about)
