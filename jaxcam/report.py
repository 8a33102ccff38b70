"""`python -m jaxcam.report RUNS…`: many runs beside the paper, as Markdown, LaTeX, CSV and HTML."""

from jaxcam.config.commands import ReportConfig
from jaxcam.console.command import Command

COMMAND = Command(ReportConfig, "jaxcam.reports.comparison:main")

if __name__ == "__main__":
    COMMAND.run()
