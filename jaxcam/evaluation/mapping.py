"""What a foreign policy is sent: our observation, under its names.

Ours are those of `docs/your-policy.md`: pictures, state, cameras, and words. Without a map all of
them are sent; with one, what the map names.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml

from jaxcam.client import CAMERA, IMAGES, PROMPT, STATE
from jaxcam.config.fields import as_record, short
from jaxcam.config.foreign import ObsMap
from jaxcam.errors import ConfigError, closest
from jaxcam.files.paths import home
from jaxcam.files.yaml import read_yaml

CHANCE = ("call", "row")
"""Number of the question in its episode, and of the episode in its batch: what chance depends on,
where a policy draws it as ours do."""
_PART = re.compile(r"([^\[\]]+)(?:\[(\d{1,6}):(\d{1,6})\])?")


@dataclass(frozen=True)
class Excerpt:
    """An entry of our observation, or numbers of it.

    Attributes:
        name: Of the entry.
        span: The first of its last axis, and the one after the last; all when None.
    """

    name: str
    span: tuple[int, int] | None = None

    def of(self, ours: Mapping[str, Any]) -> Any:
        """What it is of an observation."""
        value = ours[self.name]
        return value if self.span is None else value[..., slice(*self.span)]


Names = Mapping[str, tuple[Excerpt, ...]]
"""Their names, and of which parts of ours each is made."""


def read_map(file: str) -> ObsMap:
    """What a file says of the observations that a policy wants.

    Args:
        file: YAML, see `ObsMap`.

    Raises:
        ConfigError: It is not there, is no YAML, names something twice, or has what a map has not;
            with the closest name.
    """
    path = home(file)
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(
            f"--obs {path}: expected entries such as keys and action_space, got {short(content)}."
        )
    return as_record(ObsMap, content, f"map {path}")


def write_map(file: Path, wanted: ObsMap) -> None:
    """Write a map that `read_map` reads."""
    entries = {name: value for name, value in vars(wanted).items() if value is not None}
    file.write_text(yaml.safe_dump(entries, sort_keys=False), encoding="utf-8")


def our_names(views: Sequence[str]) -> list[str]:
    """The names of our entries, with these names of views."""
    of_views = [
        (f"{IMAGES}{v}", f"{CAMERA}{v}.intrinsics", f"{CAMERA}{v}.base_from_camera") for v in views
    ]
    return [*(name for names in of_views for name in names), STATE, PROMPT]


def numbered_views(views: int) -> list[str]:
    """What our views are called."""
    return [f"view_{v}" for v in range(views)]


def names_of_map(keys: Mapping[str, Any], views: int, state: int) -> Names:
    """The names of a map, understood.

    Args:
        keys: Of an `ObsMap`.
        views: How many cameras are sent.
        state: Numbers of our state.

    Raises:
        ConfigError: An entry is of something that we have not; with the closest name.
    """
    if not keys:
        raise ConfigError(
            "keys names nothing, so nothing would be sent. Leave keys out to send all under our "
            "names."
        )
    known = [*our_names(numbered_views(views)), *CHANCE]
    return {
        theirs: tuple(_part(theirs, one, known, state) for one in _several(theirs, ours))
        for theirs, ours in keys.items()
    }


def _several(theirs: str, ours: Any) -> list[str]:
    several = cast("list[Any]", ours if isinstance(ours, list) else [ours])
    if not several or not all(isinstance(one, str) for one in several):
        raise ConfigError(
            f"keys, {theirs}: expected a name of ours, such as observation.state[0:7], or a list "
            f"of such, got {short(ours)}."
        )
    if len(several) > 1 and not all(one.replace("/", ".").startswith(STATE) for one in several):
        raise ConfigError(f"keys, {theirs}: only parts of {STATE} can be joined, got {several}.")
    return several


def _part(theirs: str, text: str, known: Sequence[str], state: int) -> Excerpt:
    match = _PART.fullmatch(text.replace("/", "."))
    name = match[1] if match else text
    if match is None or name not in known:
        raise ConfigError(f"keys, {theirs}: we have no {text!r:.80}{closest(name, known)}.")
    if match[2] is None:
        return Excerpt(name)
    span = int(match[2]), int(match[3])
    if name != STATE:
        raise ConfigError(f"keys, {theirs}: only {STATE} has parts, got {text!r}.")
    if not span[0] < span[1] <= state:
        raise ConfigError(
            f"keys, {theirs}: {STATE} has the numbers 0 to {state - 1}, as [0:{state}]; got "
            f"{text!r}."
        )
    return Excerpt(name, span)


def renamed(views: Sequence[str], *more: str) -> Names:
    """All that is ours, under its own names, but for those of the views.

    Args:
        views: What they are called instead, in order.
        *more: What else is sent, of `CHANCE`.
    """
    theirs = [*our_names(views), *more]
    ours = [*our_names(numbered_views(len(views))), *more]
    return {there: (Excerpt(here),) for there, here in zip(theirs, ours, strict=True)}


def observation_sent(
    obs: Mapping[str, np.ndarray], call: int, episode: int, prompt: str
) -> dict[str, Any]:
    """Our observation of one episode, under our names; arrays that nobody else has.

    Args:
        obs: Of a batch, as `jaxcam.sim.rollout` hands it out, with [B, V, ...] or, for policies
            that see several observations, [B, S, V, ...].
        call: Number of the question in its episode.
        episode: Its number in the batch.
        prompt: What the policy is told to do.
    """
    image, state = obs["image"][episode], obs["proprio"][episode]
    K, pose = obs["K"][episode], obs["base_from_camera"][episode]
    lens = obs["distortion"][episode] if "distortion" in obs else None
    if state.ndim > 1:  # cameras stand still: what holds now, holds for all
        image, K, pose = image.swapaxes(0, 1), K[-1], pose[-1]
        lens = None if lens is None else lens[-1]
    ours: dict[str, Any] = {STATE: np.array(state, np.float32), PROMPT: prompt}
    ours |= zip(CHANCE, (call, episode), strict=True)
    for v, name in enumerate(numbered_views(len(K))):
        ours[f"{IMAGES}{name}"] = np.array(image[v])
        ours[f"{CAMERA}{name}.intrinsics"] = np.array(K[v], np.float32)
        ours[f"{CAMERA}{name}.base_from_camera"] = np.array(pose[v], np.float32)
        if lens is not None:
            ours[f"{CAMERA}{name}.distortion"] = np.array(lens[v], np.float32)
    return ours


def sent(names: Names, ours: Mapping[str, Any]) -> dict[str, Any]:
    """Our observation under their names.

    Args:
        names: From `names_of_map` or `renamed`.
        ours: From `observation_sent`.
    """
    return {
        theirs: parts[0].of(ours)
        if len(parts) == 1
        else np.concatenate([part.of(ours) for part in parts], -1)
        for theirs, parts in names.items()
    }
