"""`python -m jaxcam.train`: Train a policy, evaluate it on unseen cameras, and report."""

from jaxcam.config.train import TrainConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(TrainConfig, "jaxcam.pipeline:main")

if __name__ == "__main__":
    COMMAND.run()
