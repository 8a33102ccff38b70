"""On what terms a foreign policy is evaluated: what the flags, the map and it itself say.

Flags come first, then the map, then what the policy says of itself, then what is usual here.
"""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

from jaxcam.client import CAMERA
from jaxcam.config.fields import as_record
from jaxcam.config.foreign import ForeignConfig, ObsMap
from jaxcam.config.names import ActionSpace, PolicyName, Rotations, TaskName
from jaxcam.config.sizes import rows_and_columns, size_name
from jaxcam.errors import ConfigError
from jaxcam.evaluation.mapping import CHANCE, Names, names_of_map, numbered_views, renamed
from jaxcam.evaluation.sources import PolicySource
from jaxcam.reports.names import file_name
from jaxcam.runs.foreign import NOT_SAID, ForeignRecord
from jaxcam.runs.identity import USUAL_SPACE
from jaxcam.sim import make_task
from jaxcam.sim.world import PROPRIO_DIM

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,79}")
_SIDE: Final = 84
"""Pixels of pictures of which nobody says how large they are to be."""


def settled(flags: ForeignConfig, wanted: ObsMap, source: PolicySource) -> ForeignRecord:
    """What is asked of a policy, and how: flags come first, then the map, then what it says itself.

    Args:
        flags: The settings.
        wanted: The map.
        source: The policy.

    Returns:
        The record, and what it is sent.

    Raises:
        ConfigError: A value of these cannot be.
    """
    said = Said.of(source.metadata)
    task = flags.task or said.task or "lift"
    resolution = flags.resolution or wanted.resolution or said.resolution or _SIDE
    space = flags.action_space or wanted.action_space or said.action_space or USUAL_SPACE
    return ForeignRecord(
        name=_name(flags, source),
        address=source.address,
        task=task,
        scene=flags.scene,
        conditioning=wanted.conditioning or said.conditioning or _told(wanted),
        views=flags.views or said.at_once or len(said.views or ()) or make_task(task).views,
        resolution=size_name(*rows_and_columns(resolution)),
        action_space=space,
        rotations=(said.rotations or "nominal") if space == "eef_abs" else "nominal",
        execute=flags.execute or wanted.execute or said.execute,
        observation_steps=wanted.observation_steps or said.observation_steps or 1,
        keys=wanted.keys,
        answer=wanted.answer,
        prompt=wanted.prompt or said.prompt or make_task(task).prompt,
        metadata=source.metadata,
        weights_sha=source.sha,
    )


def _told(wanted: ObsMap) -> str:
    """What a policy that does not say it is told of its camera: nothing if it is sent nothing."""
    if wanted.keys is None or CAMERA in repr(list(wanted.keys.values())).replace("/", "."):
        return NOT_SAID
    return "none"


def names_sent(record: ForeignRecord, width: int) -> Names:
    """What a policy is sent, under its names.

    Args:
        record: Of the policy.
        width: Rollouts at once. A server of ours whose batches are as large is told which row of
            which call is asked, and gives what the run itself does.

    Raises:
        ConfigError: Its map names what we have not.
    """
    if record.keys is not None:
        return names_of_map(record.keys, record.views, PROPRIO_DIM)
    views, metadata = Said.of(record.metadata).views or (), record.metadata
    theirs = views if len(views) == record.views else numbered_views(record.views)
    alike = metadata.get("server") == "jaxcam" and metadata.get("width") == width
    return renamed(theirs, *(CHANCE if alike else ()))


def map_of(record: ForeignRecord) -> ObsMap:
    """The map that asks for what was sent, whoever said it."""
    known = {f.name for f in dataclasses.fields(ObsMap)}
    return as_record(ObsMap, {k: v for k, v in vars(record).items() if k in known}, "map")


@dataclass(frozen=True)
class Said:
    """What a policy says of itself that we use, if it is of a form that we know."""

    run: str | None = None
    task: TaskName | None = None
    conditioning: str | None = None
    views: tuple[str, ...] | None = None
    at_once: int | None = None
    """Views that it sees at once, if not all."""
    prompt: str | None = None
    resolution: int | str | None = None
    action_space: ActionSpace | None = None
    rotations: Rotations | None = None
    execute: int | None = None
    observation_steps: int | None = None

    @classmethod
    def of(cls, metadata: Mapping[str, Any]) -> "Said":
        """What is in the metadata of a server or of a function; others say anything, or nothing."""
        return cls(
            run=_said(metadata.get("run"), str),
            task=_named(metadata.get("task"), TaskName),
            conditioning=_said(metadata.get("conditioning"), str),
            views=_texts(metadata.get("views")),
            at_once=_count(metadata.get("views_at_once")),
            prompt=_said(metadata.get("prompt"), str),
            resolution=_size(metadata.get("image_size")),
            action_space=_named(metadata.get("action_space"), ActionSpace),
            rotations=_named(metadata.get("rotations"), Rotations),
            execute=_count(metadata.get("execute")),
            observation_steps=_count(metadata.get("observation_steps")),
        )


def _said(value: Any, kind: type) -> Any:
    return value if isinstance(value, kind) and value else None


def _named(value: Any, names: Any) -> Any:
    return value if isinstance(value, str) and value in get_args(names) else None


def _count(value: Any) -> int | None:
    is_count = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= 1000
    return value if is_count else None


def _texts(value: Any) -> tuple[str, ...] | None:
    if not isinstance(value, list):
        return None
    texts = tuple(value)
    good = all(isinstance(text, str) for text in texts) and len({*texts}) == len(texts)
    return texts if texts and good else None


def _size(value: Any) -> int | str | None:
    if not (isinstance(value, list) and len(value) == 2 and all(map(_count, value))):
        return None
    return size_name(*value)


def _name(flags: ForeignConfig, source: PolicySource) -> str:
    """What the policy is called; a name that it has by itself is made one of a file."""
    ours = get_args(PolicyName)
    if not flags.name:
        given = Said.of(source.metadata).run or re.sub(r"^wss?://|[/:]+", " ", flags.policy).strip()
        safe = file_name(given.replace(" ", "-"))[:80]
        return f"foreign-{safe}" if safe.lower() in ours or not _NAME.fullmatch(safe) else safe
    if not _NAME.fullmatch(flags.name):
        raise ConfigError(
            f"--name {flags.name!r:.100}: expected at most 80 letters, digits and _ . + -, since "
            "it is part of a folder's name."
        )
    if flags.name.lower() in ours:  # reports write them in capitals, too
        raise ConfigError(f"--name {flags.name} is the name of a policy of ours. Choose another.")
    return flags.name
