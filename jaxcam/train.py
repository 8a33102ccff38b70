"""`python -m jaxcam.train`: from demonstrations to a report, in one go."""

from jaxcam.config.train import TrainConfig
from jaxcam.console.command import Command

COMMAND = Command(TrainConfig, "jaxcam.pipeline:main")

if __name__ == "__main__":
    COMMAND.run()
