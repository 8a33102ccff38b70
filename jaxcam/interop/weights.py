"""`python -m jaxcam.weights FILE|RUN`: what a file of weights holds; LeRobot's policies."""

import shlex

from rich.console import Console

from jaxcam.config.commands import WeightsConfig
from jaxcam.config.train import TrainConfig
from jaxcam.files.paths import absolute
from jaxcam.interop.lerobot.policy import VERSION, adopt, export_policy
from jaxcam.models.weights.load import read_weights, show_weights
from jaxcam.training.checkpoint import load_policy_inputs


def main(config: WeightsConfig, console: Console) -> None:
    """Runs `python -m jaxcam.weights`."""
    if config.export:
        inputs = load_policy_inputs(config.source, config.step)
        notes = export_policy(inputs, absolute(config.export))
        what = f"{config.export}: a LeRobot {VERSION} checkpoint."
    elif config.run_dir:
        names = ("task", "scene", "action_space", "rotations", "run_dir")
        config_of_run = TrainConfig(**{k: getattr(config, k) for k in names})
        notes = adopt(absolute(config.source), config_of_run)
        quoted = shlex.quote(config.run_dir)
        what = f"{config.run_dir}: a run. Next: python -m jaxcam.evaluate {quoted}"
    else:
        show_weights(read_weights(config.source), console)
        return
    for line in (what, *notes):
        console.print(line, soft_wrap=True, highlight=False)
