"""A row: what is kept of one rollout, and the only place that reads and writes its JSON."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any, Literal, Self, cast, get_args

from jaxcam.errors import DatasetError

Status = Literal["ok", "policy", "simulator", "error"]
"""How a rollout ended. "ok": at success or the horizon. "policy": the policy gave actions of
another shape or that are no numbers, which is its failure and counts as one. "simulator": the
physics failed, so there is no outcome. "error": one of these two, as rows of version 0.1.0 have it;
it has no outcome, since nobody knows which."""
SEEN = "train"
"""The split of new starts on cameras that training saw: what it gives is memory, and no result."""
OUTCOMES: tuple[Status, ...] = ("ok", "policy")
"""With these a rollout has an outcome."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One rollout of a policy on one pair of an initial state and a camera pose.

    Rows of older versions lack fields; they have the defaults here, where None is "not known".

    Attributes:
        task: Name of the task.
        scene: "fixed" or "randomized".
        run: Name of the run's folder.
        policy: Kind of policy, such as "act".
        conditioning: How the policy is given its camera.
        seed: Of the training.
        step: Updates of the checkpoint.
        split: Which pairs: "test" or "validation"; "train" is on cameras that training saw.
        pair: Number of the pair.
        pair_sha: Digest of the pair: runs are compared on the same ones only.
        weights_sha: Digest of the weights that acted, see `jaxcam.runs.rollouts.weights_digest`.
        success: The outcome; None if there is none.
        status: How the rollout ended.
        steps: Control steps to success, or until the episode was cut.
        azimuth_deg: Of the first camera about the middle of the task, in degrees.
        elevation_deg: Of the first camera, in degrees.
        distance: Of the first camera, in metres.
        camera: World-from-camera matrices [views, 4, 4], OpenCV axes.
        renderer: What drew the pictures.
        engine: What stepped the physics.
        ensemble: Rate of temporal ensembling; 0 is off.
        width: Rollouts simulated at once; it may change a result's last digits.
        episode_seed: Of the initial state.
        cause: Why the policy gave no actions, in words, where that is known.
        eval_pose_noise: Error of the poses that the policy was told, such as "1,0.5" (degrees, cm);
            this and what follows is None where it was as usual, see
            `jaxcam.config.conditions.Conditions`.
        eval_pose_drift: How fast that error grew, by the second.
        eval_fovy: Range that the fields of view were drawn from (degrees).
        eval_aspect: Range of aspects.
        eval_centre: Range of principal points' distances from the middle.
        eval_lens: Range of lenses.
        fovy_deg: Vertical field of view of the first camera, where there was a range.
    """

    task: str | None = None
    scene: str | None = None
    run: str | None = None
    policy: str | None = None
    conditioning: str | None = None
    seed: int | None = None
    step: int = 0
    split: str = "test"
    pair: int
    pair_sha: str | None = None
    weights_sha: str | None = None
    success: bool | None = None
    status: Status
    steps: int | None = None
    azimuth_deg: float | None = None
    elevation_deg: float | None = None
    distance: float | None = None
    camera: list[Any] | None = None
    renderer: str | None = None
    engine: str = "native"
    ensemble: float = 0.0
    width: int | None = None
    episode_seed: int | None = None
    cause: str | None = None
    eval_pose_noise: str | None = None
    eval_pose_drift: str | None = None
    eval_fovy: str | None = None
    eval_aspect: str | None = None
    eval_centre: str | None = None
    eval_lens: str | None = None
    fovy_deg: float | None = None

    @property
    def way(self) -> tuple[Any, ...]:
        """How the rollout was computed: rows of several ways are not mixed, and the last counts."""
        return self.width, self.engine, self.ensemble

    @property
    def conditions(self) -> tuple[str | None, ...]:
        """Under which conditions, in the order of `CONDITIONS`: all of them are kept, apart."""
        return tuple(getattr(self, name) for name in CONDITIONS)

    @property
    def finished(self) -> bool:
        """Whether the rollout has an outcome, which counts."""
        return self.status in OUTCOMES and self.success is not None

    @classmethod
    def from_json(cls, content: Any, where: str = "A row") -> Self:
        """The row that was written as these names and values.

        Names that this version does not know are left out: files of rows are only appended to, so
        what a newer version wrote stays on disk.

        Args:
            content: A line of JSON, parsed.
            where: Begins the message of an error, for example "rows.jsonl, line 3".

        Raises:
            DatasetError: It has no names, a required field is missing, or a value is not of its
                field's kind.
        """
        if not isinstance(content, Mapping):
            raise DatasetError(f"{where}: expected the fields of a rollout, got {content!r}.")
        given = cast(Mapping[str, Any], content)
        values: dict[str, Any] = {}
        for name, (expected, fits, required) in _FIELDS.items():
            if name in given:
                value = given[name]
                if not fits(value):
                    raise DatasetError(f"{where}: {name} is {value!r}, expected {expected}.")
                values[name] = value
            elif required:
                raise DatasetError(f"{where}: {name} is missing, expected {expected}.")
        for name, most in _MOST.items():
            if abs(values.get(name) or 0.0) > most:
                raise DatasetError(f"{where}: {name} is {values[name]!r}, expected at most {most}.")
        row = cls(**values)
        if row.success and row.status == "policy":
            raise DatasetError(f"{where}: success is true, but status is {row.status!r}.")
        return row

    def to_json(self, only: Iterable[str] | None = None) -> dict[str, Any]:
        """Names and values as they are written, without what is not known.

        Args:
            only: Fields to write; all when None.
        """
        names = _FIELDS if only is None else only
        values = ((name, getattr(self, name)) for name in names)
        return {name: value for name, value in values if value is not None}


_MOST = {"azimuth_deg": 360.0, "elevation_deg": 90.01, "fovy_deg": 180.0}
"""Limits of angles; figures have an axis for all of them."""


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


_KINDS: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    str: ("text", lambda value: isinstance(value, str)),
    int: ("a whole number, 0 or more", _is_count),
    float: ("a finite number", _is_number),
    bool: ("true or false", lambda value: isinstance(value, bool)),
    list[Any]: ("a list", lambda value: isinstance(value, list)),
    Status: (" or ".join(get_args(Status)), lambda value: value in get_args(Status)),
}
"""What a field holds: in words, and whether a value is such."""


def _kind(annotation: Any) -> tuple[str, Callable[[Any], bool]]:
    """What a field of this type holds; where it may be None, so may the value."""
    if annotation in _KINDS:
        return _KINDS[annotation]
    (kind,) = (some for some in get_args(annotation) if some is not type(None))
    expected, fits = _KINDS[kind]
    return f"{expected}, or null", lambda value: value is None or fits(value)


_FIELDS = {field.name: (*_kind(field.type), field.default is MISSING) for field in fields(Row)}
"""Each field's kind and whether a row must have it, in the order in which they are written."""
CONDITIONS = tuple(name for name in _FIELDS if name.startswith("eval_"))
"""The fields that say what was varied in the evaluation itself; None is as usual."""
USUAL_WAY: dict[str, Any] = {"engine": Row.engine, "ensemble": Row.ensemble}
"""The fields that say how a policy was run, and how it is where nothing else is asked for."""
