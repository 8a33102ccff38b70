"""A sheet: what is tried on a robot, by whom, seen how, from where, and what counts as success.

    task: Pick Place
    success: The cup is in the bowl.
    half: The cup was lifted and slipped.
    policies:
      - {name: ACT with poses, url: "ws://127.0.0.1:8000"}
      - {name: ACT without, url: "ws://127.0.0.1:8001"}
    robot: none                        # or my_robot:UR5
    cameras:
      names: [left, right, top]
      use: 2
      file: cameras.json
      placements: ["1", "2", "3", "4", "5", "6", "7"]
    starts: [Cup on 1. Bowl on A., Cup on 2. Bowl on A.]

`docs/robot.md` tells all entries.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from jaxcam.client import check_address
from jaxcam.config.fields import as_record, check_least, check_most, short
from jaxcam.errors import ConfigError, NoServerError
from jaxcam.files.yaml import read_yaml

MOST = 100_000
"""Rollouts of a sheet."""


@dataclass(frozen=True)
class PolicyEntry:
    """A policy server, and what the report calls it."""

    name: str
    url: str
    """Such as ws://127.0.0.1:8000."""
    key_file: str | None = None
    """File with the key that the server asks for; a relative path starts at the sheet."""
    execute: int | None = None
    """Steps of a chunk that are executed; what the server says, else the whole chunk."""


@dataclass(frozen=True)
class CamerasEntry:
    """The cameras, and which of them a policy sees."""

    names: tuple[str, ...]
    """What the robot calls them."""
    use: int | None = None
    """How many of them are used in a rollout, every choice in its turn; all when None."""
    file: str | None = None
    """Their calibrations, as docs/calibrated-datasets.md has them; the policies are told them."""
    placements: tuple[str | int, ...] = ()
    """Where the cameras stand: names of episodes in that file. Without any they never move."""


@dataclass(frozen=True)
class Sheet:
    """What is tried."""

    task: str
    success: str
    """What counts as success, for the operator."""
    half: str
    """What counts as half a success; paper, section V-C."""
    policies: tuple[PolicyEntry, ...]
    starts: tuple[str, ...]
    """Each a marked initial position of the objects, in words."""
    cameras: CamerasEntry | None = None
    prompt: str | None = None
    """The task in words, for policies that read."""
    robot: str = "none"
    """`module:Class` of a driver; with `none` the operator's own loop asks at `listen`."""
    robot_settings: dict[str, Any] | None = None
    """What the driver's class is called with."""
    listen: int = 8100
    """Port of this machine at which the policies are asked, where robot is `none`."""
    seconds: float = 60.0
    """After which a rollout is over."""
    repeats: int = 1
    """How often each combination of cameras is tried."""
    seed: int = 0
    """Of the order and the letters."""

    def __post_init__(self) -> None:
        check_least(self, 0, "seed")
        check_least(self, 1, "repeats listen")
        check_least(self, 0, "seconds", or_equal=False)
        check_most(self, 2**32 - 1, "seed")
        check_most(self, 65535, "listen")
        check_most(self, 3600, "seconds")
        check_most(self, 1000, "repeats")

    @property
    def used(self) -> int:
        """Cameras that a policy sees; 0 if the sheet says nothing of cameras."""
        if self.cameras is None:
            return 0
        return len(self.cameras.names) if self.cameras.use is None else self.cameras.use

    @property
    def placements(self) -> tuple[str, ...]:
        """Names of where the cameras stand; one without a name if they never move."""
        given = self.cameras.placements if self.cameras else ()
        return tuple(map(str, given)) or ("",)

    @property
    def placed(self) -> bool:
        """Whether the cameras are moved."""
        return bool(self.cameras and self.cameras.placements)

    def lasting(self) -> dict[str, Any]:
        """What must not change while a trial goes on: all but addresses, keys and the robot."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _PASSING}
        values["policies"] = [
            {"name": policy.name, "execute": policy.execute} for policy in self.policies
        ]
        values["cameras"] = self.cameras and {
            "names": [*self.cameras.names],
            "use": self.used,
            "calibrated": self.cameras.file is not None,
            "placements": [*self.placements],
        }
        return values | {"starts": [*self.starts]}


_PASSING = ("policies", "cameras", "starts", "robot", "robot_settings", "listen")
"""What may change, or is written in a form of its own."""


def read_sheet(path: Path) -> Sheet:
    """The sheet in a file of YAML.

    Args:
        path: Of the file.

    Raises:
        ConfigError: It is no such file, or an entry or a value in it is unknown or impossible.
    """
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected names with values, got {short(content)}.")
    where = str(path)
    raw: dict[str, Any] = {str(name): value for name, value in content.items()}
    entries = raw.get("policies")
    if isinstance(entries, Sequence) and not isinstance(entries, str):
        raw["policies"] = tuple(
            as_record(PolicyEntry, _named(entry, f"{where}: policy {i}"), f"{where}: policy {i}")
            for i, entry in enumerate(entries, start=1)
        )
    if isinstance(raw.get("cameras"), dict):
        raw["cameras"] = as_record(CamerasEntry, raw["cameras"], f"{where}: cameras")
    sheet = as_record(Sheet, raw, where)
    _check(sheet, where)
    return sheet


def _named(entry: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(entry, dict):
        raise ConfigError(f"{where}: expected {{name: …, url: …}}, got {short(entry)}.")
    return entry


def _check(sheet: Sheet, where: str) -> None:
    """Refuses what cannot be tried."""
    _spoken(where, sheet)
    if not sheet.policies:
        raise ConfigError(f"{where}: policies is empty. Name at least one.")
    if len(sheet.policies) > 26:
        raise ConfigError(f"{where}: {len(sheet.policies)} policies; at most 26, for the letters.")
    if not sheet.starts:
        raise ConfigError(f"{where}: starts is empty. Say where the objects are put.")
    _once(f"{where}: policies", "name", [policy.name for policy in sheet.policies])
    _once(f"{where}: policies", "url", [policy.url.rstrip("/") for policy in sheet.policies])
    for i, policy in enumerate(sheet.policies, start=1):
        _spoken(f"{where}: policy {i}", policy)
        try:
            check_address(policy.url)
        except NoServerError as error:
            raise ConfigError(f"{where}: policy {policy.name!r}: url {error}") from error
        if policy.execute is not None and policy.execute < 1:
            raise ConfigError(f"{where}: policy {policy.name!r}: execute must be at least 1.")
    _once(f"{where}: starts", "start", sheet.starts)
    if sheet.cameras is not None:
        _check_cameras(sheet.cameras, f"{where}: cameras")
    if (count := len(sheet.policies) * sheet.repeats * _combinations(sheet)) > MOST:
        raise ConfigError(f"{where}: {count:,} rollouts, more than {MOST:,}.")


def _check_cameras(cameras: CamerasEntry, where: str) -> None:
    if not cameras.names:
        raise ConfigError(f"{where}: names is empty. Name the cameras, or leave 'cameras' out.")
    _spoken(where, cameras)
    for name in cameras.names:
        if "/" in name:
            raise ConfigError(f"{where}: the name {name!r:.80} has a slash. Use dots, or others.")
    _once(where, "name", cameras.names)
    _once(where, "placement", [*map(str, cameras.placements)])
    if cameras.use is not None and not 1 <= cameras.use <= len(cameras.names):
        raise ConfigError(
            f"{where}: use is {cameras.use}, of {len(cameras.names)} cameras "
            f"({', '.join(cameras.names)})."
        )
    if cameras.placements and cameras.file is None:
        raise ConfigError(
            f"{where}: placements without 'file': they are names of episodes in a file of "
            "calibrations (docs/calibrated-datasets.md)."
        )


def _combinations(sheet: Sheet) -> int:
    chosen = math.comb(len(sheet.cameras.names), sheet.used) if sheet.cameras else 1
    return max(len(sheet.placements) * chosen, len(sheet.starts))


def _once(where: str, what: str, names: Sequence[str]) -> None:
    for name, count in Counter(name.strip() for name in names).items():
        if count > 1:
            raise ConfigError(f"{where}: the {what} {name!r:.80} is there twice.")


def _spoken(where: str, entry: Sheet | PolicyEntry | CamerasEntry) -> None:
    """Refuses texts of an entry that say nothing, and names that are more than a line."""
    for field in fields(entry):
        value = getattr(entry, field.name)
        for text in value if isinstance(value, tuple) else (value,):
            if isinstance(text, str) and not text.strip():
                raise ConfigError(f"{where}: {field.name} is empty, or has one that is. Say it.")
            if isinstance(text, str) and field.name not in _TEXTS and not text.isprintable():
                raise ConfigError(
                    f"{where}: {field.name} {text!r:.80} has more than one line, or what cannot be "
                    "printed."
                )


_TEXTS = ("success", "half", "starts", "prompt")
"""What may have several lines."""
