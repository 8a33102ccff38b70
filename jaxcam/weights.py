"""`python -m jaxcam.weights FILE|RUN`: weights of others, and ours for LeRobot."""

from jaxcam.config.commands import WeightsConfig
from jaxcam.console.command import Command

COMMAND = Command(WeightsConfig, "jaxcam.interop.weights:main")

if __name__ == "__main__":
    COMMAND.run()
