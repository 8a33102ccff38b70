"""`python -m jaxcam.report RUN…`: Compare runs with each other and with the paper."""

from jaxcam.config.commands import ReportConfig
from jaxcam.console.command import CommandLine

COMMAND = CommandLine(ReportConfig, "jaxcam.reports.comparison:main")

if __name__ == "__main__":
    COMMAND.run()
