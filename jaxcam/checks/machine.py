"""What this machine can run, what is missing and how to get it."""

import importlib.util
import locale
import os
import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from jaxcam.checks.findings import Finding
from jaxcam.config.presets import NAMES
from jaxcam.errors import SimError
from jaxcam.sim import make_task
from jaxcam.sim.maniskill import machine
from jaxcam.sim.maniskill.task import ManiSkillTask

EXTRAS = {
    "lerobot": ("pyarrow",),
    "smolvla": ("safetensors", "tokenizers"),
    "sweep": ("submitit",),
    "tensorboard": ("tensorboardX",),
    "wandb": ("wandb",),
}
"""Modules that the small extras bring."""
YEAR = 2025
"""Before which no clock can be right: this version is younger."""


def check_env() -> Iterator[Finding]:
    """What of this machine matters, one by one; the last takes seconds."""
    names = ("jaxcam", "jax", "flax", "mujoco", "robosuite")
    told = ", ".join(f"{name} {version(name)}" for name in names)
    yield Finding("package", "good", f"{told}, Python {platform.python_version()}")
    yield _accelerator()
    yield Finding("MuJoCo tasks", "good", _tasks(False))
    yield _host()
    for extra, modules in EXTRAS.items():
        missing = [name for name in modules if importlib.util.find_spec(name) is None]
        if missing:
            fix = f"pip install 'jaxcam[{extra}]'"
            yield Finding(f"extra {extra}", "note", f"without {', '.join(missing)}", fix=fix)
        else:
            yield Finding(f"extra {extra}", "good", ", ".join(modules))
    missing = machine.missing_packages()
    told = ", ".join(f"{name} {number}" for name, number in machine.versions().items())
    if missing:
        told = f"without {', '.join(missing)}"
    fix = machine.INSTALL if missing else ""
    yield Finding("extra maniskill", "note" if missing else "good", told, fix=fix)
    if "sapien" in missing:
        yield Finding("Vulkan device", "note", "not looked for: SAPIEN is missing")
    else:
        device = machine.device()
        fix = "" if device.kind else machine.VULKAN
        yield Finding("Vulkan device", "good" if device.kind else "note", device.name, fix=fix)
        card = machine.cuda()
        yield Finding("ManiSkill on a card", "good" if card.kind else "note", card.name)
    yield _maniskill()


def _accelerator() -> Finding:
    import jax

    backend = jax.default_backend()
    kinds = sorted({device.device_kind for device in jax.devices()})
    told = f"{backend}: {len(jax.devices())} x {', '.join(kinds)}"
    if backend == "cpu" and machine.has_nvidia():
        fix = "pip install 'jaxcam[cuda13]', or cuda12 for a driver before 580"
        return Finding("accelerator", "note", f"{told}, though there is a GPU", fix=fix)
    return Finding("accelerator", "good", told if backend != "cpu" else f"{told} (none)")


def _host() -> Finding:
    """Clock, file names, and folders that caches and processes write to."""
    wrong, fixes = [], []
    if time.localtime().tm_year < YEAR:
        wrong.append(f"the clock says {time.localtime().tm_year}")
        fixes.append("Set the clock: files are told apart by time, downloads by certificates.")
    if sys.getfilesystemencoding() != "utf-8":
        wrong.append(f"file names are {sys.getfilesystemencoding()} ({locale.getlocale()[0]})")
        fixes.append("Set PYTHONUTF8=1 or LANG=C.UTF-8.")
    for folder, variable in (
        (Path(tempfile.gettempdir()), "TMPDIR"),
        (_caches(), "WARP_CACHE_PATH and NUMBA_CACHE_DIR"),
    ):
        if why := _unwritable(folder):
            wrong.append(f"{folder}: {why}")
            fixes.append(f"Set {variable} to a folder that can be written.")
    if wrong:
        return Finding("host", "bad", "; ".join(wrong), fix=" ".join(fixes))
    return Finding("host", "good", f"clock, UTF-8, {tempfile.gettempdir()} and {_caches()}")


def _caches() -> Path:
    """Where compiled kernels of Warp go."""
    return Path(os.environ.get("WARP_CACHE_PATH") or Path.home() / ".cache")


def _unwritable(folder: Path) -> str:
    """Why nothing can be written to a folder, or below where it would be made."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return str(error.strerror or error)


def _maniskill() -> Finding:
    """Whether one of its worlds can be made here: that is what other processes will do."""
    task = next(t for t in map(make_task, NAMES["task"]) if isinstance(t, ManiSkillTask))
    try:
        task.require()
        from jaxcam.sim.maniskill.pool import pool_of

        about = pool_of(task.scene("fixed")).about
    except SimError as error:
        return Finding("ManiSkill tasks", "note", str(error).splitlines()[0])
    steps = f"{about['control_hz']:g} control steps a second"
    return Finding("ManiSkill tasks", "good", f"{_tasks(True)} ({steps})")


def _tasks(maniskill: bool) -> str:
    return ", ".join(
        name for name in NAMES["task"] if isinstance(make_task(name), ManiSkillTask) is maniskill
    )
