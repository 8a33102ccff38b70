"""Fits that explain the pictures, and why others do not: what would, is tried."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from jaxcam.config.calibrate import HandEyeConfig, RotationForm
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.grips import COUNTS, GripNumbers
from jaxcam.interop.cameras.optics import Optics
from jaxcam.robot.calibration.hand_eye.fit import (
    ENOUGH,
    HandEyeFit,
    check_motions,
    fit_hand_eye,
    off_by,
    refine,
    turns_of,
)
from jaxcam.robot.calibration.hand_eye.shots import Shots
from jaxcam.robot.calibration.pose_page import OFF

UNKNOWN = 0.03, np.deg2rad(3.0)
"""Standard deviations (m, rad) from when on nothing is written."""
SCALE = 0.03
"""Share by which a target may look larger or smaller than it is said to be."""
MOST_STEPS = 8
"""Steps by which states may be late, that are tried."""
LATE = 0.25
"""Steps from when on a delay is worth a word."""


@dataclass(frozen=True)
class Delay:
    """By how much states are later than their pictures."""

    steps: float
    deviation: float
    rate: float
    """Steps a second."""
    fit: HandEyeFit

    @property
    def words(self) -> str:
        """It in words."""
        return (
            f"{abs(1000 * self.steps / self.rate):.0f} ms ({abs(self.steps):.1f} steps, ± "
            f"{max(self.deviation, 0.05):.1f}) {'later' if self.steps > 0 else 'earlier'}"
        )

    @property
    def flag(self) -> str:
        """What says it."""
        return f"--delay-ms {1000 * self.steps / self.rate:.0f}"


@dataclass(frozen=True)
class Case:
    """Shots, and what is taken for granted of them."""

    shots: Shots
    columns: GripNumbers
    optics: Optics
    delay: float
    """Steps."""
    rate: float
    """Steps a second."""

    @property
    def limit(self) -> float:
        """Residuals (pixels) of a fit that explains nothing."""
        return OFF * max(self.optics.width / 640, 0.5)

    @property
    def at_rest(self) -> "Case":
        """Without the pictures of a hand in motion, unless they are known to be in time."""
        return replace(self, shots=self.shots.some(~self.shots.moving))

    def fit(self) -> HandEyeFit:
        """The fit, whether it explains the pictures or not."""
        return fit_hand_eye(
            self.shots.carried(self.columns)(self.delay), self.shots.sights, self.optics, self.delay
        )

    def explains(self, fit: HandEyeFit) -> bool:
        """Whether it does."""
        return fit.rms < self.limit and fit.share > 0.7


def fit_shots(case: Case, config: HandEyeConfig) -> HandEyeFit:
    """The fit, if it explains the pictures.

    Args:
        case: The pictures.
        config: Settings.

    Raises:
        DatasetError: It does not; the message says what would, or what is lacking.
    """
    still = case.at_rest
    grips = still.shots.grips(case.columns)(case.delay)
    check_motions(grips)
    fit = still.fit()
    if not still.explains(fit):
        raise DatasetError(_why(case, fit, config))
    place, turn = fit.spread
    if place > UNKNOWN[0] or turn > UNKNOWN[1]:
        spreads, axes = turns_of(grips)
        raise DatasetError(
            f"These motions do not tell the camera's pose: it is sure to {1000 * place:.0f} mm and "
            f"{np.rad2deg(turn):.1f} degrees. The hand turns by "
            f"{', '.join(f'{x:.0f}' for x in np.rad2deg(spreads))} degrees about three axes; "
            f"lacking are turns about {np.round(axes[1], 1)} and {np.round(axes[2], 1)} of it."
        )
    _check_size(still, fit, config)
    return fit


def delay_of(case: Case, fit: HandEyeFit, *, refit: bool = False) -> Delay | None:
    """By how much states are later than pictures; None where the hand's motion does not tell.

    Args:
        case: The pictures, those of a hand in motion among them.
        fit: Of those of a hand at rest.
        refit: Whether that fit is wrong, and camera and target are looked for anew.
    """
    shots, optics = case.shots, case.optics
    if shots.moving.sum() < ENOUGH:
        return None
    late = shots.carried(case.columns)
    start, tried = (fit.mount_from_camera, fit.holder_from_target), {}
    for delay in case.delay + np.arange(-MOST_STEPS, MOST_STEPS + 0.1, 1 if refit else 0.5):
        if refit:
            own = refine(late, shots.sights, optics, start, near=delay)
            tried[delay] = own.median, (own.mount_from_camera, own.holder_from_target)
        else:
            tried[delay] = off_by(late(delay), shots.sights, optics, start), start
    near = min(tried, key=lambda delay: tried[delay][0])
    final = refine(late, shots.sights, optics, tried[near][1], "delay", float(near))
    deviation = float(np.sqrt(final.covariance[12, 12]))
    if not case.explains(final) or deviation > 1:
        return None
    return Delay(final.also, deviation, case.rate, final)


def is_late(delay: Delay | None, said: float) -> bool:
    """Whether a delay is another than the one that was said (steps)."""
    return delay is not None and abs(delay.steps - said) > max(LATE, 4 * delay.deviation)


def _check_size(case: Case, fit: HandEyeFit, config: HandEyeConfig) -> None:
    """Refuses a target that looks larger or smaller than the hand's motion allows."""
    start = fit.mount_from_camera, fit.holder_from_target
    carried = case.shots.carried(case.columns)(case.delay)
    scaled = refine(lambda _: carried, case.shots.sights, case.optics, start, "scale")
    off, deviation = scaled.also - 1, float(np.sqrt(scaled.covariance[12, 12]))
    if abs(off) > max(SCALE, 5 * deviation):
        raise DatasetError(_of_size(scaled.also, config))


def _of_size(scale: float, config: HandEyeConfig) -> str:
    if config.target == "tag":
        said, flag, what = config.size_mm, "--size-mm", "the side of the tag's black square"
    else:
        said, flag, what = config.square_mm, "--square-mm", "the side of a square of the board"
    return (
        f"{flag} {said:g} is {what}, but by the hand's motion it is {said * scale:.1f} mm. Measure "
        "it on the print, without the white margin; if it is right, the grip's position is not in "
        "metres, or its pose is not of the part that moves."
    )


def _why(case: Case, fit: HandEyeFit, config: HandEyeConfig) -> str:
    """Why the grip's poses do not explain the target's pictures."""
    words = (
        f"The grip's poses do not explain where the {_name(config)} is: half of the corners are "
        f"more than {fit.median:.1f} pixels off (expected below {case.limit:.1f})."
    )
    reason = next(_reasons(case, fit, config), "")
    return f"{words} {reason}" if reason else (
        f"{words} Likely causes: another --rotation or other columns (--grip-pose); a pose that is "
        "not of the part that moves with it; pictures and states that are not of one moment; the "
        f"{_name(config)} or the camera is loose; its size is not the one that was said."
    )  # fmt: skip


def _name(config: HandEyeConfig) -> str:
    return "tag" if config.target == "tag" else "board"


def _reasons(case: Case, fit: HandEyeFit, config: HandEyeConfig) -> Iterator[str]:
    """What would explain the pictures, as far as something does."""
    still, columns = case.at_rest, case.columns
    start = fit.mount_from_camera, fit.holder_from_target
    carried = still.shots.carried(columns)(case.delay)
    scaled = refine(lambda _: carried, still.shots.sights, case.optics, start, "scale")
    if case.explains(scaled) and 0.1 < scaled.also < 10:
        yield _of_size(scaled.also, config)
    for form in get_args(RotationForm):
        if COUNTS.get(form) == len(columns.rotation) and form != columns.form:
            other = _explaining(replace(still, columns=replace(columns, form=form)))
            if other:
                yield f"With --rotation {form} they do ({other.rms:.1f} pixels)."
    mounts = {True: "--mount grip", False: "--mount fixed"}
    turned = replace(still.shots, on_hand=not still.shots.on_hand)
    if other := _explaining(replace(still, shots=turned)):
        yield (
            f"With {mounts[turned.on_hand]} they do ({other.rms:.1f} pixels): "
            + ("the hand carries the camera." if turned.on_hand else "the camera stands.")
        )
    delay = delay_of(case, fit, refit=True)
    if delay and is_late(delay, case.delay):
        yield (
            f"States are {delay.words} than their pictures: with {delay.flag} they do "
            f"({delay.fit.rms:.1f} pixels). Correct the recording if you can: a policy that "
            "learns from it learns that delay."
        )
    for number in np.unique(still.shots.episodes)[1:]:
        parts = still.shots.episodes < number, still.shots.episodes >= number
        if min(part.sum() for part in parts) < ENOUGH:
            continue
        if all(_explaining(replace(still, shots=still.shots.some(part))) for part in parts):
            yield (
                f"Episodes before {number} and those from {number} on agree among themselves: the "
                f"camera, or the {_name(config)}, moved between them. Calibrate each part alone."
            )


def _explaining(case: Case) -> HandEyeFit | None:
    try:
        fit = case.fit()
    except DatasetError:
        return None
    return fit if case.explains(fit) else None
