"""What a run ran on: packages, Python, system, devices, and the checkout's revision."""

import contextlib
import importlib.metadata
import logging
import os
import platform
import subprocess
from pathlib import Path

import jax

from jaxcam.files.paths import read_text
from jaxcam.files.whole import write_atomically

_log = logging.getLogger(__name__)

PACKAGES = ("jaxcam", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "numpy", "mujoco",
            "mujoco-mjx", "warp-lang", "robosuite")  # fmt: skip


def package_versions() -> dict[str, str]:
    """Versions of the packages that can change results; those not installed are left out."""
    versions = {}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def environment() -> dict[str, str]:
    """Packages, Python, system and devices, for the records of a run."""
    devices = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    system = {"python": platform.python_version(), "system": platform.platform()}
    return {**package_versions(), **system, "cores": str(os.cpu_count()), "devices": devices}


def record_environment(folder: Path) -> None:
    """Write down what a run is started on, in env.txt and git.txt; warn if env.txt had another.

    Args:
        folder: Of the run.
    """
    file = folder / "env.txt"
    text = "".join(f"{name} {value}\n" for name, value in environment().items())
    before = read_text(file, "replace") if file.exists() else text
    if before != text:
        _log.warning(
            "The environment changed, so results are not bit-exact: %s.",
            "; ".join(_changes(before, text)) or "its lines are in another order",
        )
    write_atomically(file, text)
    if revision := git_revision(Path(__file__)):
        write_atomically(folder / "git.txt", revision)


def _changes(before: str, now: str) -> list[str]:
    """What differs between two texts of `record_environment`: each old value and the new one."""
    then, today = (
        {line.partition(" ")[0]: line.partition(" ")[2] for line in text.splitlines()}
        for text in (before, now)
    )
    return [
        f"{name} {then.get(name, 'none')} -> {today.get(name, 'none')}"
        for name in sorted(then | today)
        if then.get(name) != today.get(name)
    ]


def git_revision(file: Path) -> str | None:
    """Commit and uncommitted changes of the checkout that a file belongs to; None if to none.

    Args:
        file: Of the code that runs. It may lie in someone else's checkout, which is then not it.
    """

    def git(*args: str) -> str:
        command = ["git", "-C", str(file.parent), *args]
        return subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=10
        ).stdout

    try:
        git("ls-files", "--error-unmatch", file.name)
        return git("rev-parse", "HEAD") + git("status", "--porcelain") + git("diff", "HEAD")
    except (OSError, subprocess.SubprocessError):
        return None
