"""The rows of rollouts on disk: where a run has them, how they are read, and whose they are."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from jaxcam.config.conditions import Conditions, of_task
from jaxcam.config.names import EvaluationSplit, names_of
from jaxcam.config.train import TrainConfig
from jaxcam.errors import DatasetError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.files.paths import absolute, read_text
from jaxcam.results.rows import Row
from jaxcam.runs.foreign import ForeignRecord, has_foreign, read_foreign_record
from jaxcam.runs.identity import RECORDED, read_config
from jaxcam.sim import make_task

_OF_RUN = ("task", "scene", "policy", "conditioning", "seed")
"""What rows share with their run's settings."""


def rows_file(run: Path) -> Path:
    """The file of a run's rows, one a rollout."""
    return run / "eval" / "rows.jsonl"


def read_rows(file: Path) -> list[Row]:
    """The rows of a file in the order they were written; none if it is missing.

    Raises:
        DatasetError: A line is damaged, or is no row.
    """
    lines = read_jsonl(file)
    return [Row.from_json(x, f"{file}, line {number}") for number, x in enumerate(lines, start=1)]


def read_run_rows(run: Path) -> list[Row]:
    """The rows of a run's folder, each held against the run, with the name that it has now.

    A folder may have been renamed, so its rows may have another name; all that were written before
    rows had a digest of the weights must then have the same.

    Args:
        run: Folder of the run.

    Raises:
        DatasetError: A row is of other settings, weights or pairs than the run's, or a rollout has
            two outcomes.
        ConfigError: The run's config.json, or a foreign policy's foreign.json, is damaged.
    """
    run = absolute(run)
    rows = read_rows(rows_file(run))
    if not rows:
        return []
    config = _said_of(run)
    known = OneRun(
        {step: _acted(run, step, config) for step in {row.step for row in rows}},
        {split: _stored_pairs(run, split) for split in {row.split for row in rows}},
    )
    for number, row in enumerate(rows, start=1):
        if wrong := _settings(row, config) + known.faults(row):
            raise DatasetError(
                f"{rows_file(run)}, line {number}: this row of pair {row.pair} at step {row.step} "
                f"is not of this run ({'; '.join(wrong)}). Remove what was put there from "
                f"elsewhere, or move {run / 'eval'} away and evaluate anew."
            )
    return [replace(row, run=run.name) for row in rows]


def as_usual(rows: Iterable[Row], config: TrainConfig | ForeignRecord) -> list[Row]:
    """The rows of the conditions that are a run's own: no errors of poses, cameras as in training.

    Args:
        rows: Of the run.
        config: Its settings, or what is known of a foreign policy, which is shown usual cameras.
    """
    said = tuple(own_conditions(config).said.values())
    return [row for row in rows if row.conditions == said]


def own_conditions(config: TrainConfig | ForeignRecord) -> Conditions:
    """The conditions that are a run's own; see `as_usual`."""
    if isinstance(config, TrainConfig) and config.task != RECORDED:
        return of_task(config.conditions, make_task(config.task).fovy_deg)
    return Conditions()


class OneRun:
    """What rows of one run share: the weights of a step, the pair of a number, and one outcome.

    Args:
        weights: Digests of the weights that are known, by step.
        pairs: Digests of the pairs that are known, by split and number.
    """

    def __init__(
        self,
        weights: Mapping[int, str | None] | None = None,
        pairs: Mapping[str, dict[int, str]] | None = None,
    ) -> None:
        self._weights: dict[int, str | None] = dict(weights or {})
        self._pairs: dict[str, dict[int, str]] = dict(pairs or {})
        self._outcomes: dict[tuple[Any, ...], tuple[Any, ...]] = {}
        self._named: str | None = None

    def faults(self, row: Row) -> list[str]:
        """In what a row is not of the run of those before it; it is then one of them."""
        wrong: list[str] = []
        if row.weights_sha:
            known = self._weights[row.step] = self._weights.get(row.step) or row.weights_sha
            wrong += _unlike("weights", row.weights_sha, known)
        elif row.run:
            self._named = self._named or row.run
            wrong += _unlike("run", row.run, self._named)
        wrong += _pair(row, self._pairs.setdefault(row.split, {}))
        if row.finished:
            outcome = (row.success, row.steps)
            way = (row.step, row.split, *row.way, *row.conditions, row.pair)
            if self._outcomes.setdefault(way, outcome) != outcome:
                wrong.append("a second outcome of a rollout that had one")
        return wrong


def of_one_run(rows: Iterable[tuple[str, Row]]) -> list[Row]:
    """Rows that are said to be of one run, whose folder is elsewhere.

    Args:
        rows: Each with where it is: "rows.jsonl, line 3".

    Raises:
        DatasetError: A row is of other weights or pairs, or a rollout has two outcomes.
    """
    known, kept = OneRun(), list[Row]()
    for where, row in rows:
        if wrong := known.faults(row):
            raise DatasetError(
                f"{where}: this row of pair {row.pair} at step {row.step} is not of the run of "
                f"those before it ({'; '.join(wrong)}). Remove what was put there from elsewhere."
            )
        kept.append(row)
    return kept


def weights_digest(described: Mapping[str, Sequence[Any]]) -> str:
    """A digest of weights, the same for a checkpoint on disk and for what acts.

    Args:
        described: Dtype, shape and SHA-256 of each array by its name, without the item that holds
            it: "encoder/kernel".
    """
    text = json.dumps(sorted([name, *what] for name, what in described.items()))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def stored_weights(run: Path, step: int) -> str | None:
    """The digest of the weights that are evaluated of a checkpoint, as its manifest says.

    Args:
        run: Folder of the run.
        step: Updates of the checkpoint.

    Returns:
        The digest; None where there is no such checkpoint any more, or its manifest is damaged,
        which those find who load it.
    """
    try:
        text = read_text(run / "checkpoints" / str(step) / "manifest" / "metadata")
        items: dict[str, dict[str, Any]] = {}
        for name, what in json.loads(text)["leaves"].items():
            item, _, rest = name.partition("/")
            items.setdefault(item, {})[rest] = what
        chosen = items.get("ema") or items.get("params")
        return weights_digest(chosen) if chosen else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _said_of(run: Path) -> TrainConfig | ForeignRecord | None:
    """What a folder says of whom its rows are; None where it says nothing."""
    if (run / "config.json").is_file():
        return read_config(run)
    return read_foreign_record(run) if has_foreign(run) else None


def _acted(run: Path, step: int, config: TrainConfig | ForeignRecord | None) -> str | None:
    """The digest of what acts, as far as the folder says."""
    if isinstance(config, ForeignRecord):
        return config.weights_sha
    return stored_weights(run, step)


def _settings(row: Row, config: TrainConfig | ForeignRecord | None) -> list[str]:
    """In what a row is of other settings than its run."""
    if config is None:
        return []
    return [
        words
        for name in _OF_RUN
        if (value := getattr(row, name)) is not None
        for words in _unlike(name, value, getattr(config, name))
    ]


def _pair(row: Row, known: dict[int, str]) -> list[str]:
    """In what a row is of another pair than the one of its number; older rows do not say."""
    if row.pair_sha is None:
        return []
    return _unlike("pair", row.pair_sha, known.setdefault(row.pair, row.pair_sha))


def _unlike(what: str, got: Any, expected: Any) -> list[str]:
    return [] if got == expected else [f"{what} {got!r}, expected {expected!r}"]


def _stored_pairs(run: Path, split: str) -> dict[int, str]:
    """Digests of the pairs that were written down beside the rows; none without them.

    Raises:
        DatasetError: The file is not what `jaxcam.data.pairs.store_pairs` writes.
    """
    if split not in names_of(EvaluationSplit):
        return {}  # a name from a file is no path
    file = rows_file(run).with_name(f"pairs-{split}.json")
    if not file.is_file():
        return {}
    try:
        records = cast(Iterable[Any], json.loads(read_text(file))["pairs"])
        return {number: str(record["sha"]) for number, record in enumerate(records)}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(
            f"{file} is damaged: expected the pairs of an evaluation. Move it away; the next "
            "evaluation writes it again."
        ) from error
