"""`calibrate hand-eye`: from grip poses to a camera's pose in the file of calibrations."""

from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.calibrate import HandEyeConfig
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import DatasetError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.grips import GripEntries, grip_numbers
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.writing import (
    Changes,
    carried_json,
    check_updatable,
    overruled,
    pose_json,
    update_cameras,
)
from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.figures import residual_figure, space_figure
from jaxcam.robot.calibration.hand_eye.faults import Case, Delay, delay_of, fit_shots, is_late
from jaxcam.robot.calibration.hand_eye.fit import HandEyeFit, turns_of
from jaxcam.robot.calibration.hand_eye.shots import board_of, take_shots
from jaxcam.robot.calibration.known import not_used_note, optics_of_view, require_view
from jaxcam.robot.calibration.page import (
    CalibrationPage,
    overlay,
    page_path,
    show_calibration,
    spread_out,
)
from jaxcam.robot.calibration.pose_page import overruled_note, pose_verdict
from jaxcam.robot.calibration.projection import placed
from jaxcam.robot.calibration.tags.places import square

WEAK = np.deg2rad(15)
"""Spread of rotations about a second axis below which more turning is advised."""
DRAWN = 8
"""Poses of a camera on the hand that are drawn."""


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
    require_view(config.view, recording)
    grip = GripEntries(config.grip_pose, config.rotation, config.delay_ms)
    columns = grip_numbers(recording.state_names, grip)
    optics = _optics(recording, config.view, cameras)
    late = config.delay_ms / 1000 * recording.rate
    with console.status("looking for the target"):
        shots = take_shots(recording, config, columns, optics)
    case = Case(shots, columns, optics, late, recording.rate)
    with console.status("calibrating"):
        fit = fit_shots(case, config)
        delay = delay_of(case, fit)
    if config.delay_ms and delay and not is_late(delay, late):
        fit = delay.fit  # all pictures are in time
    else:
        case = case.at_rest
    carried = shots.on_hand
    entries = (
        carried_json(fit.mount_from_camera, grip) if carried else pose_json(fit.mount_from_camera)
    )
    about = {"pose": {"by": "hand-eye", **_about(fit, carried)}}
    update_cameras(cameras, Changes({config.view: entries}, about={config.view: about}))
    others = overruled(cameras, config.view)
    notes = [overruled_note(config.view, others)] if others else []
    notes += filter(None, [not_used_note(recording, config.view, cameras)])
    page = _page(config, case, fit, notes + _in_time(delay, late, carried=carried))
    show_calibration(page, path, console, f"{cameras}: pose of view {config.view}.")


def _optics(recording: Recording, view: str, cameras: Path) -> Optics:
    sight = next((e.sights[view] for e in recording.episodes if view in e.sights), None)
    if sight is None:
        raise DatasetError(f"No episode was seen by view '{view}'.")
    return optics_of_view(cameras, view, (sight.width, sight.height))


def _in_time(delay: Delay | None, said: float, *, carried: bool) -> list[str]:
    """Whether states are of the moments of their pictures, in words."""
    if delay is None:
        return ["Whether states and pictures are of one moment cannot be seen: too few pictures of "
                "a hand in motion."]  # fmt: skip
    if not is_late(delay, said):
        return []
    also = "The camera's poses are as late, too, until then. " if carried else ""
    return [
        f"States are {delay.words} than their pictures. The pose is from pictures of a hand that "
        f"rests, and right nevertheless; {delay.flag} takes the delay into account. {also}Correct "
        "the recording if you can: a policy that learns from it learns that delay."
    ]


def _about(fit: HandEyeFit, carried: bool) -> dict[str, object]:
    place, turn = fit.spread
    return {
        "deviation_mm": round(1000 * place, 2),
        "deviation_deg": round(float(np.rad2deg(turn)), 3),
        "rms_pixels": round(fit.rms, 3),
        "pictures": len(fit.used),
        "base_from_target" if carried else "grip_from_target": np.round(
            fit.holder_from_target, 6
        ).tolist(),
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
    away = sum(not used.all() for used in fit.used)
    if away:
        notes.append(f"{away} pictures with corners that did not count: the hand was fast, or the "
                     "target half hidden.")  # fmt: skip
    return notes


def _page(config: HandEyeConfig, case: Case, fit: HandEyeFit, notes: list[str]) -> CalibrationPage:
    shots, optics, carried = case.shots, case.optics, case.shots.on_hand
    grips = shots.grips(case.columns)(fit.also)
    verdict, good = pose_verdict({config.view: fit.spread})
    board = board_of(config)
    what = "board" if board else "tag"
    places = ["in the base frame", "on the grip"]
    if carried:
        places.reverse()
    rows = []
    for name, pose, (place, turn) in (
        (f"camera {places[0]}", fit.mount_from_camera, fit.spread),
        (f"{what} {places[1]}", fit.holder_from_target, fit.target_spread),
    ):
        position = ", ".join(f"{x:.4f}" for x in pose[:3, 3])
        rows.append((name, position, f"{1000 * place:.2f} mm", f"{np.rad2deg(turn):.3f}°"))
    rows.append(("corners are off by (RMS)", f"{fit.rms:.2f} pixels", "", ""))
    degrees = np.rad2deg(turns_of(grips)[0])
    rows.append(("the hand's turns about three axes",
                 ", ".join(f"{x:.0f}°" for x in degrees), "", ""))  # fmt: skip
    overlays = {}
    for i in spread_out(len(shots.pictures)):
        picture, pixels = shots.pictures[i], shots.sights[i].pixels
        overlays[
            f"{picture.name}: rings are the {what}'s corners, crosses where the fit has them."
        ] = overlay(picture.rgb, pixels, pixels + fit.residuals[i], fit.used[i])
    eyes = grips @ fit.mount_from_camera if carried else fit.mount_from_camera[None]
    holders = np.eye(4)[None] if carried else grips
    edge = square(config.size_mm / 1000) if board is None else board.outline
    corners = np.stack([placed(pose @ fit.holder_from_target, edge) for pose in holders])
    shown = [eyes[i] for i in spread_out(len(eyes), DRAWN)]
    figures = {
        f"The camera around the robot's base, and where the {what} was.": space_figure(
            {config.view: shown}, {config.view: optics}, {what: corners}
        ),
        "What the fit leaves of each corner.": residual_figure(
            np.concatenate([s.pixels for s in shots.sights]), np.concatenate(fit.residuals),
            np.concatenate(fit.used), (optics.width, optics.height),
        ),
    }  # fmt: skip
    name = (
        board.words
        if board
        else f"tag {config.tag}, {config.family or '36h11'}, {config.size_mm:g} mm"
    )
    head = ("quantity", "value", "deviation", "rotation")
    return CalibrationPage(
        f"Hand and eye: {config.view}", f"{len(grips)} pictures of {name}", verdict, good, rows,
        head, notes + _notes(fit, grips), overlays, figures,
    )  # fmt: skip
