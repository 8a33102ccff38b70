"""What a run ran on: packages, Python, system, devices, and the checkout's revision."""

import contextlib
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

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
    import jax

    devices = ", ".join(f"{d.platform} {d.device_kind}" for d in jax.devices())
    system = {"python": platform.python_version(), "system": platform.platform()}
    return {**package_versions(), **system, "cores": str(os.cpu_count()), "devices": devices}


def git_revision() -> str | None:
    """Commit and uncommitted changes of the checkout jaxcam runs from, or None if it is none."""
    here = Path(__file__)

    def git(*args: str) -> str:
        command = ["git", "-C", str(here.parent), *args]
        return subprocess.run(
            command, capture_output=True, text=True, check=True, timeout=10
        ).stdout

    try:
        git("ls-files", "--error-unmatch", here.name)  # Else the checkout is someone else's.
        return git("rev-parse", "HEAD") + git("status", "--porcelain") + git("diff", "HEAD")
    except (OSError, subprocess.SubprocessError):
        return None
