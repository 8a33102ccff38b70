"""`python -m jaxcam.replay DATASET`: what demonstrations are worth in each action space.

ManiSkill's trajectories are imported first, and what does not replay is told with the reason.
"""

from rich.console import Console

from jaxcam.config.datasets import ManiskillConfig, ReplayConfig
from jaxcam.data.demos import read_demos
from jaxcam.data.replay import falls_short, show_replayed
from jaxcam.files.paths import absolute
from jaxcam.interop import maniskill
from jaxcam.interop.formats import recognise
from jaxcam.sim.actions import ACTION_SPACES


def main(config: ReplayConfig, console: Console) -> int:
    """Runs the command; its exit code."""
    path = absolute(config.dataset)
    spaces = config.action_space or ACTION_SPACES
    if recognise(path) == "maniskill":
        theirs = ManiskillConfig(file=config.dataset)
        replayed = maniskill.run(theirs, spaces, config.engine, console)
    else:
        replayed = show_replayed(read_demos(path), spaces, config.engine, console)
    return int(falls_short(replayed))
