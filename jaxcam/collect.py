"""`python -m jaxcam.collect`: Collect demonstrations of the scripted expert."""

from jaxcam.config.datasets import CollectConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(CollectConfig, "jaxcam.data.collection:main")

if __name__ == "__main__":
    COMMAND.run()
