"""`python -m jaxcam.collect`: demonstrations of the scripted expert, as states and commands."""

from jaxcam.config.datasets import CollectConfig
from jaxcam.console.command import Command

COMMAND = Command(CollectConfig, "jaxcam.data.collection:main")

if __name__ == "__main__":
    COMMAND.run()
