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
from typing import get_args

import jax

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.config.names import TaskName
from jaxcam.errors import SimError
from jaxcam.files.paths import home
from jaxcam.sim import make_task
from jaxcam.sim.maniskill import machine
from jaxcam.sim.maniskill.pool import pool_of
from jaxcam.sim.maniskill.scene import scene_of
from jaxcam.sim.maniskill.task import ManiSkillTask

EXTRAS = {
    "lerobot": ("pyarrow",),
    "smolvla": ("safetensors", "tokenizers"),
    "gym": ("gymnasium",),
    "sweep": ("submitit",),
    "tensorboard": ("tensorboardX",),
    "wandb": ("wandb",),
}
"""Modules that the small extras bring."""
YEAR = 2025
"""Before which no clock can be right: this version is younger."""


def check_env() -> Iterator[Finding]:
    """Findings on this machine, one after the other; the last takes seconds."""
    names = ("jaxcam", "jax", "flax", "mujoco", "robosuite")
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    yield good("package", got=f"{versions}, Python {platform.python_version()}")
    yield _accelerator()
    yield good("MuJoCo tasks", got=_tasks(False))
    yield check_host()
    for extra, modules in EXTRAS.items():
        missing = [name for name in modules if importlib.util.find_spec(name) is None]
        if missing:
            fix = f"pip install 'jaxcam[{extra}]'"
            yield note(f"extra {extra}", got=f"without {', '.join(missing)}", fix=fix)
        else:
            yield good(f"extra {extra}", got=", ".join(modules))
    yield from _maniskill()
    yield _maniskill_world()


def _accelerator() -> Finding:
    """What JAX computes on, and whether there is a GPU that it does not use."""
    backend = jax.default_backend()
    kinds = sorted({device.device_kind for device in jax.devices()})
    got = f"{backend}: {len(jax.devices())} x {', '.join(kinds)}"
    if backend == "cpu" and machine.has_nvidia():
        fix = "pip install 'jaxcam[cuda13]', or cuda12 for a driver before 580"
        return note("accelerator", got=f"{got}, though there is a GPU", fix=fix)
    return good("accelerator", got=got if backend != "cpu" else f"{got} (none)")


def check_host() -> Finding:
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
        return bad("host", got="; ".join(wrong), fix=" ".join(fixes))
    return good("host", got=f"clock, UTF-8, {tempfile.gettempdir()} and {_caches()}")


def _caches() -> Path:
    """Where compiled kernels of Warp go."""
    return Path(os.environ.get("WARP_CACHE_PATH") or home("~/.cache"))


def _unwritable(folder: Path) -> str:
    """Why nothing can be written to a folder, or below where it would be made."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            return ""
    except OSError as error:
        return str(error.strerror or error)


def _maniskill() -> Iterator[Finding]:
    """The extra's packages, and what its simulator can draw and compute with."""
    missing = machine.missing_packages()
    if missing:
        got = f"without {', '.join(missing)}"
        yield note("extra maniskill", got=got, fix=machine.INSTALL)
    else:
        versions = (f"{name} {number}" for name, number in machine.versions().items())
        yield good("extra maniskill", got=", ".join(versions))
    if "sapien" in missing:
        yield note("Vulkan device", got="not looked for: SAPIEN is missing")
        return
    device, card = machine.device(), machine.cuda()
    if device.kind:
        yield good("Vulkan device", got=device.name)
    else:
        yield note("Vulkan device", got=device.name, fix=machine.VULKAN)
    yield (good if card.kind else note)("ManiSkill on a card", got=card.name)


def _maniskill_world() -> Finding:
    """Whether one of its worlds can be made here: that is what other processes will do."""
    task = next(t for t in map(make_task, get_args(TaskName)) if isinstance(t, ManiSkillTask))
    try:
        task.require()
        about = pool_of(scene_of(task, "fixed")).about
    except SimError as error:
        return note("ManiSkill tasks", got=str(error).splitlines()[0])
    steps = f"{about['control_hz']:g} control steps a second"
    return good("ManiSkill tasks", got=f"{_tasks(True)} ({steps})")


def _tasks(maniskill: bool) -> str:
    return ", ".join(
        name
        for name in get_args(TaskName)
        if isinstance(make_task(name), ManiSkillTask) is maniskill
    )
