"""Tasks can be read where no simulator is installed."""

import subprocess
import sys

import pytest

from jaxcam.config.names import EngineChoice, EngineName, TaskName, names_of
from jaxcam.errors import ConfigError
from jaxcam.sim import engine_name, make_task, task_names
from jaxcam.sim.simulators import SIMULATORS

SIMULATION = {"mujoco", "robosuite", "mani_skill", "sapien", "warp", "numba", "torch"}
READ = """
import sys
from jaxcam.sim import make_task, task_names
for name in task_names():
    task = make_task(name)
    print(name, task.views, task.stair, task.horizon, task.cameras, task.prompt, task.simulator)
print(*{module.split(".")[0] for module in sys.modules})
"""


def test_what_a_task_says_of_itself_loads_no_simulator():
    done = subprocess.run([sys.executable, "-c", READ], capture_output=True, text=True, check=True)
    *tasks, modules = done.stdout.splitlines()
    assert [line.split()[0] for line in tasks] == list(task_names())
    assert len(tasks) >= 6
    assert not SIMULATION & set(modules.split())


def test_settings_know_every_task_and_engine():
    assert sorted(names_of(TaskName)) == list(task_names())
    engines = [name for simulator in SIMULATORS.values() for name in simulator.engines]
    assert sorted(names_of(EngineName)) == sorted(engines)
    assert names_of(EngineChoice) == ("auto", *names_of(EngineName))


@pytest.mark.parametrize("name", SIMULATORS)
def test_what_is_named_is_there(name):
    simulator = SIMULATORS[name]
    parts = [simulator.world, simulator.has_accelerator, simulator.painter]
    for part in (*parts, *simulator.engines.values()):
        assert callable(part.load())
    assert simulator.accelerated in simulator.engines
    for painter in (simulator.painter.load(), simulator.cpu_painter.load()):
        assert callable(painter.look)
        assert isinstance(painter.uses_all_cores(), bool)


def test_unknown_engines_name_the_closest(scene):
    with pytest.raises(ConfigError, match="Unknown engine 'nativ', did you mean 'native'"):
        engine_name("nativ", scene)


@pytest.mark.parametrize("task", ["lift", "push"])
def test_unknown_scenes_name_the_closest(task):
    with pytest.raises(ConfigError, match="Unknown scene 'randomised', did you mean 'randomized'"):
        make_task(task).scene("randomised")


def test_unknown_task_names_the_closest():
    with pytest.raises(ConfigError, match="Unknown task 'lfit', did you mean 'lift'"):
        make_task("lfit")
