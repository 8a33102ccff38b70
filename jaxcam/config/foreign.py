"""Settings of the evaluation of somebody else's policy: its flags, and its map of observations.

Help needs no JAX.
"""

from dataclasses import dataclass, fields
from typing import Annotated, Any

import tyro

from jaxcam.config.fields import check_least, check_most, check_types
from jaxcam.config.flags import default
from jaxcam.config.names import ActionSpace, SceneName, TaskName
from jaxcam.config.sizes import rows_and_columns
from jaxcam.errors import ConfigError

ADDRESSES = ("ws://", "wss://")
"""What the address of a server begins with; other policies are functions in Python."""

MOST_STEPS = 1000
"""Of a chunk that are executed: no episode has as many."""


@dataclass(frozen=True)
class ForeignConfig:
    """Evaluate somebody else's policy on the same pairs, see docs/your-policy.md."""

    policy: Annotated[str, tyro.conf.arg(metavar="ADDRESS"), default("none")] = ""
    """Server that speaks openpi's protocol, ws://HOST:PORT, or function in Python,
    module:function, instead of runs."""
    task: Annotated[TaskName | None, default("the server's, or lift")] = None
    """What it has to do."""
    scene: SceneName = "randomized"
    """In which scene."""
    views: Annotated[int | None, tyro.conf.arg(metavar="INT"), default("the server's")] = None
    """Cameras that it sees at once, or else as many as the task has."""
    name: Annotated[str, default("the server's run, or the address")] = ""
    """What it is called in rows, reports and the folder's name."""
    obs: Annotated[str, tyro.conf.arg(metavar="MAP.yaml"), default("our own names")] = ""
    """What it calls what it observes, and what else it wants."""
    action_space: Annotated[ActionSpace | None, default("the server's, or eef_delta")] = None
    """What its actions mean."""
    resolution: Annotated[
        int | str | None,
        tyro.conf.arg(metavar="SIDE|ROWSxCOLUMNS"),
        default("the server's, or 84"),
    ] = None
    """Size at which its pictures are drawn."""
    execute: Annotated[
        int | None, tyro.conf.arg(metavar="INT"), default("the server's, or all")
    ] = None
    """Steps of a chunk that are executed before it is asked again."""
    timeout: float = 30.0
    """Seconds to wait for a server's answer; a later one is a failure of that rollout."""
    at_once: Annotated[
        int | None, tyro.conf.arg(metavar="INT"), default("1, or the width that it says")
    ] = None
    """Questions that are sent to a server at once."""
    key: Annotated[str, default("none")] = ""
    """What the server asks for."""
    key_file: Annotated[str, default("none")] = ""
    """File that holds it."""
    run_dir: Annotated[str, default("runs/foreign-TASK-SCENE-NAME")] = ""
    """Folder of its rows and page."""

    @property
    def is_server(self) -> bool:
        """Whether it is asked through a socket."""
        return self.policy.startswith(ADDRESSES)

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "views execute at_once")
        check_most(self, MOST_STEPS, "execute")
        check_most(self, 1000, "views at_once")
        check_least(self, 0, "timeout", or_equal=False)
        check_most(self, 86_400, "timeout")
        if self.resolution is not None:
            rows_and_columns(self.resolution)
        given = [f.name for f in fields(self) if getattr(self, f.name) != f.default]
        flags = ["--" + name.replace("_", "-") for name in given]
        if flags and not self.policy:
            raise ConfigError(
                f"{flags[0]} goes with --policy only: a run has its own task, and says the rest."
            )
        if self.key and self.key_file:
            raise ConfigError("Give --key or --key-file, not both.")
        of_servers = [flag for flag in flags if flag in ("--key", "--key-file", "--at-once")]
        if of_servers and not self.is_server:
            raise ConfigError(f"{of_servers[0]} is for servers, not for functions.")


@dataclass(frozen=True)
class ObsMap:
    """What a foreign policy wants, as `--obs MAP.yaml` says it.

    Attributes:
        keys: Its names, and what of ours each is: a name, such as observation.images.view_0, a part
            of one, such as observation.state[0:7], or several that are joined to one array. Nothing
            else is sent then; None sends all under our names.
        resolution: Size of its pictures.
        action_space: What its actions mean.
        execute: Steps of a chunk that are executed.
        observation_steps: Observations that it sees at once, the oldest first.
        answer: Its name for the actions.
        prompt: What it is told to do; the task's own words when None.
        conditioning: How it is told its camera, a word for reports; none if it is not.
    """

    keys: dict[str, Any] | None = None
    resolution: int | str | None = None
    action_space: ActionSpace | None = None
    execute: int | None = None
    observation_steps: int | None = None
    answer: str = "actions"
    prompt: str | None = None
    conditioning: str | None = None

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "execute observation_steps")
        check_most(self, MOST_STEPS, "execute observation_steps")
        if self.resolution is not None:
            rows_and_columns(self.resolution)
