"""`python -m jaxcam.robomimic FILE`: Import robomimic's demonstrations."""

from jaxcam.config.datasets import RobomimicConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(RobomimicConfig, "jaxcam.interop.robomimic:main")

if __name__ == "__main__":
    COMMAND.run()
