"""`python -m jaxcam.trial SHEET.yaml`: Try policies on a robot, blinded and in random order."""

from jaxcam.config.commands import TrialConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(TrialConfig, "jaxcam.robot.trials.run:main")

if __name__ == "__main__":
    COMMAND.run()
