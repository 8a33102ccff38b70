"""Importing is cheap, and nothing reaches for the network or for packages of an extra."""

import ast
import subprocess
import sys

import pytest
from places import REPO, TESTS

OPTIONAL = {"torch", "sapien", "mani_skill", "submitit", "wandb", "transformers"}
SIMULATORS = {"mujoco", "robosuite", "numba", "warp", "sapien", "mani_skill", "torch"}
SHOW = "\nimport sys; print(*{name.split('.')[0] for name in sys.modules}, sep='\\n')"


def loaded(code, *argv):
    """Top-level modules that a fresh interpreter has after running the code, and its errors."""
    done = subprocess.run(
        [sys.executable, "-c", code + SHOW, *map(str, argv)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return set(done.stdout.splitlines()), done.stderr


def test_settings_and_help_need_no_jax():
    modules, _ = loaded("import jaxcam.config.train, jaxcam.train")
    assert not modules & {"jax", "mujoco", "flax", "robosuite", "matplotlib", "numpy"}


NO_NETWORK = """
import socket
def refuse(*args, **kwargs):
    raise AssertionError("network")
socket.socket.connect = socket.create_connection = socket.getaddrinfo = refuse
"""
WHOLE = """
import jaxcam, pkgutil, importlib
# These are loaded in a process of their own.
MANISKILL = [f"jaxcam.sim.maniskill.{name}" for name in ("envs", "scenery", "worker")]
for module in pkgutil.walk_packages(jaxcam.__path__, "jaxcam."):
    if module.name not in ("jaxcam.__main__", *MANISKILL):
        importlib.import_module(module.name)
"""


def test_the_whole_package_needs_no_extra_and_no_network():
    modules, errors = loaded(NO_NETWORK + WHOLE)
    assert "mujoco" in modules
    assert not modules & OPTIONAL
    assert errors == ""  # neither robosuite nor Warp greets the user


WITHOUT = """
import sys
from importlib import import_module
extras = "pyarrow safetensors tokenizers submitit tensorboardX wandb viser"
sys.modules |= dict.fromkeys(extras.split())  # None: as if they were not installed
from jaxcam.__main__ import NAMES
from jaxcam.errors import ConfigError
for name in NAMES:
    module = import_module(f"jaxcam.{name}").COMMAND.main.partition(":")[0]
    try:
        import_module(module)
    except ConfigError as error:
        sys.stderr.write(f"{name}: {error}\\n")
"""


def test_without_extras_each_command_runs_but_those_that_are_for_an_extra():
    _, errors = loaded(WITHOUT)
    assert errors.splitlines() == [
        "view: This needs viser: pip install 'jaxcam[viz]'.",
        "lerobot: This needs pyarrow: pip install 'jaxcam[lerobot]'.",
    ]


def test_a_lerobot_dataset_without_its_extra_is_told_how_to_get_it(tmp_path):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("{}")
    code = """
import sys
sys.modules["pyarrow"] = None
from pathlib import Path
from jaxcam.interop.recordings import read_recording
try:
    read_recording(Path(sys.argv[1]))
except Exception as error:
    sys.stderr.write(f"{type(error).__name__}: {error}")
"""
    _, errors = loaded(code, tmp_path)
    assert errors == "ConfigError: This needs pyarrow: pip install 'jaxcam[lerobot]'."


@pytest.mark.parametrize("module", ["jaxcam", "jaxcam.errors"])
def test_light_modules_load_the_standard_library_only(module):
    modules, _ = loaded(f"import {module}")
    assert not modules & {"jax", "numpy", "rich", "tyro"}


def test_settings_in_full_load_no_simulator():
    modules, _ = loaded(
        "from jaxcam.config.train import TrainConfig\n"
        "from jaxcam.runs.identity import resolve\n"
        "assert resolve(TrainConfig(task='square'), accelerator=False).n == 4"
    )
    assert not modules & SIMULATORS


def test_grids_load_no_simulator():
    modules, _ = loaded(
        "import sys; from jaxcam.runs.grid import read_grid; read_grid(sys.argv[1])",
        REPO / "grids" / "laptop" / "lift.yaml",
    )
    assert not modules & SIMULATORS


def test_a_report_loads_no_simulator(tmp_path):
    modules, _ = loaded(
        "import sys, jaxcam.report\n"
        "try: jaxcam.report.COMMAND.run(sys.argv[1:])\n"
        "except SystemExit as ended: assert not ended.code, ended.code",
        REPO / "results" / "lift", "--out", tmp_path / "report",
    )  # fmt: skip
    assert (tmp_path / "report" / "report.md").exists()
    assert not modules & SIMULATORS


def test_tests_are_collected_without_what_python_3_13_lacks():
    """Two that imported PyTorch ended the whole run where `jaxcam[maniskill]` brings nothing."""
    lacking = {"torch", "sapien", "mani_skill"}
    collected = [*TESTS.rglob("test_*.py"), *TESTS.rglob("conftest.py")]
    imported = {
        f"{file.relative_to(TESTS)}: {name}"
        for file in collected
        for node in ast.parse(file.read_text("utf-8")).body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in (a.name.partition(".")[0] for a in node.names)
        if name in lacking or (getattr(node, "module", None) or "").partition(".")[0] in lacking
    }
    assert imported == set()
