"""`python -m jaxcam.calibrate FORM …`: the forms by their settings."""

from collections.abc import Callable, Mapping
from typing import Any

from rich.console import Console

from jaxcam.config.calibrate import CalibrateConfig, HandEyeConfig, LensConfig, TagsConfig
from jaxcam.config.calibrate_arm import ArmConfig, DriftConfig
from jaxcam.robot.calibration.arm.form import calibrate_arm
from jaxcam.robot.calibration.drift.form import calibrate_drift
from jaxcam.robot.calibration.hand_eye.form import calibrate_hand_eye
from jaxcam.robot.calibration.lens.form import calibrate_lens
from jaxcam.robot.calibration.tags.form import calibrate_tags

FORMS: Mapping[type, Callable[[Any, Console], None]] = {
    LensConfig: calibrate_lens,
    TagsConfig: calibrate_tags,
    HandEyeConfig: calibrate_hand_eye,
    ArmConfig: calibrate_arm,
    DriftConfig: calibrate_drift,
}
"""What runs each form."""


def main(config: CalibrateConfig, console: Console) -> None:
    """Runs the command."""
    FORMS[type(config.form)](config.form, console)
