"""`calibrate drift`: which cameras moved, from which episode on, and where they stand since."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from jaxcam.config.calibrate_arm import DriftConfig
from jaxcam.console.progress import progress
from jaxcam.data.recorded.recording import Recording, Sight
from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.writing import Changes, check_updatable, pose_json, update_cameras
from jaxcam.interop.recordings import read_recording
from jaxcam.reports.style import BLUE, GREY, VERMILION, side_by_side, styled
from jaxcam.robot.calibration.arm.film import Film
from jaxcam.robot.calibration.arm.form import arm_for
from jaxcam.robot.calibration.arm.joints import JointNumbers, joint_numbers
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.arm.shooting import take_film
from jaxcam.robot.calibration.drift.change import (
    SUPPORT,
    AskedChange,
    Tested,
    ask,
    judged_changes,
    runs_of,
    with_common_joints,
)
from jaxcam.robot.calibration.drift.still import are_unsure, single_spread
from jaxcam.robot.calibration.figures import space_figure
from jaxcam.robot.calibration.known import require_view
from jaxcam.robot.calibration.page import CalibrationPage, page_path, spread_out, write_calibration

POSE_OFF = 0.02, np.deg2rad(1.0)
"""Changes (m, rad) that all episodes ask for from which on the given pose is called off; faults of
joints of half a degree ask for less."""


@dataclass(frozen=True)
class ViewDrift:
    """What was found of one view."""

    view: str
    episodes: list[Tested] = field(repr=False)
    """Those whose pictures say something."""
    silent: list[AskedChange] = field(repr=False)
    """Those whose pictures do not show the arm where the pose, or one near it, has it."""
    optics: Optics

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
    def _spreads(self) -> np.ndarray:
        return np.stack([one.asked.covariance for one in self.episodes])


def calibrate_drift(config: DriftConfig, console: Console) -> None:
    """Runs the form; see `DriftConfig`.

    Raises:
        ConfigError: Settings do not go together, or no view has a pose.
        DatasetError: The pictures cannot be read.
    """
    cameras = absolute(config.cameras)
    check_updatable(cameras)
    path = page_path(config.out, cameras, "drift", config.view)
    recording = read_recording(absolute(config.dataset), cameras if cameras.exists() else None)
    if config.view:
        require_view(config.view, recording)
    columns = joint_numbers(recording, config.joints, config.opening)
    arm = arm_for(config.robot, columns)
    views = [config.view] if config.view else list(recording.views)
    by_view = {view: episodes_standing(recording, view) for view in views}
    if not any(by_view.values()):
        raise ConfigError(
            f"No pose that stands still is known of view {', '.join(views)}: python -m "
            "jaxcam.calibrate tags, hand-eye or arm finds it."
        )
    drifts = []
    total = sum(min(len(e), config.episodes) for e in by_view.values())
    with progress(console, "looking", total) as advance:
        for view, episodes in by_view.items():
            some = [episodes[i] for i in spread_out(len(episodes), config.episodes)]
            if some:
                drifts.append(drift_of(recording, view, some, arm, columns, config.most, advance))
    words = [line for drift in drifts for line in drift_words(recording, drift)]
    moved = any(drift.runs for drift in drifts)
    if config.write and moved:
        update_cameras(cameras, pose_overrides(drifts))
        words.append(f"{cameras}: new poses of those episodes.")
    elif moved:
        words.append("Run it with --write to put the new poses into the file, or calibrate anew.")
    write_calibration(_page(config, drifts, words), path)
    for line in words:
        console.print(line, soft_wrap=True)
    console.print(f"Page: {path}", soft_wrap=True)


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
    episodes: list[int],
    arm: ArmModel,
    columns: JointNumbers,
    most: int,
    advance: Callable[[], None] = lambda: None,
) -> ViewDrift:
    """What one view's episodes ask for.

    Args:
        recording: The dataset.
        view: The camera's name.
        episodes: Those that are looked at, ascending.
        arm: The robot.
        columns: Which numbers of the state are joints.
        most: Pictures of each episode.
        advance: Called after each.
    """
    films: list[Film] = []
    first: list[AskedChange] = []
    optics = None
    for number in episodes:
        sight = recording.episodes[number].sights[view]
        assert sight.calibration is not None
        K = np.reshape(sight.calibration.K, (-1, 3, 3))[0].astype(float)
        lens = np.asarray(sight.calibration.distortion)
        optics = Optics(K, sight.width, sight.height, lens)
        film = take_film(recording, view, columns, optics, [number], most)
        given = np.asarray(sight.calibration.base_from_camera, float)
        films.append(film)
        first.append(ask(arm, film, given))
        advance()
    assert optics is not None
    asked = with_common_joints(arm, films, first)
    silent = [a for a in asked if not a.clear]
    return ViewDrift(view, judged_changes(asked), silent, optics)


def pose_overrides(drifts: list[ViewDrift]) -> Changes:
    """Poses of episodes in which a camera had moved, for the file of calibrations.

    Args:
        drifts: Of the views.
    """
    episodes: dict[str, dict] = {}
    about: dict[str, dict] = {}
    for drift in drifts:
        for run in drift.runs:
            for one in run:
                episodes.setdefault(str(one.asked.episode), {})[drift.view] = pose_json(one.pose)
                poses = about.setdefault(drift.view, {"drift": {"by": "arm", "episodes": []}})
                poses["drift"]["episodes"].append(one.asked.episode)
    return Changes(episodes=episodes, about=about)


def drift_words(recording: Recording, drift: ViewDrift) -> list[str]:
    """What was found, in plain sentences.

    Args:
        recording: The dataset.
        drift: Of one of its views.
    """
    lines = []
    for run in drift.runs:
        first, last = run[0].asked.episode, run[-1].asked.episode
        place, turn = run[0].sizes
        position = ", ".join(f"{x:.4f}" for x in run[0].pose[:3, 3])
        name = recording.episodes[first].name
        which = f"episode {first}" + (f" ({name})" if name != str(first) else "")
        which = f"from {which} on, to episode {last}" if last > first else f"in {which}"
        lines.append(
            f"View {drift.view}: the camera had moved {which}, by {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees. It then stood at {position} (m, base frame)."
        )
    if drift.silent:
        numbers = ", ".join(str(a.episode) for a in drift.silent[:8])
        lines.append(
            f"View {drift.view}: nothing can be said of episodes {numbers}"
            f"{' and more' if len(drift.silent) > 8 else ''}: less than {SUPPORT:.0%} of the arm's "
            "contour lies on edges. The camera may have moved far (calibrate anew), or the arm is "
            "hardly in view."
        )
    if drift.episodes:
        one = drift.episodes[0]
        together = one.asked.change - one.change
        place, turn = np.linalg.norm(together[:3]), np.linalg.norm(together[3:])
        if place > POSE_OFF[0] or turn > POSE_OFF[1]:
            lines.append(
                f"View {drift.view}: episodes ask together for {1000 * place:.0f} mm and "
                f"{np.rad2deg(turn):.1f} degrees, which is no motion: the pose that is given is "
                "off, or the joints are. Calibrate anew (python -m jaxcam.calibrate arm)."
            )
    if drift.unsure:
        place, turn = drift.spread
        lines.append(
            f"View {drift.view}: a single episode tells the pose to {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees only, so that motions of that size are not seen. The "
            "camera may have stood elsewhere in almost every episode, or the pictures tell too "
            "little: use more of them (--most)."
        )
    elif drift.episodes and not drift.runs:
        lines.append(f"View {drift.view}: stood still in {len(drift.episodes)} episodes.")
    return lines


def _page(config: DriftConfig, drifts: list[ViewDrift], words: list[str]) -> CalibrationPage:
    moved = [f"{d.view} from episode {d.runs[0][0].asked.episode}" for d in drifts if d.runs]
    silent = sum(len(d.silent) for d in drifts)
    unsure = [drift.view for drift in drifts if drift.unsure]
    verdict = "No camera moved, as far as the arm's motion tells."
    if moved:
        verdict = f"Cameras moved: {'; '.join(moved)}. Poses of those episodes are wrong."
    elif silent:
        verdict = f"No camera is seen to have moved, but {silent} episodes say nothing."
    elif unsure:
        verdict = f"It is not known whether cameras stood still: {', '.join(unsure)}."
    rows = [
        (drift.view, str(one.asked.episode), f"{1000 * one.sizes[0]:.1f} mm",
         f"{np.rad2deg(one.sizes[1]):.2f}°", f"{np.sqrt(max(one.distance, 0)):.1f}",
         "moved" if one.moved else "")
        for drift in drifts for one in drift.episodes
    ]  # fmt: skip
    figures: dict[str, Figure] = {}
    for drift in drifts:
        if drift.episodes:
            figures[f"What episodes of {drift.view} ask for."] = change_figure(drift)
            poses = [one.pose for one in drift.episodes]
            figures[f"Where {drift.view} stood around the robot's base."] = space_figure(
                {drift.view: poses}, {drift.view: drift.optics}, {}
            )
    return CalibrationPage(
        f"Drift: {Path(config.dataset).name}", f"{len(rows)} episodes and views, robot "
        f"{Path(config.robot).name}", verdict, not (moved or silent or unsure), rows,
        ("view", "episode", "moved by", "turned by", "standard deviations", ""), words,
        figures=figures,
    )  # fmt: skip


@styled
def change_figure(drift: ViewDrift) -> Figure:
    """By how much a camera moved, episode by episode."""
    figure, axes = side_by_side((8.2, 3.2), columns=2)
    numbers = np.array([one.asked.episode for one in drift.episodes])
    is_moved = np.array([one.moved for one in drift.episodes])
    sizes = np.array([one.sizes for one in drift.episodes]) * (1000, np.rad2deg(1))
    for ax, values, label in zip(axes, sizes.T, ("mm", "degrees"), strict=True):
        ax.plot(numbers[~is_moved], values[~is_moved], "o", color=BLUE, markersize=4,
                label="stood still")  # fmt: skip
        ax.plot(numbers[is_moved], values[is_moved], "o", color=VERMILION, markersize=4,
                label="moved")  # fmt: skip
        ax.axhline(0, color=GREY, linewidth=0.8)
        ax.set(xlabel="episode", ylabel=label)
    axes[0].legend(fontsize=8)
    return figure
