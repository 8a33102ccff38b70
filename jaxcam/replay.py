"""`python -m jaxcam.replay DATASET`: Count how many demonstrations succeed in each action space."""

from jaxcam.config.datasets import ReplayConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(ReplayConfig, "jaxcam.interop.replaying:main")

if __name__ == "__main__":
    COMMAND.run()
