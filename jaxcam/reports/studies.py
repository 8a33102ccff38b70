"""The paper's figures: each varies one setting, with and without camera conditioning."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jaxcam.config.names import Conditioning, names_of
from jaxcam.reports import paper
from jaxcam.reports.arms import Arm, context
from jaxcam.reports.tables import by_task
from jaxcam.runs.identity import UNSAID


@dataclass(frozen=True)
class Study:
    """One of the paper's figures.

    Attributes:
        field: The setting that it varies.
        title: What it is called.
        file: Name of its picture.
        names: Names of the setting's values in the order of the figure; other values follow.
        belongs: Whether an arm is of this figure, apart from that setting.
    """

    field: str
    title: str
    file: str
    names: Mapping[Any, str]
    belongs: Callable[[Arm], bool] = lambda arm: arm.settings.get("m") != 0


@dataclass(frozen=True)
class Panel:
    """The arms of a figure that differ in nothing but its setting and the conditioning.

    Attributes:
        title: Task, policy and what else is particular.
        arms: By value of the setting, then by `Arm.way`. In the figure on conditionings an arm and
            its twin have one value.
    """

    title: str
    arms: Mapping[Any, Mapping[str, Arm]]


CONDITIONINGS = names_of(Conditioning)
"""In the order of figures."""

STUDIES = (
    Study("scene", "Fixed against randomised scenes", "fixed_randomized",
          {"randomized": "randomized", "fixed": "fixed"}),
    Study("crop_min", "Random cropping", "cropping", {0.8: "crop", 1.0: "no crop"}),
    Study("action_space", "Action spaces", "action_spaces",
          {"eef_delta": "delta EEF", "eef_abs": "abs. EEF", "joint_delta": "delta joint",
           "joint_abs": "abs. joint", "eef_delta_componentwise": "delta EEF by component"}),
    Study("conditioning", "Ways to encode the camera pose", "encodings",
          {name: name for name in CONDITIONINGS}),
    Study("weights", "Pretrained image encoders", "pretraining", {"": "none"}),
    Study("n", "Number of cameras, all seen by every demonstration (m = 0)", "cameras", {},
          lambda arm: arm.settings.get("m") == 0),
    Study("ray_frame", "Frame of the rays", "ray_frames",
          {"base": "base", "world": "world", "grip": "grip", "about_grip": "about the grip",
           "about_table": "about the table"}),
    Study("pose_noise", "Errors of the poses in training", "pose_noise_in_training", {"": "none"}),
    Study("pose_noise_per", "What errors in training are drawn for", "pose_noise_per",
          {"sample": "samples", "episode": "episodes", "camera": "cameras"}),
    Study("rays_from", "Intrinsics that are told", "rays_from",
          {"true": "the cameras'", "nominal": "the usual"}),
)  # fmt: skip


def panels(study: Study, arms: Sequence[Arm]) -> list[Panel]:
    """The panels of a figure for which there are enough values of its setting.

    Args:
        study: The figure.
        arms: All there are.
    """
    known = [
        a for a in arms
        if a.estimate.n and not a.is_told_wrong and study.belongs(a)
        and (study.field in a.settings or (study.field in UNSAID and "preset" in a.settings))
    ]  # fmt: skip
    shown = []
    for some in by_task(known).values():
        groups: dict[str, list[Arm]] = {}
        for arm in some:
            groups.setdefault(context(arm, study.field, "conditioning"), []).append(arm)
        for group in map(functools.partial(_compared, study), groups.values()):
            values = arm_names(study, group)
            if len(values) < 2:
                continue
            chosen = {
                value: {a.way: a for a in _in_order(group) if value_of(study, a) == value}
                for value in values
            }  # fmt: skip
            shown.append(Panel(_title(study, group[0]), chosen))
    return shown


def arms_of(shown: Sequence[Panel]) -> list[Arm]:
    """The arms of panels, in their order."""
    return [arm for panel in shown for arms in panel.arms.values() for arm in arms.values()]


def value_of(study: Study, arm: Arm) -> Any:
    """Where an arm stands in a figure: a twin beside what it is the twin of."""
    if study.field == "conditioning":
        return arm.network or arm.settings["conditioning"]
    return arm.setting(study.field)


def arm_names(study: Study, arms: Sequence[Arm]) -> dict[Any, str]:
    """The values that arms have of a study's setting, in its order, with their names."""
    there = {value_of(study, arm) for arm in arms}
    others = sorted(there - set(study.names), key=_number_or_text)
    return {v: study.names.get(v, str(v)) for v in (*study.names, *others) if v in there}


def _number_or_text(value: Any) -> tuple[float, str]:
    """Numbers in order, then everything else."""
    is_number = isinstance(value, int | float)
    return (float(value) if is_number else float("inf"), str(value))


def _compared(study: Study, arms: Sequence[Arm]) -> list[Arm]:
    """The arms whose conditioning is there at more than one value; all, of two conditionings."""
    if study.field == "conditioning":
        ways = {arm.settings["conditioning"] for arm in arms} - {"none"}
        return list(arms) if len(ways) > 1 else []
    values: dict[str, set[Any]] = {}
    for arm in arms:
        values.setdefault(arm.way, set()).add(arm.setting(study.field))
    return [arm for arm in arms if len(values[arm.way]) > 1]


def _in_order(arms: Sequence[Arm]) -> list[Arm]:
    return sorted(arms, key=place)


def place(arm: Arm) -> int:
    """Where an arm stands in the order of figures: a twin before its own; those of others last."""
    network = arm.network or arm.settings["conditioning"]
    known = CONDITIONINGS.index(network) if network in CONDITIONINGS else len(CONDITIONINGS)
    return 2 * known + (arm.settings["conditioning"] != "none")


def _title(study: Study, arm: Arm) -> str:
    s = arm.settings
    policy = paper.policy_title(s["policy"])
    fixed = ["fixed scene"] if s["scene"] == "fixed" and study.field != "scene" else []
    # What the figure itself says is no particular of a panel.
    label = arm.label(study.field, "conditioning", *(("m",) if study.field == "n" else ()))
    task = paper.task_title(s["task"])
    return "\n".join([task, ", ".join([policy, *fixed, label])])
