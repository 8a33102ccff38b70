"""What a checkpoint holds beside its arrays: what a policy is rebuilt and a resume judged by."""

import dataclasses
import logging
from collections.abc import Mapping
from typing import Any

from jaxcam.config.train import TrainConfig
from jaxcam.errors import CheckpointError
from jaxcam.runs.environment import package_versions
from jaxcam.training.digests import to_plain

CONVENTION = 1
"""Number of the ray, camera and action conventions that the weights were trained with."""

_log = logging.getLogger(__name__)


def make_side(
    config: TrainConfig, *, settings: Any, spec: Any, stats: Mapping[str, Any], data: Any
) -> dict[str, Any]:
    """What is saved beside the arrays.

    Args:
        config: The resolved settings of the run.
        settings: The policy's own settings, a dataclass.
        spec: The policy's sizes, a dataclass.
        stats: Normalisation statistics, a dict of arrays.
        data: Fingerprint of the training data, anything JSON can hold.
    """
    return {
        "seed": config.seed,
        "config": dataclasses.asdict(config),
        "settings": dataclasses.asdict(settings),
        "spec": dataclasses.asdict(spec),
        "stats": dict(stats),
        "data": data,
        "convention": CONVENTION,
        "packages": package_versions(),
    }


def check_side(where: str, side: Mapping[str, Any], expect: Mapping[str, Any]) -> None:
    """Refuse a checkpoint that is of another run or of other conventions; tell of other packages.

    Args:
        where: The checkpoint, for messages.
        side: What its manifest holds, plain JSON.
        expect: Entries that must be as given, such as those of `make_side`.

    Raises:
        CheckpointError: One of them differs, or the conventions do.
    """
    if side["convention"] != CONVENTION:
        raise CheckpointError(
            f"{where} was trained with conventions {side['convention']}, this version of jaxcam "
            f"has {CONVENTION}: its rays or actions mean something else here."
        )
    for key, value in expect.items():
        old, new = side.get(key), to_plain(value)
        if old == new or key in ("convention", "packages", "config"):
            continue
        if isinstance(old, dict) and isinstance(new, dict):
            # A setting the checkpoint lacks is newer than it, and had its default then.
            fields = sorted(k for k in old if old[k] != new.get(k))
            if not fields:
                continue
            listed = "; ".join(f"{k}: {old.get(k)!r} -> {new.get(k)!r}" for k in fields)
        else:
            listed = f"{old!r} -> {new!r}"
        raise CheckpointError(f"{where} was made with other {key} ({listed}). Use another run_dir.")
    changed = [f"{k} {v} -> {now}" for k, v in side["packages"].items()
               if (now := package_versions().get(k)) != v]  # fmt: skip
    if changed:
        _log.warning("Packages changed, so results are not bit-exact: %s.", ", ".join(changed))
