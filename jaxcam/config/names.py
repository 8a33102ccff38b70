"""The settings that are names: each a type of all the names there are."""

from typing import Any, Literal, get_args, get_origin

TaskName = Literal["lift", "lift_upright", "pick_place_can", "push", "roll_ball", "square"]
"""The files of `jaxcam/sim/tasks`."""
Subject = Literal[TaskName, "recorded"]
"""What a run learns: a task, or what a recorded dataset shows."""
SceneName = Literal["fixed", "randomized"]
"""Whether table and room stand where they always do, or somewhere else in every episode."""
PolicyName = Literal["act", "diffusion", "smolvla"]
PresetName = Literal["auto", "laptop", "attention", "paper", "lerobot", "original", "tiny"]
Conditioning = Literal[
    "none", "token", "early", "late", "keypoints", "warp", "prope", "gta", "ray_rope"
]  # fmt: skip
ActionFrame = Literal["base", "camera"]
ActionSpace = Literal[
    "eef_delta", "eef_abs", "joint_delta", "joint_abs", "eef_delta_componentwise"
]  # fmt: skip
ActionChoice = Literal[ActionSpace, "native"]
"""`native` is what a recorded dataset's actions are, whatever that is."""
ActionMeaning = Literal["unknown", "eef_abs", "eef_delta", "joint_abs", "joint_delta"]
"""What the actions of a recorded dataset are, as far as anybody says."""
Rotations = Literal["nominal", "world"]
CommandSource = Literal["commands", "deltas", "absolute", "states"]
PoseNoisePer = Literal["sample", "episode", "camera"]
"""What an error of the poses is drawn anew for in training."""
RaysFrom = Literal["true", "nominal"]
"""Whether the intrinsics that a policy is told are those of its cameras, or the task's usual."""
RayFrame = Literal["base", "world", "grip", "about_grip", "about_table"]
"""Where the rays are that a policy is told: in the axes and about the origin of one of three
frames, or in the base's axes with moments about another point."""
ScheduleName = Literal["constant", "cosine", "cosine_from_start"]
OptimizerName = Literal["adamw", "adam"]
Precision = Literal["float32", "bfloat16"]
LoggerName = Literal["tensorboard", "wandb"]
Stem = Literal["keep", "new"]
Split = Literal["test", "validation"]
"""Held-out pairs: those that results are on, and those that settings are chosen on."""
EvaluationSplit = Literal[Split, "train"]
"""What a run can be evaluated on: also on new starts and the cameras that training saw."""
ProtocolName = Literal["one", "paper"]
Cluster = Literal["none", "slurm", "local"]
EngineName = Literal["native", "mjx-jax", "mjx-warp", "sapien", "sapien-gpu"]
EngineChoice = Literal["auto", EngineName]
"""`auto` is the fastest engine on this machine that can step the task's world."""


def names_of(hint: Any) -> tuple[str, ...]:
    """The names that values of a type may be.

    Args:
        hint: A `Literal` of names, also one that may be None or that there may be several of.

    Returns:
        All of them; none if the type is no such one.
    """
    if get_origin(hint) is Literal:
        return get_args(hint)
    return next((names for part in get_args(hint) if (names := names_of(part))), ())
