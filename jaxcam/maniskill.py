"""`python -m jaxcam.maniskill FILE.h5`: ManiSkill's trajectories as a jaxcam dataset."""

from jaxcam.config.datasets import ManiskillConfig
from jaxcam.console.command import Command

COMMAND = Command(ManiskillConfig, "jaxcam.interop.maniskill:main")

if __name__ == "__main__":
    COMMAND.run()
