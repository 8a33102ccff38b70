"""Which run is this: its settings in full, its name, and what makes it another run.

Two kinds of sameness are told apart. A run is *continued* with settings that leave each of its
updates as it was (`differences`). Runs are *compared as one*, an arm of a report, when only their
seeds and the way their updates were computed differ (`identity`).
"""

import functools
import hashlib
import json
import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from jaxcam.config.conditions import OPTICS, of_task
from jaxcam.config.fields import fill, from_json, overrides
from jaxcam.config.names import TaskName, names_of
from jaxcam.config.presets import PRESETS, Preset, preset_of, unsaid
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.files.paths import read_text
from jaxcam.results.rows import CONDITIONS, USUAL_WAY
from jaxcam.runs.manifests import sides
from jaxcam.sim import SIMULATORS, make_task

Settings = dict[str, Any]
"""Settings by name, as JSON has them."""

# Settings that leave every update of a run as it was; all others are part of a run's identity.
FREE_TO_CHANGE = frozenset({
    "pairs", "engine", "ensemble", "data_dir", "dataset", "cameras", "action_is", "run_dir",
    "log_every", "eval_every", "save_every", "keep", "videos", "seeds", "log", "distributed",
    "eval_fovy",
})  # fmt: skip
# Of the settings that leave training as it was, these say what was trained on and how the
# policy was run; seeds and how updates are computed differ between runs compared as one.
_OWN = {"seed", "steps_per_call", "accumulate"}
_OF_RECORDED = ("cameras", "grip", "hold_out_view", "hold_out_episodes")
"""What only runs that learn from a recorded dataset have."""
_NO_IDENTITY = (FREE_TO_CHANGE | _OWN) - {"dataset", "cameras", "engine", "ensemble"}
OF_CAMERAS: Settings = {
    name: getattr(TrainConfig, name)
    for name in ("pose_noise", "pose_noise_per", "ray_frame", "rays_from", *OPTICS)
}
"""Settings of what a policy is told of cameras, and of their intrinsics, as they usually are."""
UNSAID: Settings = OF_CAMERAS | {
    name: getattr(TrainConfig, name) for name in ("action_frame", "color_jitter")
}
"""Settings that came when there were results already, which lack them: so only those runs have one
in which it is not as usual."""
RECORDED = "recorded"
"""The task of a run that learns from a recorded dataset."""
USUAL_SPACE = "eef_delta"
"""Of actions in the tasks."""
MOST_LETTERS = 180
"""Of a run's name; file systems take 255 bytes, and its log and its job have endings."""
_NAMED = ("task", "scene", "policy", "preset", "conditioning")
_INTERVALS = ("steps", "log_every", "eval_every", "save_every")


def resolve(config: TrainConfig, *, accelerator: bool) -> TrainConfig:
    """Give every setting that is left open its value; a resolved config comes back as it is.

    The preset's own changes to the network are put before those that are asked, which win.

    Args:
        config: Settings, some of them perhaps None.
        accelerator: Whether there is a GPU or TPU.

    Returns:
        Settings without a None. Steps per call divide every interval of the run.

    Raises:
        ConfigError: The policy has no such preset, or given values do not go with its others.
    """
    if config.task != RECORDED:
        config = of_task(config, make_task(config.task).fovy_deg)
    if None not in vars(config).values():
        return config
    name, preset = policy_preset(config, accelerator)
    others = ("model", "before", "warmup", "steps_per_call")
    values = {k: v for k, v in vars(preset).items() if k not in others}
    config = replace(
        config, preset=name, model=(*unsaid(preset.model, config.model), *config.model)
    )
    config = fill(config, **values | _of_subject(config.task))
    # XLA's CPU loops run convolutions many times slower.
    at_most = preset.steps_per_call if accelerator else 1
    config = fill(
        config,
        warmup=min(preset.warmup, config.steps // 10),
        steps_per_call=math.gcd(at_most, *(getattr(config, k) for k in _INTERVALS)),
    )
    return fill(config, run_dir=default_folder(config))


def _of_subject(task: str) -> Settings:
    """What a task gives to the settings that are left open; recorded data has said it before."""
    if task == RECORDED:
        return {"views": 1, "n": 1, "m": 0, "action_space": "native"}
    task_itself = make_task(task)
    n, m = task_itself.stair
    return {"views": task_itself.views, "n": n, "m": m}


def policy_preset(config: TrainConfig, accelerator: bool) -> tuple[str, Preset]:
    """Name and values of the preset that a config means.

    Args:
        config: Settings.
        accelerator: Whether there is a GPU or TPU.

    Raises:
        ConfigError: The policy has no such preset.
    """
    name = config.preset
    if name == "auto":
        name = "paper" if accelerator else "laptop"
    if (config.policy, name) not in PRESETS:
        known = ", ".join(name for policy, name in PRESETS if policy == config.policy)
        raise ConfigError(f"{config.policy} has no preset '{name}', only {known}.")
    return name, preset_of(config.policy, name, config.task)


def read_config(folder: Path) -> TrainConfig:
    """The resolved settings of a run, from its folder.

    Args:
        folder: Of the run.

    Raises:
        ConfigError: Its config.json is damaged, or is not that of its checkpoints.
    """
    config = stored_config(folder)
    for step, side in sides(folder).items():
        if misfits := unlike(config, side):
            raise ConfigError(
                f"{folder}: config.json is not what checkpoint {step} was trained with "
                f"({'; '.join(misfits)}). One of them is of another run, or was edited: restore "
                "it; the checkpoint's manifest holds its own settings."
            )
    return config


def stored_config(folder: Path) -> TrainConfig:
    """The settings in a run's config.json alone, whatever its checkpoints say.

    Raises:
        ConfigError: It is damaged, or cannot be read.
    """
    try:
        text = read_text(folder / "config.json")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{folder / 'config.json'} cannot be read: {error}.") from error
    # Settings that are newer than the run: it was made with their preset's values.
    return resolve(from_json(TrainConfig, text), accelerator=False)


def unlike(config: TrainConfig, side: Mapping[str, Any]) -> list[str]:
    """In what a run's settings are not those that one of its checkpoints was trained with.

    Args:
        config: The run's.
        side: What the checkpoint holds beside its arrays.
    """
    own = resolve(from_json(TrainConfig, json.dumps(side["config"])), accelerator=False)
    return [str(d) for d in differences(own, config) if d.changes_program]


def default_folder(config: TrainConfig) -> str:
    """The folder of a run that is given none.

    Its name has what runs are usually compared by, then what is not the task's default.

    Args:
        config: Settings; all but `run_dir` have values.
    """
    usual = {"action_space": policy_preset(config, False)[1].action_space}
    usual |= _of_subject(config.task)
    names = ("task", "policy", "preset", "conditioning") if config.task == RECORDED else _NAMED
    parts = [getattr(config, name) for name in names]
    if config.conditioning == "none" and (twin_of := _said_twin(config.model)):
        parts.append(f"as_{twin_of}")
    if config.action_space != usual["action_space"]:
        parts.append(config.action_space)
    if config.action_frame != TrainConfig.action_frame:
        parts.append(f"{config.action_frame}_frame")
    if (config.n, config.m) != (usual["n"], usual["m"]) and config.task != RECORDED:
        parts.append(f"n{config.n}m{config.m}")
    if config.views != usual["views"]:
        parts.append(f"{config.views}views")
    cameras = {k: getattr(config, k) for k in OF_CAMERAS}
    parts += [f"{k}{_in_name(v)}" for k, v in cameras.items() if v != OF_CAMERAS[k]]
    parts += [Path(file).stem for file in (config.weights, config.dataset) if file]
    return "runs/" + re.sub("[:,]", "_", "-".join([*parts, str(config.seed)]))


def full_name(config: TrainConfig, *, files: bool = True) -> str:
    """A name that tells a run from all others: the preset it starts from and each change to it.

    Args:
        config: Resolved settings.
        files: Whether it tells the folders of data and weights apart, too; version 0.1.0 did not.
    """
    # The engine trains nothing else.
    settings = identity(config) | {"engine": usual_way(config.task)["engine"]}
    parts = [settings[name] for name in _NAMED]
    parts += [f"{k}{_in_name(v)}" for k, v in changes(settings).items()]
    parts += [_digest(*paths)] if files and (paths := _paths(config)) else []
    name = re.sub(r"[^A-Za-z0-9.=+-]+", "_", "-".join([*parts, str(config.seed)]))
    if len(name) <= MOST_LETTERS:
        return name
    return f"{name[:MOST_LETTERS]}-{_digest(name)}-{config.seed}"


def _in_name(value: Any) -> str:
    """A setting's value in a name, where colons and commas of lenses must not look the same."""
    text = plain(value)
    return text.replace(",", "+") if ":" in text else text


def _paths(config: TrainConfig) -> list[str]:
    """The files that a run reads where they are not the usual: words tell only their names."""
    names = ("data_dir", "dataset", "cameras", "weights")
    paths = {k: os.path.normpath(getattr(config, k)) for k in names if getattr(config, k)}
    return [f"{k}={v}" for k, v in paths.items() if v != getattr(TrainConfig, k)]


def _digest(*words: str) -> str:
    text = "\n".join(words).encode(errors="surrogateescape")
    return hashlib.sha256(text).hexdigest()[:8]


def identity(config: TrainConfig) -> Settings:
    """The settings that runs of one arm share, as JSON has them.

    Args:
        config: Resolved settings of a run.
    """
    values = {k: v for k, v in asdict(config).items() if k not in _NO_IDENTITY}
    values = said(values)
    values["model"] = list(config.model)
    if config.action_space != "eef_abs":
        del values["rotations"]  # they are none of its actions'
    if config.task == RECORDED:
        values |= {
            name: list(getattr(config, name)) for name in ("hold_out_view", "hold_out_episodes")
        }
        values["cameras"] = Path(config.cameras).stem
    else:
        for name in _OF_RECORDED:
            del values[name]
    values["dataset"] = Path(config.dataset).stem
    values["weights"] = Path(config.weights).stem
    return values


def said(settings: Settings) -> Settings:
    """Those of a run's settings that are said where they are; the others are `UNSAID`."""
    return {k: v for k, v in settings.items() if k not in UNSAID or v not in (None, UNSAID[k])}


def changes(settings: Settings) -> Settings:
    """The settings that are not what their policy's preset and their task give.

    Args:
        settings: From `identity`.
    """
    named = tuple(settings[name] for name in _NAMED)
    usual, so_long = _usual(*named), _usual(*named, steps=settings["steps"])
    # What follows from the number of updates, such as the warm-up, is no change of its own.
    return {
        k: v for k, v in settings.items()
        if v is not None and v != usual[k] and (k == "steps" or v != so_long[k])
    }  # fmt: skip


@functools.lru_cache
def usual_way(task: str) -> Settings:
    """How policies are run in a task where nothing else is asked for.

    Args:
        task: Its name; others than ours have the engine that most of ours have.
    """
    if task not in names_of(TaskName):
        return USUAL_WAY
    simulator = SIMULATORS[make_task(task).simulator]
    return USUAL_WAY | {"engine": next(iter(simulator.engines))}


@functools.lru_cache
def _usual(*named: str, steps: int | None = None) -> Settings:
    config = TrainConfig(**dict(zip(_NAMED, named, strict=True)), steps=steps)  # pyright: ignore
    usual = identity(resolve(config, accelerator=False)) | usual_way(config.task)
    usual |= {"rotations": TrainConfig.rotations}
    return usual | dict.fromkeys(CONDITIONS) | UNSAID


def network_of(settings: Mapping[str, Any]) -> str | None:
    """The conditioning whose network a run has; of an image-only one, the one it is the twin of.

    Args:
        settings: From `identity`, or what is known of them.

    Returns:
        Such as "late"; "none" where the network has no place for a camera; None if nobody says.
    """
    if settings["conditioning"] != "none":
        return settings["conditioning"]
    preset = PRESETS.get((settings.get("policy"), settings.get("preset")))  # pyright: ignore
    return _said_twin(settings.get("model") or ()) or (preset and preset.conditioning)


def without_twin(model: Iterable[str]) -> list[str]:
    """Changes to a network but the one that says whose twin it is."""
    return [change for change in model if not _says_twin(change)]


def twin_settings(config: TrainConfig) -> Settings:
    """What makes the image-only twin of a run: its network, fed with one fixed pose.

    Args:
        config: Resolved settings of a run that is told its cameras.

    Returns:
        `conditioning` and `model`.
    """
    network, model = config.conditioning, without_twin(config.model)
    _, preset = policy_preset(config, accelerator=False)
    if preset.conditioning != network:
        model.append(f"twin_of={network}")
    return {"conditioning": "none", "model": tuple(model)}


def _says_twin(change: str) -> bool:
    return str(change).partition("=")[0] == "twin_of"


def _said_twin(model: Iterable[str]) -> str:
    return next((str(c).partition("=")[2] for c in model if _says_twin(c)), "")


def plain(value: Any) -> str:
    """A setting's value as people write it."""
    if isinstance(value, list | tuple):
        return " ".join(map(str, value)) or "–"
    if isinstance(value, float):
        return short if float(short := f"{value:g}") == value else repr(value)
    return str(value)


class Difference(NamedTuple):
    """One setting in which two configs differ."""

    field: str
    old: Any
    new: Any
    changes_program: bool
    """Whether a run that changes it half-way is another run."""

    def __str__(self) -> str:
        return f"{self.field}: {self.old!r} -> {self.new!r}"


def differences(old: TrainConfig, new: TrainConfig) -> list[Difference]:
    """The settings in which two resolved configs differ, in the order they are declared."""
    free = FREE_TO_CHANGE
    if old.schedule == new.schedule == "constant":
        free |= {"steps"}  # A constant rate does not know how long the run is.
    if new.task == RECORDED and new.action_space != "native":
        free -= {"action_is"}  # it says what they became that space from
    pairs = ((f.name, getattr(old, f.name), getattr(new, f.name)) for f in fields(old))
    return [
        Difference(name, a, b, name not in free)
        for name, a, b in pairs
        if a != b and not (name == "model" and overrides(a) == overrides(b))
    ]
