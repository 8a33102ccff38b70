"""`python -m jaxcam.calibrate lens|tags|hand-eye|arm|drift`: How cameras see, where they stand."""

from jaxcam.config.calibrate import CalibrateConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(CalibrateConfig, "jaxcam.robot.calibration.command:main")

if __name__ == "__main__":
    COMMAND.run()
