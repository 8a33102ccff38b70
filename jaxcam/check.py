"""`python -m jaxcam.check DATASET|RUN|--env`: Find faults of a dataset, a run or this machine."""

from jaxcam.config.commands import CheckConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(CheckConfig, "jaxcam.checks.examine:main")

if __name__ == "__main__":
    COMMAND.run()
