"""Result packs, written and read: `python -m jaxcam.report RUNS… --pack FOLDER`."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from jaxcam.config.names import Split
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.whole import write_together
from jaxcam.reports.arms import Run, kind_of_pairs
from jaxcam.reports.packs.folder import check_replaces, read_results, results_texts
from jaxcam.reports.packs.manifest import (
    PACK,
    PackLabel,
    PackManifest,
    PairsOfPack,
    file_of_pack,
    read_manifest_of,
)
from jaxcam.runs.environment import package_versions

_VERSIONS = ("jaxcam", "jax", "mujoco", "robosuite")


@dataclass(frozen=True)
class Pack:
    """A pack that was read.

    Attributes:
        folder: Where it is.
        manifest: What it says of itself.
        runs: Its runs with all their rows.
    """

    folder: Path
    manifest: PackManifest
    runs: tuple[Run, ...]

    @property
    def rollouts(self) -> int:
        """How many it has."""
        return sum(len(run.rows) for run in self.runs)


def is_pack(folder: Path) -> bool:
    """Whether a folder says that it is a pack.

    Args:
        folder: Any folder.
    """
    return (folder / PACK).exists() or (folder / PACK).is_symlink()


def write_pack(folder: Path, runs: Sequence[Run], split: Split, about: PackLabel) -> Pack:
    """Write a pack, and read it as others will.

    Args:
        folder: Where it goes: nothing yet, or a pack whose rows are among these.
        runs: What it has; those without rows are left out.
        split: Which pairs their rows are of.
        about: What its authors say.

    Raises:
        ConfigError: There are no rows, or rows that do not say which pair they are of; or the
            folder has something else.
    """
    runs = [run for run in runs if run.rows]
    if not runs:
        raise ConfigError(
            f"There are no rollouts of {split} pairs to pack. Evaluate first: "
            "python -m jaxcam.evaluate."
        )
    nameless = [run.name for run in runs if any(row.pair_sha is None for row in run.rows)]
    if nameless:
        raise ConfigError(
            f"Rollouts of {len(nameless)} runs, such as {nameless[0]}, have no digest of their "
            "pair, as version 0.1.0 wrote them: nobody could tell whether others had the same "
            "pairs. Evaluate these runs anew."
        )
    _check_place(folder, runs)
    texts = results_texts(runs)
    manifest = PackManifest(
        **asdict(about),
        split=split,
        versions={k: v for k, v in package_versions().items() if k in _VERSIONS},
        pairs=pairs_of(runs),
        files={name: file_of_pack(text.encode()) for name, text in texts.items()},
    )
    texts[PACK] = json.dumps(manifest.sealed(), indent=1) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    write_together({folder / name: text for name, text in texts.items()})
    return read_pack(folder)


def read_pack(folder: Path) -> Pack:
    """A pack, if it is what was packed.

    Args:
        folder: Of the pack.

    Raises:
        DatasetError: Something in it is missing or was changed, or it does not fit together.
        ConfigError: A newer version wrote it.
    """
    manifest = read_manifest_of(folder)
    runs = tuple(read_results(folder, None))
    splits = {row.split for run in runs for row in run.rows}
    try:
        fits = splits == {manifest.split} and pairs_of(runs) == manifest.pairs
    except ConfigError:
        fits = False
    if not fits:
        raise DatasetError(
            f"{folder}: the rows are not of the pairs that {PACK} lists, so nobody can say whether "
            "they can be compared. Make the pack anew: --pack."
        )
    return Pack(folder, manifest, runs)


def pairs_of(runs: Iterable[Run]) -> tuple[PairsOfPack, ...]:
    """Digests of the pairs that rows are of.

    Args:
        runs: With rows of one split.

    Raises:
        ConfigError: Two rows have different pairs of one number.
    """
    kinds: dict[tuple[str, str, int | None], dict[int, str]] = {}
    for run in runs:
        pairs = kinds.setdefault(kind_of_pairs(run.settings), {})
        for row in run.rows:
            digest = row.pair_sha or "none"
            if pairs.setdefault(row.pair, digest) != digest:
                raise ConfigError(
                    f"{run.source or run.name} has different pairs of the number {row.pair}."
                )
    return tuple(
        PairsOfPack(*kind, {str(number): pairs[number] for number in sorted(pairs)})
        for kind, pairs in sorted(kinds.items(), key=str)
        if pairs
    )


def _check_place(folder: Path, runs: Sequence[Run]) -> None:
    """Refuses a place where something else is than a pack whose rows are among these."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigError(f"{folder} is there, and is no folder. Choose another --pack.")
    if is_pack(folder):
        check_replaces(folder, runs, "--pack")
    elif there := sorted(path.name for path in folder.iterdir()):
        raise ConfigError(
            f"{folder} has {there[0]!r} and is no pack, so nothing is written there. Choose "
            "another --pack, or an empty folder."
        )
