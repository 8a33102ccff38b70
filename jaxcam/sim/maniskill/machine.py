"""What a machine needs to run the ManiSkill tasks, and whether it has it.

Nothing is imported here that could fail: SAPIEN is tried out in a process of its own.
"""

import functools
import glob
import importlib.util
import os
import subprocess
import sys
from importlib.metadata import version
from typing import NamedTuple, Self

from jaxcam.errors import SimError

PACKAGES = {
    "mani_skill": "mani-skill",
    "sapien": "sapien",
    "torch": "torch",
    "trimesh": "trimesh",
    "pyfqmr": "pyfqmr",
}
"""Modules of the extra, and the distributions they come from."""
INSTALL = "pip install 'jaxcam[maniskill]'"
VULKAN = """Without a graphics card, Mesa's software driver lavapipe (24.3 or newer) will do:
  Debian 12:          add the suite bookworm-backports, then as root
                      apt-get install -t bookworm-backports mesa-vulkan-drivers libvulkan1
  Debian 13, Ubuntu 25.04 or newer:
                      apt-get install mesa-vulkan-drivers libvulkan1
With an NVIDIA card, its driver brings Vulkan; containers need NVIDIA_DRIVER_CAPABILITIES=all."""
"""How to get a Vulkan device."""
ICD_VARIABLES = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")
_LAVAPIPE = ("/usr/share/vulkan/icd.d/lvp_icd*.json", "/etc/vulkan/icd.d/lvp_icd*.json")
DRAWING = """
import sapien, sapien.render
device = sapien.Device({name!r})
sapien.render.RenderSystem(device)
print(sapien.render.get_device_summary().split("GPU: ")[1].splitlines()[0])
"""
SIMULATING = """
import sapien, torch
assert torch.cuda.is_available(), "PyTorch " + torch.__version__ + " sees no CUDA"
sapien.physx.enable_gpu()
sapien.physx.PhysxGpuSystem("cuda")
print(torch.cuda.get_device_name())
"""
_PATIENCE = 120


class Device(NamedTuple):
    """What SAPIEN draws or simulates with."""

    kind: str
    """ManiSkill's `gpu` or `cpu`; empty if there is none."""
    name: str
    """The driver's name of it, or what went wrong."""

    @classmethod
    def tried(cls, kind: str, code: str) -> Self:
        """Tries code in a process of its own, which prints the device's name."""
        try:
            done = subprocess.run(
                [sys.executable, "-c", code],
                capture_output=True, text=True, env=child_environment(),
                timeout=_PATIENCE, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return cls("", f"no answer within {_PATIENCE} s")
        lines = (done.stderr if done.returncode else done.stdout).strip().splitlines()
        name = lines[-1] if lines else f"SAPIEN ended with exit code {done.returncode}"
        return cls("" if done.returncode else kind, name)


def missing_packages() -> list[str]:
    """Distributions of the extra that are not installed."""
    return [name for module, name in PACKAGES.items() if importlib.util.find_spec(module) is None]


def versions() -> dict[str, str]:
    """Versions of the distributions of the extra that are installed."""
    return {name: version(name) for name in PACKAGES.values() if name not in missing_packages()}


def child_environment() -> dict[str, str]:
    """Environment of the processes that load SAPIEN.

    Without an NVIDIA card Vulkan is pointed to lavapipe alone, unless the user points it elsewhere:
    the loader would try every driver that is installed. Each process draws in one thread.
    """
    env = {"LP_NUM_THREADS": "0", "OMP_NUM_THREADS": "1", **os.environ}
    drivers = sorted(path for pattern in _LAVAPIPE for path in glob.glob(pattern))
    if drivers and not has_nvidia() and not any(name in env for name in ICD_VARIABLES):
        env["VK_ICD_FILENAMES"] = drivers[0]
    return env


def has_nvidia() -> bool:
    """Whether there is an NVIDIA card with its driver."""
    return bool(glob.glob("/dev/nvidia[0-9]*")) or os.path.exists("/dev/dxg")


@functools.cache
def device() -> Device:
    """What SAPIEN can draw with here: an NVIDIA card, else a processor, else nothing."""
    card = Device.tried("gpu", DRAWING.format(name="cuda")) if has_nvidia() else Device("", "")
    return card if card.kind else Device.tried("cpu", DRAWING.format(name="cpu"))


@functools.cache
def cuda() -> Device:
    """The card that ManiSkill simulates and draws on; without one its `kind` is empty.

    SAPIEN downloads PhysX's library for cards when it is first asked for.
    """
    if not has_nvidia():
        return Device("", "there is no NVIDIA card with its driver")
    if device().kind != "gpu":
        return Device("", f"SAPIEN cannot draw on the card ({device().name})")
    return Device.tried("gpu", SIMULATING)


def has_accelerator() -> bool:
    """Whether ManiSkill can simulate on a card here, see `cuda`."""
    return bool(cuda().kind)


def require() -> None:
    """Makes sure that ManiSkill can be run and can draw.

    Raises:
        SimError: If not; the message says what is missing and how to get it.
    """
    hint = "`python -m jaxcam.check --env` says more. The MuJoCo tasks do not need it."
    if sys.platform != "linux":
        raise SimError(f"The ManiSkill tasks run on Linux, this is {sys.platform}. {hint}")
    missing = missing_packages()
    if missing:
        raise SimError(
            f"This task runs in ManiSkill, but {', '.join(missing)} cannot be imported. Install: "
            f"{INSTALL}. {hint}"
        )
    if not device().kind:
        raise SimError(
            f"SAPIEN found no Vulkan device to draw with ({device().name}).\n{VULKAN}\n{hint}"
        )


def require_cuda() -> None:
    """Makes sure that ManiSkill can simulate on a card.

    Raises:
        SimError: If not; the message says why.
    """
    require()
    if not cuda().kind:
        raise SimError(
            f"The engine sapien-gpu simulates on an NVIDIA card, but {cuda().name}. The engine "
            "sapien does without."
        )
