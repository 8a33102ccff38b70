"""`python -m jaxcam.evaluate RUN…`: Evaluate runs on held-out initial states and camera poses."""

from jaxcam.config.commands import EvaluateConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(EvaluateConfig, "jaxcam.evaluation.run:main")

if __name__ == "__main__":
    COMMAND.run()
