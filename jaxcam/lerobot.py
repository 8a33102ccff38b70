"""`python -m jaxcam.lerobot DATASET OUT`: Export a dataset in LeRobot's v3 format."""

from jaxcam.config.datasets import LerobotConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(LerobotConfig, "jaxcam.interop.lerobot.dataset:main")

if __name__ == "__main__":
    COMMAND.run()
