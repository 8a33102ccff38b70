"""Importing is cheap, and nothing reaches for the network or for packages of an extra."""

import subprocess
import sys

import pytest

OPTIONAL = {"torch", "sapien", "mani_skill", "submitit", "wandb", "transformers"}

ARRAYS = (
    "import jaxcam.sim.actions, jaxcam.data.batches, jaxcam.models, jaxcam.training.state, "
    "jaxcam.results.stats"
)
SIMULATION = "import jaxcam.collect, jaxcam.evaluate, jaxcam.train, jaxcam.sim.tasks.lift"


SHOW = "\nimport sys; print(*{name.split('.')[0] for name in sys.modules})"


def loaded(code):
    """Top-level modules that a fresh interpreter has after running the code."""
    done = subprocess.run(
        [sys.executable, "-c", code + SHOW],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return set(done.stdout.split()), done


def test_settings_and_help_need_no_jax():
    modules, _ = loaded("import jaxcam.config.train, jaxcam.train")
    assert not modules & {"jax", "mujoco", "flax", "robosuite", "matplotlib", "numpy"}


NO_NETWORK = """
import socket
def refuse(*args, **kwargs):
    raise AssertionError("network")
socket.socket.connect = socket.create_connection = socket.getaddrinfo = refuse
"""


def test_the_whole_package_needs_no_extra_and_no_network():
    modules, done = loaded(f"{NO_NETWORK}\n{ARRAYS}\n{SIMULATION}")
    assert not modules & OPTIONAL
    assert done.stderr == ""  # neither robosuite nor Warp greets the user


@pytest.mark.parametrize("module", ["jaxcam", "jaxcam.errors"])
def test_light_modules_load_the_standard_library_only(module):
    modules, _ = loaded(f"import {module}")
    assert not modules & {"jax", "numpy", "rich", "tyro"}
