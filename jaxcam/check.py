"""`python -m jaxcam.check --env`: what this machine can run, what is missing and how to get it."""

from jaxcam.commands import CheckConfig
from jaxcam.fields import cli

if __name__ == "__main__":
    cli(CheckConfig)  # --help and bad flags are answered before the slow imports

import importlib.util
import platform
from collections.abc import Iterator
from importlib.metadata import version
from typing import NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxcam.errors import ConfigError, SimError, run_main
from jaxcam.presets import NAMES
from jaxcam.sim import make_task
from jaxcam.sim.maniskill import machine
from jaxcam.sim.maniskill.task import ManiSkillTask

EXTRAS = {
    "lerobot": ("pyarrow",),
    "smolvla": ("safetensors", "tokenizers"),
    "sweep": ("submitit",),
    "viz": ("viser",),
}
"""Modules that the small extras bring."""


class Finding(NamedTuple):
    """What was found of one thing."""

    what: str
    good: bool
    told: str
    remedy: str = ""
    """How to get what is missing."""


def check_env() -> Iterator[Finding]:
    """What of this machine matters, one by one; the last takes seconds."""
    names = ("jaxcam", "jax", "flax", "mujoco", "robosuite")
    told = ", ".join(f"{name} {version(name)}" for name in names)
    yield Finding("package", True, f"{told}, Python {platform.python_version()}")
    yield _accelerator()
    yield Finding("MuJoCo tasks", True, _tasks(False))
    for extra, modules in EXTRAS.items():
        missing = [name for name in modules if importlib.util.find_spec(name) is None]
        remedy = f"pip install 'jaxcam[{extra}]'" if missing else ""
        told = f"without {', '.join(missing)}" if missing else ", ".join(modules)
        yield Finding(f"extra {extra}", not missing, told, remedy)
    missing = machine.missing_packages()
    told = ", ".join(f"{name} {number}" for name, number in machine.versions().items())
    if missing:
        told = f"without {', '.join(missing)}"
    yield Finding("extra maniskill", not missing, told, machine.INSTALL if missing else "")
    if "sapien" in missing:
        yield Finding("Vulkan device", False, "not looked for: SAPIEN is missing")
    else:
        device = machine.device()
        remedy = "" if device.kind else machine.VULKAN
        yield Finding("Vulkan device", bool(device.kind), device.name, remedy)
    yield _maniskill()


def _accelerator() -> Finding:
    import jax

    backend = jax.default_backend()
    kinds = sorted({device.device_kind for device in jax.devices()})
    told = f"{backend}: {len(jax.devices())} x {', '.join(kinds)}"
    if backend == "cpu" and machine.has_nvidia():
        return Finding(
            "accelerator", False, f"{told}, though there is a GPU", "pip install 'jaxcam[cuda]'"
        )
    return Finding("accelerator", True, told if backend != "cpu" else f"{told} (none)")


def _maniskill() -> Finding:
    """Whether one of its worlds can be made here: that is what other processes will do."""
    task = next(t for t in map(make_task, NAMES["task"]) if isinstance(t, ManiSkillTask))
    try:
        task.require()
        from jaxcam.sim.maniskill.pool import pool_of

        about = pool_of(task.scene("fixed")).about
    except SimError as error:
        return Finding("ManiSkill tasks", False, str(error).splitlines()[0])
    steps = f"{about['control_hz']:g} control steps a second"
    return Finding("ManiSkill tasks", True, f"{_tasks(True)} ({steps})")


def _tasks(maniskill: bool) -> str:
    return ", ".join(
        name for name in NAMES["task"] if isinstance(make_task(name), ManiSkillTask) is maniskill
    )


def main() -> None:
    """The command line."""
    config = cli(CheckConfig)
    if not config.env:
        raise ConfigError("Nothing to check. Give --env to check this machine.")
    console = Console()
    table = Table("what", "", "found")
    found = []
    with console.status("looking"):
        for finding in check_env():
            found.append(finding)
            mark = Text("yes", "green") if finding.good else Text("no", "yellow")
            table.add_row(finding.what, mark, Text(finding.told))
    console.print(table)
    for finding in found:
        if finding.remedy:
            console.print(Text(f"{finding.what}: {finding.remedy}"), soft_wrap=True)
    console.print("The first three are all that the MuJoCo tasks need.")


if __name__ == "__main__":
    run_main(main)
