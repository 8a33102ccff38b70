"""The options of an environment, and what they mean for its worlds."""

from dataclasses import dataclass, fields
from typing import Any, Literal, Self

from jaxcam.config.fields import (
    as_record,
    check_least,
    check_most,
    check_rotation_form,
    check_types,
    fill,
)
from jaxcam.config.names import ActionSpace, EngineChoice, Rotations, SceneName, TaskName
from jaxcam.config.sizes import rows_and_columns
from jaxcam.errors import ConfigError, closest
from jaxcam.sim import make_task

Reward = Literal["sparse", "shaped"]
MOST_STEPS = 100_000
"""Of an episode, and of a chunk."""
MOST_VIEWS = 32


@dataclass(frozen=True)
class EnvOptions:
    """What `gymnasium.make` and `gymnasium.make_vec` take, besides `num_envs` and their own."""

    task: TaskName
    """Of the id."""
    scene: SceneName = "randomized"
    """Whether table and room stand where they always do, or elsewhere in every episode."""
    action_space: ActionSpace = "eef_delta"
    """What actions mean, see docs/conventions.md."""
    rotations: Rotations = "nominal"
    """What the rotation vectors of `eef_abs` are counted from, as `--rotations` of a training."""
    views: int | None = None
    """Cameras of an episode; the task's when None."""
    resolution: int | str = 84
    """Size of the pictures, as `--resolution`: 84, or "96x128"."""
    render_size: int | str = 256
    """Size of what `render` returns, in the same form."""
    engine: EngineChoice = "auto"
    """Physics, as `--engine`."""
    horizon: int | None = None
    """Control steps after which an episode is cut; the task's when None."""
    chunk: int | None = None
    """Actions that a step takes, executed open loop: `[chunk, A]`. One without that axis when
    None."""
    reward: Reward = "sparse"
    """1 at success, or robosuite's shaped reward."""

    def __post_init__(self) -> None:
        check_types(self)
        check_rotation_form(self.action_space, self.rotations)
        check_least(self, 1, "views horizon chunk")
        check_most(self, MOST_STEPS, "horizon chunk")
        check_most(self, MOST_VIEWS, "views")
        for name in ("resolution", "render_size"):
            rows_and_columns(getattr(self, name), name)
        if self.reward == "shaped" and make_task(self.task).simulator != "mujoco":
            raise ConfigError(
                f"reward must be sparse for {self.task}: shaped is robosuite's reward, and this "
                "task is ManiSkill's. Lift, PickPlaceCan and Square have it."
            )

    @classmethod
    def of(cls, given: dict[str, Any]) -> Self:
        """The options as they were given, those of the task filled in.

        Args:
            given: By name.

        Raises:
            ConfigError: There is no such option, or no such value of it.
        """
        known = [field.name for field in fields(cls)]
        for name in given:
            if name not in known:
                raise ConfigError(f"Unknown option {name!r:.80}{closest(name, known)}.")
        options = as_record(cls, given, "environment")
        task = make_task(options.task)
        return fill(options, views=task.views, horizon=task.horizon)
