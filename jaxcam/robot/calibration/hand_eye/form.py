"""`calibrate hand-eye`: from a tag on the hand to a camera's pose in the file of calibrations."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.calibrate import HandEyeConfig
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import ConfigError, DatasetError, closest
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.writing import (
    Changes,
    check_updatable,
    overruled,
    pose_json,
    update_cameras,
)
from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.figures import residual_figure, space_figure
from jaxcam.robot.calibration.hand_eye.fit import (
    ENOUGH,
    HandEyeFit,
    fit_hand_eye,
    most_different_poses,
    slow_steps,
    turns_of,
)
from jaxcam.robot.calibration.hand_eye.grip_poses import (
    COUNTS,
    GripNumbers,
    grip_numbers,
    poses_of_grip,
)
from jaxcam.robot.calibration.known import optics_of_view
from jaxcam.robot.calibration.page import (
    CalibrationPage,
    overlay,
    page_path,
    spread_out,
    write_calibration,
)
from jaxcam.robot.calibration.pictures import NamedPicture
from jaxcam.robot.calibration.pose_page import OFF, overruled_note, pose_verdict
from jaxcam.robot.calibration.projection import placed
from jaxcam.robot.calibration.tags.pictures import NEEDS, find_tags
from jaxcam.robot.calibration.tags.places import square

MORE = 3
"""Pictures that are looked at for each that is wanted: the tag is not in all."""
WEAK = np.deg2rad(15)
"""Spread of rotations about a second axis below which more turning is advised."""
UNKNOWN = 0.03, np.deg2rad(3.0)
"""Standard deviations (m, rad) from when on nothing is written."""


@dataclass(frozen=True)
class Shots:
    """Pictures of the tag, with the grip's pose in each."""

    episodes: np.ndarray
    """Number of each picture's episode, [n]."""
    states: np.ndarray = field(repr=False)
    """[n, P]."""
    corners: np.ndarray = field(repr=False)
    """Of the tag, [n, 4, 2]."""
    pictures: tuple[NamedPicture, ...] = field(repr=False)


def calibrate_hand_eye(config: HandEyeConfig, console: Console) -> None:
    """Runs the form; see `HandEyeConfig`.

    Raises:
        ConfigError: Settings do not go together, or the state does not say the grip's pose.
        DatasetError: The pictures or the motions are not what is needed.
    """
    cameras = absolute(config.cameras)
    check_updatable(cameras)
    path = page_path(config.out, cameras, "hand-eye", config.view)
    recording = read_recording(absolute(config.dataset))
    if config.view not in recording.views:
        raise ConfigError(f"--view: unknown {config.view!r}{closest(config.view, recording.views)}")
    columns = grip_numbers(recording, config.grip_pose, config.rotation)
    optics = _optics(recording, config.view, cameras)
    with console.status("looking for the tag"):
        shots = take_shots(recording, config, columns, optics)
    with console.status("calibrating"):
        fit = fit_shots(shots, columns, config, optics)
    about = {"pose": {"by": "hand-eye", **_about(fit, len(shots.corners))}}
    entries = pose_json(fit.base_from_camera)
    update_cameras(cameras, Changes({config.view: entries}, about={config.view: about}))
    others = overruled(cameras, config.view)
    notes = [overruled_note(config.view, others)] if others else []
    page = _page(config, shots, columns, fit, optics, notes)
    write_calibration(page, path)
    console.print(page.verdict, soft_wrap=True)
    for note in page.notes:
        console.print(note, soft_wrap=True)
    console.print(f"{cameras}: pose of view {config.view}. Page: {path}", soft_wrap=True)


def _optics(recording: Recording, view: str, cameras: Path) -> Optics:
    sight = next((e.sights[view] for e in recording.episodes if view in e.sights), None)
    if sight is None:
        raise DatasetError(f"No episode was seen by view '{view}'.")
    return optics_of_view(cameras, view, (sight.width, sight.height))


def take_shots(
    recording: Recording, config: HandEyeConfig, columns: GripNumbers, optics: Optics
) -> Shots:
    """Pictures with the tag, of poses that differ.

    Args:
        recording: The dataset.
        config: Settings.
        columns: Which numbers of the state are the grip's pose.
        optics: How the camera sees.

    Raises:
        DatasetError: The tag is in too few.
    """
    seen_by = [i for i, e in enumerate(recording.episodes) if config.view in e.sights]
    poses = [
        poses_of_grip(recording.episodes[i].state, columns, f"episode {i}") for i in seen_by
    ]  # fmt: skip
    chosen = most_different_poses(np.concatenate(poses), slow_steps(poses), MORE * config.most)
    ends = np.cumsum([0, *map(len, poses)])
    rows, others, first = [], set(), None
    for place, number in enumerate(seen_by):
        steps = {i - ends[place] for i in chosen if ends[place] <= i < ends[place + 1]}
        if not steps:
            continue
        episode = recording.episodes[number]
        for step, rgb in enumerate(episode.sights[config.view].decode()):
            if step not in steps:
                continue
            picture = NamedPicture(f"episode {number}, step {step}", rgb)
            first = first or picture
            tags = find_tags(picture, config.family, optics)
            others |= tags.keys() - {config.tag}
            if config.tag in tags:
                rows.append((number, episode.state[step], tags[config.tag], picture))
    if len(rows) < ENOUGH:
        raise DatasetError(
            f"View '{config.view}' shows tag {config.tag} of the family {config.family} in "
            f"{len(rows)} of the {len(chosen)} pictures that differ most; at least {ENOUGH} are "
            f"needed. Other tags there: {', '.join(map(str, sorted(others))) or 'none'} (--tag). "
            + NEEDS
        )
    keep = spread_out(len(rows), config.most)
    numbers, states, corners, pictures = zip(*(rows[i] for i in keep), strict=True)
    return Shots(np.array(numbers), np.stack(states), np.stack(corners), pictures)


def fit_shots(
    shots: Shots, columns: GripNumbers, config: HandEyeConfig, optics: Optics
) -> HandEyeFit:
    """The fit, if it explains the pictures.

    Args:
        shots: The pictures.
        columns: Which numbers of the state are the grip's pose.
        config: Settings.
        optics: How the camera sees.

    Raises:
        DatasetError: It does not; the message says what would, or what is lacking.
    """
    size, limit = config.size_mm / 1000, OFF * max(optics.width / 640, 0.5)
    fit = _fit(shots, columns, size, optics)
    if not _explains(fit, limit):
        raise DatasetError(_why(shots, columns, fit, size, optics))
    place, turn = fit.spread
    if place > UNKNOWN[0] or turn > UNKNOWN[1]:
        spreads, axes = turns_of(poses_of_grip(shots.states, columns, "state"))
        raise DatasetError(
            f"These motions do not tell the camera's pose: it is sure to {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees. The hand turns by "
            f"{', '.join(f'{x:.0f}' for x in np.rad2deg(spreads))} degrees about three axes; "
            f"lacking are turns about {np.round(axes[1], 1)} and {np.round(axes[2], 1)} of it."
        )
    return fit


def _fit(shots: Shots, columns: GripNumbers, size: float, optics: Optics) -> HandEyeFit:
    poses = poses_of_grip(shots.states, columns, "the state")
    return fit_hand_eye(poses, shots.corners, size, optics)


def _explains(fit: HandEyeFit, limit: float) -> bool:
    return fit.rms < limit and fit.used.mean() > 0.7


def _why(shots: Shots, columns: GripNumbers, fit: HandEyeFit, size: float, optics: Optics) -> str:
    """Why the grip's poses do not explain the tag's pictures."""
    limit = OFF * max(optics.width / 640, 0.5)
    off = np.linalg.norm(fit.residuals, axis=-1)
    words = (
        f"The grip's poses do not explain where the tag is: half of the corners are more than "
        f"{np.median(off):.1f} pixels off (expected below {limit:.1f})."
    )
    for form, count in COUNTS.items():
        if count == len(columns.rotation) and form != columns.form:
            try:
                other = _fit(shots, replace(columns, form=form), size, optics)
            except DatasetError:
                continue
            if _explains(other, limit):
                return f"{words} With --rotation {form} they do ({other.rms:.1f} pixels)."
    for number in np.unique(shots.episodes)[1:]:
        parts = shots.episodes < number, shots.episodes >= number
        if min(part.sum() for part in parts) < ENOUGH:
            continue
        try:
            fits = [_fit(_some(shots, part), columns, size, optics) for part in parts]
        except DatasetError:
            continue
        if all(_explains(one, limit) for one in fits):
            return (
                f"{words} Episodes before {number} and those from {number} on agree among "
                "themselves: the camera, or the tag on the hand, moved between them. Calibrate "
                "each part alone."
            )
    return (
        f"{words} Likely causes: another --rotation or other columns (--grip-pose); a pose that is "
        "not of the part that carries the tag; pictures and states that are not of one moment; the "
        "tag is loose; --size-mm is not that of the black square."
    )


def _some(shots: Shots, part: np.ndarray) -> Shots:
    pictures = tuple(p for p, is_in in zip(shots.pictures, part, strict=True) if is_in)
    return Shots(shots.episodes[part], shots.states[part], shots.corners[part], pictures)


def _about(fit: HandEyeFit, pictures: int) -> dict[str, object]:
    place, turn = fit.spread
    return {
        "deviation_mm": round(1000 * place, 2),
        "deviation_deg": round(float(np.rad2deg(turn)), 3),
        "rms_pixels": round(fit.rms, 3),
        "pictures": pictures,
        "grip_from_tag": np.round(fit.grip_from_tag, 6).tolist(),
    }


def _notes(fit: HandEyeFit, poses: np.ndarray) -> list[str]:
    notes, (spreads, axes) = [], turns_of(poses)
    if len(poses) < 15:
        notes.append(f"{len(poses)} pictures with different poses: take 15.")
    if spreads[1] < WEAK:
        notes.append(
            f"The hand turns by {np.rad2deg(spreads[1]):.0f} degrees about its second axis "
            f"({np.round(axes[1], 1)} of the grip): turn it by 30 there."
        )
    if not fit.used.all():
        away = int((~fit.used.all(-1)).sum())
        notes.append(f"{away} pictures with corners that did not count: the hand was fast, or the "
                     "tag half hidden.")  # fmt: skip
    return notes


def _page(
    config: HandEyeConfig,
    shots: Shots,
    columns: GripNumbers,
    fit: HandEyeFit,
    optics: Optics,
    notes: list[str],
) -> CalibrationPage:
    poses = poses_of_grip(shots.states, columns, "the state")
    verdict, good = pose_verdict({config.view: fit.spread})
    rows = []
    for name, pose, (place, turn) in (
        ("camera in the base frame", fit.base_from_camera, fit.spread),
        ("tag on the grip", fit.grip_from_tag, fit.tag_spread),
    ):
        position = ", ".join(f"{x:.4f}" for x in pose[:3, 3])
        rows.append((name, position, f"{1000 * place:.2f} mm", f"{np.rad2deg(turn):.3f}°"))
    rows.append(("corners are off by (RMS)", f"{fit.rms:.2f} pixels", "", ""))
    degrees = np.rad2deg(turns_of(poses)[0])
    rows.append(("the hand's turns about three axes",
                 ", ".join(f"{x:.0f}°" for x in degrees), "", ""))  # fmt: skip
    overlays = {}
    for i in spread_out(len(shots.pictures)):
        picture = shots.pictures[i]
        fitted = shots.corners[i] + fit.residuals[i]
        overlays[
            f"{picture.name}: rings are the tag's corners, crosses where the fit has them."
        ] = overlay(picture.rgb, shots.corners[i], fitted, fit.used[i])
    corners = np.stack([
        placed(pose @ fit.grip_from_tag, square(config.size_mm / 1000)) for pose in poses
    ])  # fmt: skip
    figures = {
        "The camera around the robot's base, and where the tag was.": space_figure(
            {config.view: [fit.base_from_camera]}, {config.view: optics}, {"tag": corners}
        ),
        "What the fit leaves of each corner.": residual_figure(
            shots.corners.reshape(-1, 2), fit.residuals.reshape(-1, 2), fit.used.ravel(),
            (optics.width, optics.height),
        ),
    }  # fmt: skip
    subtitle = f"{len(poses)} pictures of tag {config.tag}, {config.family}, {config.size_mm:g} mm"
    head = ("quantity", "value", "deviation", "rotation")
    return CalibrationPage(
        f"Hand and eye: {config.view}", subtitle, verdict, good, rows, head,
        notes + _notes(fit, poses), overlays, figures,
    )  # fmt: skip
