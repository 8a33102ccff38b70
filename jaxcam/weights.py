"""`python -m jaxcam.weights FILE|RUN`: Look at a file of weights; convert policies for LeRobot."""

from jaxcam.config.commands import WeightsConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(WeightsConfig, "jaxcam.interop.weights:main")

if __name__ == "__main__":
    COMMAND.run()
