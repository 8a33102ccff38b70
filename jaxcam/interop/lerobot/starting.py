"""Weights of LeRobot's that a run begins with, and what lies beside them.

Names and shapes of arrays do not say all of what a network computes: heads, norms before or after a
layer, or how pictures are scaled. Beside LeRobot's weights lies what does, and is compared.
"""

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from jaxcam.config.fields import short
from jaxcam.errors import CheckpointError
from jaxcam.files.paths import absolute
from jaxcam.interop.lerobot.counterparts import COUNTERPARTS
from jaxcam.interop.lerobot.layout import OF_THE_RUN, settings_of, unlike_settings
from jaxcam.interop.lerobot.pipelines import (
    AFTER,
    BEFORE,
    image_scaling_of,
    read_scaling,
)
from jaxcam.interop.lerobot.policy import naming_folder, read_checkpoint
from jaxcam.models import FAMILIES, Policy
from jaxcam.models.weights.load import Weights, read_weights


def read_start(path: str | Path, policy: Policy) -> Weights:
    """The weights that a run begins with.

    Args:
        path: A file, or the folder of a LeRobot checkpoint.
        policy: What is to be trained.

    Raises:
        CheckpointError: They cannot be read, or are of a LeRobot policy of other settings.
        ConfigError: What lies beside them is not of the form that LeRobot writes.
    """
    path = absolute(path)
    is_checkpoint = path.is_dir() and (path / "config.json").is_file()
    weights = read_weights(path / "model.safetensors" if is_checkpoint else path)
    folder = weights.path.parent
    titles = {one.title: name for name, one in COUNTERPARTS.items()}
    name = titles.get(weights.kind.title) if weights.kind else None
    if is_checkpoint or (name and (folder / "config.json").is_file()):
        _check_alike(folder, name, policy)
    return weights


def _check_alike(folder: Path, name: str | None, policy: Policy) -> None:
    """Refuses settings that the weights were not trained with."""
    theirs = read_checkpoint(folder)
    ours = next(n for n, family in FAMILIES.items() if family.config is type(policy.config))
    if theirs.type != name:
        raise CheckpointError(f"{folder}: config.json is of {theirs.type}, the weights are not.")
    if theirs.type != ours:
        raise CheckpointError(f"{folder} is of policy {theirs.type}, the run of {ours}.")
    wanted, images = dict(COUNTERPARTS[theirs.type].scaling), None
    with naming_folder(folder):
        if ours != "smolvla":  # whose tower takes pictures in one way
            del wanted["VISUAL"]  # there are several ways
            images = image_scaling_of(folder, theirs.images)
        _check_modes(folder, theirs.normalization_mapping, wanted)
        settings = settings_of(replace(theirs, use_amp=False), images)  # the run's own arithmetic
    if wrong := unlike_settings(policy.config, settings, OF_THE_RUN):
        listed = "; ".join(f"{key} is {short(there)} there" for key, _, there in wrong)
        given = (f"{key}={there}".replace(" ", "") for key, _, there in wrong)
        changes = " ".join(map(shlex.quote, given))
        raise CheckpointError(
            f"{folder} was trained with other settings than the run's: {listed}. "
            f"Give --preset lerobot, or --model {changes}"
        )


def _check_modes(folder: Path, mapping: Mapping[str, str], wanted: Mapping[str, str]) -> None:
    """Refuses scaling that is not the policy's.

    Trained further, LeRobot scales as config.json says, and what was learned is as the pipelines
    say.
    """
    for name, kinds in ((BEFORE, wanted), (AFTER, ("ACTION",))):
        scaling = read_scaling(folder, name)
        for kind in kinds:
            for file, modes in ((name, scaling.modes), ("config", mapping)):
                if (mode := modes.get(kind, "IDENTITY")) != wanted[kind]:
                    raise CheckpointError(
                        f"{file}.json scales {kind} by {mode!r:.40}, our policy by {wanted[kind]}."
                    )
