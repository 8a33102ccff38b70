"""`python -m jaxcam.serve RUN`: Let robots and others ask a run's policy over a socket."""

from jaxcam.config.serve import ServeConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(ServeConfig, "jaxcam.robot.serving:main")

if __name__ == "__main__":
    COMMAND.run()
