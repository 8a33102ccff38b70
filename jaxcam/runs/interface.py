"""What a run's policy is shown and what it answers, by name, for whoever asks it elsewhere.

Training writes it into the run's folder, so that the folder is all that is needed; runs that are
older have the names of their task, or numbers.
"""

from dataclasses import dataclass
from pathlib import Path

from jaxcam.config.fields import as_record, check_least, check_types, to_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.whole import write_atomically
from jaxcam.models import PolicySpec
from jaxcam.runs.identity import RECORDED
from jaxcam.runs.manifests import read_object
from jaxcam.sim import make_task
from jaxcam.sim.actions import action_names
from jaxcam.sim.controllers import CONTROL_HZ
from jaxcam.sim.world import STATE_NAMES

FILE = "interface.json"
"""Name of the record in a run's folder."""


@dataclass(frozen=True)
class Interface:
    """What a policy is shown and what it answers, in the words of what it learned from."""

    views: tuple[str, ...]
    """Names of the cameras that it may see, in the order in which it sees them."""
    state_names: tuple[str, ...]
    """Of the P numbers of its state."""
    action_names: tuple[str, ...]
    """Of the A numbers of an action."""
    rate: float | None = None
    """Steps a second; None where nobody knows."""
    prompt: str = ""
    """What it was shown to do, in words."""

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 0, "rate", or_equal=False)


def simulated_interface(config: TrainConfig) -> Interface:
    """That of a run that learns a task of ours.

    Args:
        config: Resolved settings.
    """
    return Interface(
        _numbered("view", config.views),
        STATE_NAMES,
        action_names(config.action_space),
        CONTROL_HZ,
        make_task(config.task).prompt,
    )


def write_interface(run: Path, interface: Interface) -> None:
    """Keeps it in a run's folder."""
    write_atomically(run / FILE, to_json(interface))


def read_interface(run: Path, config: TrainConfig, spec: PolicySpec) -> Interface:
    """That of a run.

    Args:
        run: Folder of the run.
        config: Its settings.
        spec: Sizes of its policy.

    Raises:
        ConfigError: The folder's record is damaged, or of another policy.
    """
    file = run / FILE
    if not file.exists():
        if config.task != RECORDED:
            return simulated_interface(config)
        return Interface(
            _numbered("view", spec.views),
            _numbered("state", spec.proprio_dim),
            _numbered("action", spec.action_dim),
        )
    try:
        interface = as_record(Interface, read_object(file), str(file))
    except ConfigError as error:
        raise ConfigError(
            f"{file} is damaged: {error}. Restore it, or delete it: views and numbers are then "
            "known by their places."
        ) from error
    sizes = len(interface.state_names), len(interface.action_names)
    if sizes != (spec.proprio_dim, spec.action_dim) or len(interface.views) < spec.views:
        raise ConfigError(
            f"{file} is of another policy: it names {len(interface.views)} views, {sizes[0]} "
            f"numbers of the state and {sizes[1]} of an action; this one has {spec.views}, "
            f"{spec.proprio_dim} and {spec.action_dim}. Restore it, or delete it."
        )
    return interface


def _numbered(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}_{i}" for i in range(count))
