"""The policy servers of a sheet: that they are there, and can be compared with each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxcam.client import Client
from jaxcam.errors import ConfigError, PortError
from jaxcam.files.keys import read_key
from jaxcam.robot.driver import Robot
from jaxcam.robot.trials.sheet import PolicyEntry, Sheet

ALIKE = (
    "task",
    "views",
    "views_at_once",
    "state_names",
    "action_names",
    "action_space",
    "rotations",
    "rate",
)
"""What servers say of themselves that policies of one sheet have in common: one robot, one task."""
PATIENCE = 3.0
"""Seconds to wait for a server that is not there."""


@dataclass(frozen=True)
class Served:
    """A policy, and what its server says of it."""

    entry: PolicyEntry
    key: str | None
    metadata: Mapping[str, Any]

    @property
    def views(self) -> tuple[str, ...]:
        """What it calls what it sees; empty if it does not say."""
        given = self.metadata.get("views")
        return tuple(map(str, given)) if isinstance(given, list | tuple) else ()

    @property
    def views_at_once(self) -> int:
        """How many of them it sees; 0 if it does not say."""
        given = self.metadata.get("views_at_once")
        return given if isinstance(given, int) else len(self.views)

    @property
    def execute(self) -> int | None:
        """Steps of a chunk that are executed; None is all of them."""
        given = self.entry.execute or self.metadata.get("execute")
        return given if isinstance(given, int) and given > 0 else None

    @property
    def weights_sha(self) -> str:
        """Digest of its weights; empty if it does not say."""
        return str(self.metadata.get("weights_sha") or "")

    def connect(self, timeout: float = 10.0) -> Client:
        """A connection to its server.

        Args:
            timeout: Seconds to wait for an answer.

        Raises:
            PortError: It is gone.
        """
        return Client(self.entry.url, key=self.key, timeout=timeout, patience=PATIENCE)


def ask_policies(sheet: Sheet, folder: Path) -> list[Served]:
    """The policies of a sheet, each asked what it is.

    Args:
        sheet: The sheet.
        folder: Of the sheet, where relative paths begin.

    Raises:
        PortError: A server is not there, or does not take the key.
        ConfigError: Policies cannot be compared, or do not fit to the sheet.
    """
    served = []
    for entry in sheet.policies:
        key = _key(entry, folder)
        try:
            with Client(entry.url, key=key, timeout=10.0, patience=PATIENCE) as client:
                served.append(Served(entry, key, dict(client.metadata)))
        except PortError as error:
            hint = "" if key else " If it asks for a key, give key_file."
            raise PortError(f"Policy {entry.name!r} of the sheet: {error}{hint}") from error
    _check_alike(served)
    for one in served:
        _check_cameras(one, sheet)
    return served


def _key(entry: PolicyEntry, folder: Path) -> str | None:
    if entry.key_file is None:
        return None
    return read_key(folder / entry.key_file, f"Policy {entry.name!r}: key_file")


def _check_alike(served: Sequence[Served]) -> None:
    """Refuses policies that want or give different things."""
    for name in ALIKE:
        known = [(one, one.metadata[name]) for one in served if one.metadata.get(name) is not None]
        for one, value in known[1:]:
            first, expected = known[0]
            if value != expected:
                raise ConfigError(
                    f"The policies of the sheet cannot be compared: {name} of "
                    f"{first.entry.name!r} is {expected}, of {one.entry.name!r} it is {value}. "
                    "One robot drives them all, so these must be the same. Serve other runs, or "
                    "write a sheet for each."
                )


def _check_cameras(one: Served, sheet: Sheet) -> None:
    """Refuses a policy that sees another number of cameras, or is not told where they stand."""
    where = f"Policy {one.entry.name!r}"
    if sheet.cameras is not None and one.views_at_once not in (0, sheet.used):
        raise ConfigError(
            f"{where} sees {one.views_at_once} views at once, of {', '.join(one.views)}; the sheet "
            f"uses {sheet.used} of its cameras. Set 'use' to {one.views_at_once}, or serve another "
            "run."
        )
    told_by_us = sheet.cameras is not None and sheet.cameras.file is not None
    if one.metadata.get("needs_cameras") and not one.metadata.get("cameras_given"):
        if sheet.cameras is not None and not told_by_us:
            raise ConfigError(
                f"{where} is told where its cameras are, and the sheet has no calibrations. Give "
                "'file' under 'cameras', or start its server with --cameras."
            )
    elif told_by_us and one.metadata.get("cameras_given"):
        raise ConfigError(
            f"{where} has the cameras of a file that its server was started with, and the sheet "
            "has a file too. Start the server without --cameras: the poses of this trial change."
        )


def check_robot(robot: Robot, served: Sequence[Served]) -> None:
    """Refuse policies of another rate, or of other actions, than the robot's.

    Args:
        robot: What drives, as far as it says what it takes.
        served: The policies.

    Raises:
        ConfigError: One is.
    """
    for one in served:
        for name in ("rate", "action_space", "rotations"):
            given, taken = one.metadata.get(name), getattr(robot, name, None)
            if given is not None and taken is not None and given != taken:
                raise ConfigError(
                    f"Policy {one.entry.name!r}: its {name} is {given}, and the robot's is {taken}."
                    " The robot would do something else than the policy means."
                )
