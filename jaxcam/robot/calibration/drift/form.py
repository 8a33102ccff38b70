"""`calibrate drift`: which cameras moved, from which episode on, and where they stand since."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from jaxcam.config.calibrate_arm import DriftConfig
from jaxcam.console.progress import progress
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import ConfigError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.writing import check_updatable, update_cameras
from jaxcam.interop.recordings import read_recording
from jaxcam.reports.style import BLUE, GREY, VERMILION, side_by_side, styled
from jaxcam.robot.calibration.arm.form import arm_for
from jaxcam.robot.calibration.arm.joints import JointNumbers, joint_numbers
from jaxcam.robot.calibration.arm.model import ArmModel
from jaxcam.robot.calibration.drift.change import SUPPORT
from jaxcam.robot.calibration.drift.looking import (
    LookedAt,
    ViewDrift,
    drift_of,
    episodes_standing,
    pose_overrides,
)
from jaxcam.robot.calibration.figures import space_figure
from jaxcam.robot.calibration.known import not_used_note, require_view
from jaxcam.robot.calibration.page import CalibrationPage, page_path, show_calibration, spread_out


def calibrate_drift(config: DriftConfig, console: Console) -> None:
    """Runs the form; see `DriftConfig`.

    Raises:
        ConfigError: Settings do not go together, no view has a pose, or new ones would not count.
        DatasetError: The pictures cannot be read.
    """
    cameras = absolute(config.cameras)
    check_updatable(cameras)
    if config.cameras != DriftConfig.cameras and not cameras.exists():
        raise ConfigError(f"--cameras {cameras}: no such file.")
    path = page_path(config.out, cameras, "drift", config.view)
    recording = read_recording(absolute(config.dataset), cameras if cameras.exists() else None)
    if config.view:
        require_view(config.view, recording)
    columns = joint_numbers(recording, config.joints, config.opening)
    arm = arm_for(config.robot, columns)
    by_view = _standing(recording, [config.view] if config.view else recording.views, cameras)
    if config.write:
        for view in by_view:
            if other := not_used_note(recording, view, cameras):
                raise ConfigError(f"--write: {other}")
    drifts = list(_drifts(recording, by_view, arm, columns, config, console))
    words = [line for drift in drifts for line in drift_words(recording, drift)]
    moved = any(drift.runs for drift in drifts)
    written = ""
    if config.write and moved:
        called = {str(i): e.name for i, e in enumerate(recording.episodes)}
        update_cameras(cameras, replace(pose_overrides(drifts), called=called))
        written = f"{cameras}: new poses of those episodes."
    elif moved:
        words.append("Run it with --write to put the new poses into the file, or calibrate anew.")
    show_calibration(_page(config, drifts, words), path, console, written)


def _standing(recording: Recording, views: Sequence[str], cameras: Path) -> dict[str, list[int]]:
    """By the view's name, episodes in which it has a pose; views without one are left out."""
    by_view = {view: episodes_standing(recording, view) for view in views}
    if not any(by_view.values()):
        there = "" if cameras.exists() else f" ({cameras}: no such file)"
        raise ConfigError(
            f"No pose that stands still is known of view {', '.join(views)}{there}: python -m "
            "jaxcam.calibrate tags, hand-eye or arm finds it."
        )
    return {view: episodes for view, episodes in by_view.items() if episodes}


def _drifts(
    recording: Recording,
    by_view: dict[str, list[int]],
    arm: ArmModel,
    columns: JointNumbers,
    config: DriftConfig,
    console: Console,
) -> Iterator[ViewDrift]:
    """Looks at some episodes of each view, then once more around those in which it had moved."""
    for view, episodes in by_view.items():
        some = [episodes[i] for i in spread_out(len(episodes), config.episodes)]
        looks: LookedAt = {}
        with progress(console, f"looking at {view}", len(some)) as advance:
            drift = drift_of(recording, view, some, arm, columns, config.most, advance, looks)
        if ends := drift.open_ends:
            some = [ends[i] for i in spread_out(len(ends), config.episodes)]
            with progress(console, f"looking when {view} moved", len(some)) as advance:
                drift = drift_of(recording, view, some, arm, columns, config.most, advance, looks)
        yield drift


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
        own = "" if name in (str(first), f"episode {first}") else f" ({name})"
        which = f"episode {first}{own}"
        which = f"from {which} on, to episode {last}" if last > first else f"in {which}"
        lines.append(
            f"View {drift.view}: the camera had moved {which}, by {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees. It then stood at {position} (m, base frame)."
        )
    if drift.silent:
        numbers = _listed([a.episode for a in drift.silent])
        lines.append(
            f"View {drift.view}: nothing can be said of episodes {numbers}: less than "
            f"{SUPPORT:.0%} of the arm's contour lies on edges. The camera may have moved far "
            "(calibrate anew), or the arm is hardly in view."
        )
    if ends := drift.open_ends:
        lines.append(
            f"View {drift.view}: nobody looked at episodes {_listed(ends)}, next to those in which "
            "it had moved: where it stood in them is not known. Look at more (--episodes)."
        )
    if drift.pose_off:
        place, turn = drift.together
        lines.append(
            f"View {drift.view}: episodes ask together for {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees, which is no motion: the pose that is given is off, "
            "or the joints are. Calibrate anew (python -m jaxcam.calibrate arm)."
        )
    if drift.unsure:
        place, turn = drift.spread
        lines.append(
            f"View {drift.view}: a single episode tells the pose to {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees only, so that motions of that size are not seen. The "
            "camera may have stood elsewhere in almost every episode, or the pictures tell too "
            "little: use more of them (--most)."
        )
    elif drift.alone:
        lines.append(
            f"View {drift.view}: episode {drift.episodes[0].asked.episode} alone says something, "
            "and there is none to hold it against: whether the camera moved is not known."
        )
    elif drift.episodes and not drift.runs:
        others = f"; {len(drift.left_out)} more were not looked at (--episodes)"
        lines.append(
            f"View {drift.view}: stood still in {len(drift.episodes)} episodes"
            f"{others if drift.left_out else ''}."
        )
    return lines


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:8])) + (" and more" if len(numbers) > 8 else "")


def _page(config: DriftConfig, drifts: list[ViewDrift], words: list[str]) -> CalibrationPage:
    moved = [f"{d.view} from episode {d.runs[0][0].asked.episode}" for d in drifts if d.runs]
    silent = sum(len(d.silent) for d in drifts)
    off = [drift.view for drift in drifts if drift.pose_off]
    unknown = [drift.view for drift in drifts if drift.unsure or drift.alone]
    good = all(drift.stood_still for drift in drifts) and not silent
    verdict = "No camera moved, as far as the arm's motion tells."
    if moved:
        verdict = f"Cameras moved: {'; '.join(moved)}. Poses of those episodes are wrong."
    elif off:
        verdict = f"The poses that are given are off in all episodes: {', '.join(off)}."
    elif unknown:
        verdict = f"It is not known whether cameras stood still: {', '.join(unknown)}."
    elif silent:
        verdict = f"No camera is seen to have moved, but {silent} episodes say nothing."
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
        f"{Path(config.robot).name}", verdict, good, rows,
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
