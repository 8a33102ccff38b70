"""`calibrate arm`: from a robot's own motion to a camera's pose in the file of calibrations."""

from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.calibrate_arm import ArmConfig
from jaxcam.data.recorded.recording import Recording
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.writing import (
    Changes,
    check_updatable,
    overruled,
    pose_json,
    update_cameras,
)
from jaxcam.interop.recordings import read_recording
from jaxcam.robot.calibration.arm.fit import ArmFit, fit_arm
from jaxcam.robot.calibration.arm.joints import JointNumbers, joint_numbers
from jaxcam.robot.calibration.arm.model import ArmModel, load_arm
from jaxcam.robot.calibration.arm.shooting import optics_for, read_masks, take_film
from jaxcam.robot.calibration.arm.showing import contour_overlays, edge_figure
from jaxcam.robot.calibration.figures import space_figure
from jaxcam.robot.calibration.known import not_used_note, require_view
from jaxcam.robot.calibration.page import (
    CalibrationPage,
    page_path,
    show_calibration,
    spread_out,
)
from jaxcam.robot.calibration.pose_page import overruled_note, pose_verdict

FEW = 4
"""Episodes below which more are advised."""
BENT = np.deg2rad(0.6)
"""A joint's fault (rad) from when on it is worth saying."""


def calibrate_arm(config: ArmConfig, console: Console) -> None:
    """Runs the form; see `ArmConfig`.

    Raises:
        ConfigError: Settings do not go together, or the state does not say the joints.
        DatasetError: The pictures or the motion do not tell the pose.
    """
    cameras = absolute(config.cameras)
    check_updatable(cameras)
    path = page_path(config.out, cameras, "arm", config.view)
    recording = read_recording(absolute(config.dataset))
    require_view(config.view, recording)
    columns = joint_numbers(recording, config.joints, config.opening)
    masks = read_masks(absolute(config.masks)) if config.masks else None
    optics = optics_for(recording, config.view, cameras)
    arm = arm_for(config.robot, columns)
    with console.status("taking pictures"):
        which = _episodes(recording, config, masks)
        film = take_film(recording, config.view, columns, optics, which, config.most, masks)
    with console.status("calibrating"):
        fit = fit_arm(arm, film)
    about = {"pose": {"by": "arm", **_about(fit)}}
    entries = pose_json(fit.base_from_camera)
    update_cameras(cameras, Changes({config.view: entries}, about={config.view: about}))
    others = overruled(cameras, config.view)
    notes = [overruled_note(config.view, others)] if others else []
    notes += filter(None, [not_used_note(recording, config.view, cameras)])
    page = arm_page(config, arm, fit, notes + _notes(fit))
    show_calibration(page, path, console, f"{cameras}: pose of view {config.view}.")


def arm_for(robot: str, columns: JointNumbers) -> ArmModel:
    """The arm's model, without fingers where nobody says how far they are open.

    Args:
        robot: `panda`, or a file.
        columns: Which numbers of the state are joints.

    Raises:
        ConfigError: The model cannot be read, or has another number of joints.
    """
    arm = load_arm(robot, fingers=columns.opening is not None)
    if arm.joints != len(columns.angles):
        raise ConfigError(
            f"--robot {robot} has {arm.joints} joints, the state has {len(columns.angles)} joint "
            f"angles (columns {', '.join(map(str, columns.angles))}). Name those of this arm with "
            "--joints."
        )
    return arm


def _episodes(
    recording: Recording, config: ArmConfig, masks: dict[tuple[int, int], np.ndarray] | None
) -> list[int]:
    numbers = [i for i, e in enumerate(recording.episodes) if config.view in e.sights]
    if masks is not None:
        numbers = [i for i in numbers if any(e == i for e, _ in masks)]
        if not numbers:
            raise DatasetError(
                f"--masks {Path(config.masks).name}: of no episode that view '{config.view}' saw."
            )
    return [numbers[i] for i in spread_out(len(numbers), config.episodes)]


def _about(fit: ArmFit) -> dict[str, object]:
    place, turn = fit.refined.spread
    solution = fit.refined.solution
    return {
        "deviation_mm": round(1000 * place, 2),
        "deviation_deg": round(float(np.rad2deg(turn)), 3),
        "off_pixels": round(fit.refined.typical, 3),
        "pictures": len(fit.film.rgb),
        "episodes": len(np.unique(fit.film.episodes)),
        "joint_faults_deg": np.rad2deg(solution.joints).round(3).tolist(),
        "pictures_late_s": round(solution.lag, 4),
    }


def _notes(fit: ArmFit) -> list[str]:
    notes = []
    episodes = len(np.unique(fit.film.episodes))
    if episodes < FEW:
        notes.append(f"From {episodes} episodes: use 8, in which the arm moves differently.")
    if fit.late is not None:
        when = "later" if fit.late > 0 else "earlier"
        notes.append(
            f"Joint states are out of sync with pictures: pictures are {abs(fit.late):.3f} s "
            f"{when} than the states beside them. The pose allows for it; a policy does not."
        )
    joints = fit.refined.solution.joints
    odd = [f"{i + 1} by {np.rad2deg(x):.1f}" for i, x in enumerate(joints) if abs(x) > BENT]
    if odd:
        notes.append(f"Joints seem to be off: {', '.join(odd)} degrees. Another tool on the hand, "
                     "or another model of the arm, looks like that, too.")  # fmt: skip
    return notes


def arm_page(config: ArmConfig, arm: ArmModel, fit: ArmFit, notes: list[str]) -> CalibrationPage:
    """The page of a calibration by the arm.

    Args:
        config: Settings.
        arm: The robot.
        fit: The result.
        notes: What else is to be said.
    """
    refined, film = fit.refined, fit.film
    place, turn = refined.spread
    verdict, good = pose_verdict({config.view: refined.spread}, _BETTER)
    position = ", ".join(f"{x:.4f}" for x in fit.base_from_camera[:3, 3])
    faults = ", ".join(f"{x:+.2f}" for x in np.rad2deg(refined.solution.joints))
    rows = [
        ("camera in the base frame (m)", position,
         f"{1000 * place:.1f} mm, {np.rad2deg(turn):.2f}°"),
        ("edges are off by (median)", f"{refined.typical:.2f} pixels", ""),
        ("share of the contour that lies on edges", f"{fit.support:.0%}", ""),
        ("faults of the joints, as fitted (degrees)", faults, ""),
        ("pictures later than states by", f"{1000 * refined.solution.lag:.0f} ms",
         f"{1000 * refined.lag_sigma:.0f} ms"),
    ]  # fmt: skip
    way = arm.poses(film.angles, film.opening)[:, -1, :3, 3]
    diamond = 0.01 * np.array([[-1, 0, 0], [0, 0, -1], [1, 0, 0], [0, 0, 1]])
    hands = way[:, None] + diamond
    optics = film.optics
    figures = {
        "The camera around the robot's base, and where the last link was.": space_figure(
            {config.view: [fit.base_from_camera]}, {config.view: optics}, {"hand": hands}
        ),
        "What the fit leaves between contours and edges.": edge_figure(refined),
    }
    subtitle = (
        f"{len(film.rgb)} pictures of {len(np.unique(film.episodes))} episodes, robot "
        f"{Path(config.robot).name}"
    )
    return CalibrationPage(
        f"The arm: {config.view}", subtitle, verdict, good, rows, notes=notes,
        overlays=contour_overlays(refined, film), figures=figures,
    )  # fmt: skip


_BETTER = "More episodes in which the arm moves differently, or larger pictures, make it better."
