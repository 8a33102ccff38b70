"""Shared fixtures: Lift's scenes, a tiny dataset collected once per session, and ManiSkill.

Fixtures import what they need: most tests need neither JAX nor a simulator.
"""

import atexit
import gc
import importlib
import os
import shutil
import sys
import tempfile
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" not in os.environ:  # workers inherit it
    session = tempfile.mkdtemp(prefix="jaxcam-tests-")
    atexit.register(shutil.rmtree, session, ignore_errors=True)
    os.environ["JAXCAM_TESTS"] = session
session = Path(os.environ["JAXCAM_TESTS"])
os.environ["JAXCAM_CACHE"] = str(session / os.environ.get("PYTEST_XDIST_WORKER", "cache"))
"""Tests neither see nor change how long jobs took on this machine."""
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # What one worker or command has compiled, the others of the session load.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(session / "compiled")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
# Tests compile far longer than they run. Newer ones have no flag for the emitters.
flags = ["--xla_backend_optimization_level=0", os.environ.get("XLA_FLAGS", "")]
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 12):
    flags.insert(0, "--xla_cpu_use_fusion_emitters=false")
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["XLA_FLAGS"] = " ".join(flags)
TINY = {"demos": 4, "validation": 2}
"""Settings of the session's dataset."""
PIXELS = 24
"""Side of its pictures."""
GROWN = 2**27
"""Bytes by which tests have grown the process when it is tidied."""


def resident():
    """Bytes of memory that this process has; without end where the system does not say."""
    file = Path("/proc/self/statm")
    return int(file.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if file.exists() else 2**63


def process():
    """The process's folder, and how this thread is scheduled where systems say so."""
    scheduled = os.sched_getscheduler(0) if hasattr(os, "sched_getscheduler") else None
    return os.getcwd(), scheduled


@pytest.fixture(scope="session")
def tidied():
    """How much memory the process had when it was tidied last, in a list of one number."""
    return [resident()]


@pytest.fixture(autouse=True, scope="module")
def _compiled_programs_are_let_go(tidied):
    """What a file of tests compiled is of no use to the next, and would fill the memory."""
    yield
    # Looking for what nobody uses takes a second, so it must be worth it.
    if "jax" in sys.modules and resident() - tidied[0] >= GROWN:
        sys.modules["jax"].clear_caches()
        gc.collect()
        tidied[0] = resident()


@pytest.fixture(autouse=True, scope="module")
def _the_process_stays_as_it_was():
    """A folder or a priority that a file of tests leaves behind would be that of all children."""
    before = process()
    yield
    assert process() == before


@pytest.fixture(scope="session")
def lift():
    from jaxcam.sim.tasks.lift import Lift

    return Lift()


@pytest.fixture(scope="session")
def scenes(lift):
    """Both scenes of Lift by name."""
    from jaxcam.config.names import SceneName, names_of
    from jaxcam.sim.mujoco.scene import build_scene

    return {name: build_scene(lift.objects(), name) for name in names_of(SceneName)}


@pytest.fixture(scope="session")
def scene(scenes):
    return scenes["randomized"]


@pytest.fixture(scope="session")
def renderer(lift, scene):
    """A renderer of the randomised scene."""
    from jaxcam.sim import make_painter

    return make_painter(scene, PIXELS, varied=lift.varied, batch=4)


@pytest.fixture(scope="session")
def mjx_renderer(lift, scene):
    """One that draws within the programs of the MJX engines too."""
    from jaxcam.sim import make_painter

    return make_painter(scene, PIXELS, varied=lift.varied, batch=4, engine="mjx-warp")


@pytest.fixture(scope="session")
def data_dir(tmp_path_factory):
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="session")
def demos(data_dir):
    """Four training and two validation demonstrations. Do not write to `demos.path`."""
    from jaxcam.config.datasets import CollectConfig
    from jaxcam.data.collection import collect

    return collect(CollectConfig(**TINY, data_dir=str(data_dir)))


@pytest.fixture(scope="session")
def spoilt(demos, scene):
    """Demonstrations of which the second was given with the cube somewhere else."""
    episodes = demos.episodes
    states = episodes[1].states.copy()
    states[:, 1 + scene.qpos_of("cube")] += 0.1
    return [episodes[0], replace(episodes[1], states=states), *episodes[2:]]


@pytest.fixture(scope="session")
def pictures(demos):
    from jaxcam.data.pictures import load_pictures

    return load_pictures(demos, PIXELS)


@pytest.fixture(scope="session")
def maniskill():
    """For tests that run ManiSkill: they are skipped where it cannot be run, but not in CI."""
    from jaxcam.errors import SimError
    from jaxcam.sim.maniskill.machine import require

    try:
        require()
    except SimError as error:
        if os.environ.get("JAXCAM_MANISKILL"):
            raise
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def pytorch():
    """For tests that need PyTorch, which comes with ManiSkill: `torch`; skipped like these."""
    if os.environ.get("JAXCAM_MANISKILL"):
        return importlib.import_module("torch")
    return pytest.importorskip("torch", reason="PyTorch is not here; jaxcam[maniskill] has it")
