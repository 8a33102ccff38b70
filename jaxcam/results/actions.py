"""How far a policy's actions are from recorded ones; what stands for success without a robot."""

import operator
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.stats import t as student

from jaxcam.errors import DatasetError

OF_MEAN = 0.8
"""Error, in deviations, of an action that is always the mean, where actions are spread normally:
the square root of 2/π."""
LEAST_SCALE = 1e-4
"""Deviation below which a number of an action stands still."""


@dataclass(frozen=True)
class ActionErrors:
    """Errors of a checkpoint's actions on some held-out episodes.

    Attributes:
        step: Updates of the checkpoint.
        group: Which episodes and cameras, such as "new cameras".
        rotation_deg: By how much the poses that the policy was told were turned.
        translation: By how much they were moved, in metres.
        names: Of the A numbers of an action.
        scale: Their deviations in training, in their units [A].
        errors: Mean absolute errors by episode, step of the chunk and number, in the units of the
            actions, [E, T, A]; NaN where no episode reaches so far.
    """

    step: int
    group: str
    rotation_deg: float
    translation: float
    names: tuple[str, ...]
    scale: np.ndarray
    errors: np.ndarray

    @property
    def relative(self) -> np.ndarray:
        """Errors in deviations of the actions in training [E, T, A]."""
        return self.errors / np.maximum(self.scale, LEAST_SCALE)

    def mean(self) -> tuple[float, float, float]:
        """The mean error in deviations, and its 95 % interval over episodes.

        The interval is Student's, since episodes are few: a bootstrap of five covers the true mean
        in 83 % of cases. (value, NaN, NaN) of a single one.
        """
        by_episode = np.nanmean(self.relative, (1, 2))
        value = float(by_episode.mean())
        if len(by_episode) < 2:
            return value, float("nan"), float("nan")
        count = len(by_episode)
        error = by_episode.std(ddof=1) / np.sqrt(count)
        half = float(student.ppf(0.975, count - 1) * error)
        return value, max(0.0, value - half), value + half

    def to_json(self) -> dict[str, Any]:
        """As JSON has it, NaN as null."""
        errors = [[[x if x == x else None for x in a] for a in t] for t in self.errors.tolist()]
        arrays = {"names": list(self.names), "scale": self.scale.tolist(), "errors": errors}
        return vars(self) | arrays

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "ActionErrors":
        """What `to_json` gave.

        Raises:
            DatasetError: Values are missing, unknown, or of other types or sizes.
        """
        if set(values) != {f.name for f in fields(cls)}:
            raise DatasetError(f"no row of action errors: it has {sorted(values)}.")
        try:
            row = cls(
                step=operator.index(values["step"]),
                group=str(values["group"]),
                rotation_deg=float(values["rotation_deg"]),
                translation=float(values["translation"]),
                names=tuple(str(name) for name in values["names"]),
                scale=np.array(values["scale"], float),
                errors=np.array(values["errors"], float),
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise DatasetError(f"no row of action errors: {error}.") from error
        numbers = [row.rotation_deg, row.translation, *row.scale.ravel()]
        sizes = row.errors.shape[2:] == row.scale.shape == (len(row.names),)
        if not (sizes and row.errors.size and np.isfinite(numbers).all()):
            raise DatasetError("no row of action errors: its values do not fit together.")
        return row
