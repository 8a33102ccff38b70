"""What the paper reports (arXiv:2510.02268): Table I, and what it says of each figure.

Its figures give no numbers, so only Table I can stand beside ours.
"""

from collections.abc import Mapping
from typing import Any

from jaxcam.config.presets import PRESETS
from jaxcam.results.rows import CONDITIONS
from jaxcam.runs.identity import OF_CAMERAS

TASKS = {
    "lift": "Lift",
    "pick_place_can": "Pick Place Can",
    "square": "Assembly Square",
    "push": "Push",
    "lift_upright": "Lift Upright",
    "roll_ball": "Roll Ball",
}
"""Tasks in the order of Table I."""
POLICIES = {"act": "ACT", "diffusion": "DP", "smolvla": "SmolVLA"}
"""Policies in the order of Table I, as it calls them."""
CONDITIONING = {"act": "late", "diffusion": "early", "smolvla": "late"}
"""How each policy is told the camera pose in Table I."""
ENCODINGS = ("token", "early", "late")
"""The ways that the paper compares (its figure on encodings)."""

# Success in percent by task, image only and with the camera pose.
_TABLE = {
    "act": ((33.6, 26.7, 10.8, 29.9, 22.9, 28.7), (60.6, 30.9, 18.7, 37.5, 34.6, 29.7)),
    "diffusion": ((29.1, 23.1, 2.0, 20.0, 9.5, 19.9), (51.1, 39.3, 2.4, 30.3, 20.7, 23.7)),
    "smolvla": ((19.6, 56.0, 22.0, 39.0, 23.6, 27.6), (54.4, 70.0, 26.4, 43.8, 33.4, 30.4)),
}

SAYS = {
    "scene": "The image-only policy is worse in randomised scenes on every task. Conditioning "
    "helps most there, and helps in fixed scenes too.",
    "action_space": "End-effector deltas are best, absolute poses and joints noticeably worse; "
    "conditioning helps in all four.",
    "crop_min": "Random cropping of image and ray-map together helps on all three tasks.",
    "conditioning": "A linear projection of the pose to a token brings no observable benefit; "
    "early fusion is less effective than late fusion in most cases.",
    "weights": "Pretraining of the image encoder has little effect.",
    "n": "To reach the same success, a policy that is not told the pose needs several times more "
    "cameras; with many cameras a small benefit of the pose remains.",
}
"""What the paper finds where one setting varies, in our words (section V-A)."""


_BEYOND = dict.fromkeys(CONDITIONS) | OF_CAMERAS
"""Settings that the paper does not vary, each with what it has."""


def task_title(name: str) -> str:
    """The paper's name of a task, or our own."""
    return TASKS.get(name) or name


def policy_title(name: str, *, short: bool = True) -> str:
    """The paper's name of a kind of policy, or our own.

    Args:
        name: Such as "diffusion".
        short: Whether as in its tables, or in full.
    """
    return "Diffusion Policy" if name == "diffusion" and not short else POLICIES.get(name) or name


def success(policy: str, task: str, conditioned: bool) -> float | None:
    """Table I's success in percent, or None where it has no such cell.

    Args:
        policy: "act", "diffusion" or "smolvla".
        task: Such as "lift".
        conditioned: Whether the policy is told the camera pose.
    """
    if policy not in _TABLE or task not in TASKS:
        return None
    return _TABLE[policy][conditioned][list(TASKS).index(task)]


def is_table_setting(settings: Mapping[str, Any]) -> bool:
    """Whether the settings, apart from budget and size, are those of Table I.

    Actions are the paper's, or what the preset has instead.

    Args:
        settings: Of an arm; what is not recorded is taken to be as in Table I.
    """
    known = PRESETS.get((settings.get("policy"), settings.get("preset")))  # pyright: ignore
    spaces = {None, "eef_delta", known and known.action_space}
    crop, m = settings.get("crop_min"), settings.get("m")
    if any(settings.get(name, usual) != usual for name, usual in _BEYOND.items()):
        return False
    return (
        settings.get("scene") in (None, "randomized")
        and settings.get("action_space") in spaces
        and settings.get("rotations") in (None, "nominal")
        and (crop is None or crop < 1)
        and m != 0  # that is the figure on numbers of cameras
    )


def table_cell(policy: str, task: str, conditioned: bool) -> str:
    """A cell of Table I, with the gain over image only where it is conditioned; a dash for none.

    Args:
        policy: "act", "diffusion" or "smolvla".
        task: Such as "lift".
        conditioned: Whether the policy is told the camera pose.
    """
    value = success(policy, task, conditioned)
    if value is None:
        return "–"
    image_only = success(policy, task, False) or 0.0
    return f"{value:.1f}" + (f" ({value - image_only:+.1f})" if conditioned else "")
