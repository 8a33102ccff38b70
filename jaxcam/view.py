"""`python -m jaxcam.view DATASET|RUN|CAMERAS.json`: See robots, cameras and rays in a browser."""

from jaxcam.config.commands import ViewConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(ViewConfig, "jaxcam.viewer.command:main")

if __name__ == "__main__":
    COMMAND.run()
