"""`python -m jaxcam.check DATASET|RUN|--env`: the doctor of datasets, runs and machines."""

from jaxcam.config.commands import CheckConfig
from jaxcam.console.command import Command

COMMAND = Command(CheckConfig, "jaxcam.checks.examine:main")

if __name__ == "__main__":
    COMMAND.run()
