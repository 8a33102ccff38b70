"""`pack.json`: what a result pack is, and whether its files are what was packed.

A pack is a results folder with this file beside the two of its rows. It has the digest of each, and
of every pair that rows are of. Nothing else in the folder is read.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from jaxcam.config.fields import as_record, short
from jaxcam.config.names import Split
from jaxcam.console.words import plain_line
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.json import read_json
from jaxcam.files.jsonl import LARGEST
from jaxcam.files.paths import LARGEST_TEXT, read_bytes
from jaxcam.reports.packs.folder import ROWS, RUNS
from jaxcam.runs.manifests import seal, without_seal

PACK = "pack.json"
FORMAT = 1
"""Of packs that this version writes; it reads those up to it."""
_LARGEST = {PACK: 1 << 22, ROWS: LARGEST, RUNS: LARGEST_TEXT}
_MOST_LETTERS = {"name": 80, "authors": 400, "link": 400}
_NUMBER, _DIGEST = re.compile("[0-9]{1,9}"), re.compile("[0-9a-f]{16}")
_LINK = re.compile(r"https?://[\w.-]+(:\d+)?(/[!-~]*)?", re.ASCII)


@dataclass(frozen=True)
class PairsOfPack:
    """The pairs that rows of one task, scene and number of cameras are of."""

    task: str
    scene: str
    views: int | None
    digests: dict[str, str]
    """By number, as rows have them."""

    def __post_init__(self) -> None:
        for number, digest in self.digests.items():
            if not (_NUMBER.fullmatch(number) and _DIGEST.fullmatch(digest)):
                raise ConfigError(f"No pair has the number {number!r:.40} and {digest!r:.40}.")


@dataclass(frozen=True)
class FileOfPack:
    """A file as it was packed."""

    size: int
    sha256: str


@dataclass(frozen=True)
class PackLabel:
    """What authors say of a pack; shown, and otherwise without a meaning."""

    name: str
    authors: str = ""
    link: str = ""

    def __post_init__(self) -> None:
        for what, most in _MOST_LETTERS.items():
            text = getattr(self, what)
            if len(text) > most or plain_line(text) != text:
                raise ConfigError(
                    f"The {what} of a pack is a line of at most {most} letters, got {text!r:.100}."
                )
        if not self.name.strip():
            raise ConfigError("A pack needs a name: give --pack-name.")
        if self.link and not _LINK.fullmatch(self.link):
            raise ConfigError(
                f"The link of a pack is one such as https://example.org/x, got {self.link!r:.100}."
            )


@dataclass(frozen=True)
class PackManifest(PackLabel):
    """All that `pack.json` says, without its format and its seal.

    Attributes:
        split: Which pairs: "test" or "validation".
        versions: Of the packages that the pack was written with.
        pairs: What its rows are of.
        files: Its files by name.
    """

    split: Split = "test"
    versions: dict[str, str] = field(default_factory=dict)
    pairs: tuple[PairsOfPack, ...] = ()
    files: dict[str, FileOfPack] = field(default_factory=dict)

    def sealed(self) -> dict[str, Any]:
        """As it is written."""
        return seal({"format": FORMAT} | json.loads(json.dumps(asdict(self))))

    @property
    def digest(self) -> str:
        """What tells this pack from all others."""
        return self.sealed()["sha256"]

    def written_with(self) -> str:
        """The versions in words."""
        names = ("jaxcam", "mujoco", "robosuite")
        return ", ".join(f"{k} {plain_line(self.versions.get(k, 'unknown'))}" for k in names)


def file_of_pack(content: bytes) -> FileOfPack:
    """A file's record.

    Args:
        content: All of it.
    """
    return FileOfPack(len(content), hashlib.sha256(content).hexdigest())


def read_manifest_of(folder: Path) -> PackManifest:
    """The manifest of a pack, whose files are then as they were packed.

    Args:
        folder: Of the pack.

    Raises:
        DatasetError: Something is missing, was changed or is too large, or the manifest is not what
            is written.
        ConfigError: A newer version wrote it.
    """
    content = read_json(_own_file(folder, PACK))
    if not isinstance(content, Mapping):
        raise DatasetError(f"{folder / PACK}: expected names and values.")
    given = dict(cast("Mapping[str, Any]", content))
    number = given.get("format")
    if type(number) is not int or number < 1:
        raise DatasetError(f"{folder / PACK}: format is {short(number)}, expected {FORMAT}.")
    if number > FORMAT:
        raise ConfigError(
            f"{folder} is a pack of format {short(number)}, which a newer jaxcam wrote; this one "
            f"reads {FORMAT}. Update jaxcam, or leave this pack out."
        )
    try:
        manifest = _manifest({k: v for k, v in without_seal(given).items() if k != "format"})
    except ConfigError as error:
        raise DatasetError(
            f"{folder / PACK} is not what jaxcam writes: {error} {_ADVICE}"
        ) from error
    if given != manifest.sealed():
        raise DatasetError(f"{folder / PACK} has changed since it was written. {_ADVICE}")
    for name, record in manifest.files.items():
        _check_file(folder, name, record)
    return manifest


_ADVICE = "Get the pack again from where it is from, or make it anew: --pack."


def _manifest(given: dict[str, Any]) -> PackManifest:
    parts: dict[str, Any] = {}
    if isinstance(given.get("pairs"), list):
        parts["pairs"] = [as_record(PairsOfPack, p, "pack's pairs") for p in given["pairs"]]
    if isinstance(given.get("files"), dict):
        files: dict[str, Any] = given["files"]
        parts["files"] = {
            name: as_record(FileOfPack, record, "pack's file") for name, record in files.items()
        }
    manifest = as_record(PackManifest, given | parts, "pack")
    if manifest.files.keys() != {ROWS, RUNS}:
        names = ", ".join(map(repr, manifest.files))
        raise ConfigError(f"A pack has the files {ROWS} and {RUNS}, not {names:.200}.")
    return manifest


def _own_file(folder: Path, name: str) -> Path:
    """A file in a pack: no link, which would show what lies elsewhere, and not too large."""
    path = folder / name
    if path.is_symlink():
        raise DatasetError(f"{path} is a link, but a pack has its own files. {_ADVICE}")
    if not path.is_file():
        raise DatasetError(f"{folder} has no {name}, so it is no whole pack. {_ADVICE}")
    if (size := path.stat().st_size) > _LARGEST[name]:
        most = _LARGEST[name] / 1e6
        raise DatasetError(f"{path} has {size / 1e6:.0f} MB, but at most {most:.0f} MB are read.")
    return path


def _check_file(folder: Path, name: str, record: FileOfPack) -> None:
    path = _own_file(folder, name)
    try:
        actual = file_of_pack(read_bytes(path, _LARGEST[name]))
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}.") from error
    if actual != record:
        raise DatasetError(
            f"{path} is not the file that was packed: it has {actual.size} bytes and the SHA-256 "
            f"{actual.sha256[:12]}…, packed were {record.size} and {record.sha256[:12]}…. {_ADVICE}"
        )
