"""Settings of the commands around training: report and check. Without JAX, so help is fast."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from jaxcam.fields import check_names, check_types, one_of


@dataclass(frozen=True)
class ReportConfig:
    """Compare runs with each other and with the paper: tables, figures and one HTML page."""

    runs: tyro.conf.Positional[tuple[str, ...]]
    """Run folders, folders of runs, or folders that this command wrote."""
    out: str = "report"
    """Folder to write."""
    split: Annotated[str, one_of("split")] = "test"
    """Which pairs: those kept for results, or those for choosing settings."""

    def __post_init__(self) -> None:
        check_types(self)
        check_names(self)


@dataclass(frozen=True)
class CheckConfig:
    """Check what training and evaluation rest on."""

    env: bool = False
    """Check this machine: packages, accelerator, Vulkan device, ManiSkill."""

    def __post_init__(self) -> None:
        check_types(self)
