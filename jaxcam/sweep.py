"""`python -m jaxcam.sweep GRID.yaml`: Train and evaluate all runs of a grid."""

from jaxcam.config.commands import SweepConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(SweepConfig, "jaxcam.runs.sweep:main")

if __name__ == "__main__":
    COMMAND.run()
