"""`python -m jaxcam.maniskill FILE.h5`: Import ManiSkill's trajectories."""

from jaxcam.config.datasets import ManiskillConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(ManiskillConfig, "jaxcam.interop.maniskill:main")

if __name__ == "__main__":
    COMMAND.run()
