"""Cameras as settings have them: errors of the poses that are told, and ranges of intrinsics.

All are short texts, which name files and arms as they are: two texts of one meaning become one.
Empty means that nothing is varied: poses as they are, and the task's own lens.
"""

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeVar

from jaxcam.errors import ConfigError, closest

Span = tuple[float, float]
"""The least and the largest value of what is drawn."""
MOST_DEGREES, MOST_CM = 180.0, 1000.0
FOVY, ASPECT, CENTRE, COEFFICIENT = (1.0, 170.0), (0.1, 10.0), (0.0, 0.45), (-10.0, 10.0)
"""What fields of view (degrees), aspects, offsets of centres and coefficients of lenses may be."""
LENSES: Mapping[str, int] = {"opencv": 5, "fisheye": 4}
"""Models of lenses, and how many of their coefficients can be drawn."""
NOMINAL = "nominal"
"""On the command line, what is empty here."""
_SAME_FOVY = 1e-4
"""Difference (degrees) up to which a field of view is the task's: a pixel of a thousand rows."""
_Settings = TypeVar("_Settings")


def degrees_and_cm(text: str, name: str = "pose_noise") -> Span:
    """An error of poses, such as "1,0.5": an angle in degrees and a distance in centimetres.

    Args:
        text: As settings have it; empty is no error.
        name: Of the setting, for messages.

    Raises:
        ConfigError: It is no such text, or an error is too large to mean anything.
    """
    if not text:
        return 0.0, 0.0
    numbers = [_number(part) for part in text.split(",")]
    if len(numbers) != 2 or not all(
        n is not None and 0 <= n <= most
        for n, most in zip(numbers, (MOST_DEGREES, MOST_CM), strict=True)
    ):
        raise ConfigError(
            f"{name} must be DEG,CM, such as 1,1: an angle up to {MOST_DEGREES:g} degrees and a "
            f"distance up to {MOST_CM:g} cm; got {text!r:.80}."
        )
    return numbers[0] or 0.0, numbers[1] or 0.0


def span(text: str, name: str, limits: Span) -> Span | None:
    """A range such as "35:55", or one value such as "45"; None where the text is empty.

    Args:
        text: As settings have it.
        name: Of the setting, for messages.
        limits: What its values may be.

    Raises:
        ConfigError: It is no such text, or a value is beyond the limits.
    """
    if not text:
        return None
    ends = [_number(part) for part in text.split(":")]
    low, high = ends[0], ends[-1]
    if len(ends) > 2 or low is None or high is None or not limits[0] <= low <= high <= limits[1]:
        raise ConfigError(
            f"{name} must be one value or LOW:HIGH, from {limits[0]:g} to {limits[1]:g}; got "
            f"{text!r:.80}."
        )
    return low, high


def lens_spans(text: str, name: str = "lens") -> tuple[str, tuple[Span, ...]] | None:
    """A range of lenses, such as "opencv:-0.3:0,0:0.1": a model and a range for each coefficient.

    Args:
        text: As settings have it: the coefficients are in OpenCV's order (k1, k2, p1, p2, k3;
            k1 to k4 of a fisheye), and those that are left out are 0.
        name: Of the setting, for messages.

    Returns:
        The model and the ranges up to the last that is not 0, none of a pinhole (a fisheye is
        none); None where the text is empty.

    Raises:
        ConfigError: It is no such text.
    """
    if not text:
        return None
    model, _, rest = text.partition(":")
    if model not in LENSES:
        raise ConfigError(
            f"{name} must begin with a model of lenses, {' or '.join(LENSES)}, as in "
            f"opencv:-0.3:0; got {model!r:.80}{closest(model, LENSES)}"
        )
    parts = rest.split(",")
    if not rest or len(parts) > LENSES[model]:
        raise ConfigError(
            f"{name}: {model} has 1 to {LENSES[model]} coefficients, as in {model}:-0.1:0.1; got "
            f"{text!r:.80}."
        )
    spans = [span(part, name, COEFFICIENT) or (0.0, 0.0) for part in parts]
    while spans and spans[-1] == (0.0, 0.0) and (model, len(spans)) != ("fisheye", 1):
        spans.pop()
    return model, tuple(spans)


@dataclass(frozen=True)
class Conditions:
    """Under which conditions a policy is evaluated, beside the pairs; empty is as usual.

    Attributes:
        pose_noise: Error of the poses that it is told, `degrees_and_cm`; constant in an episode.
        pose_drift: How fast a further error grows, by the second.
        fovy: Vertical fields of view of the cameras (degrees), `span`.
        aspect: Width over height of what a square picture shows, `span`.
        centre: Distance between principal point and middle, in heights of the picture, `span`.
        lens: `lens_spans`.
    """

    pose_noise: str = ""
    pose_drift: str = ""
    fovy: str = ""
    aspect: str = ""
    centre: str = ""
    lens: str = ""

    def __post_init__(self) -> None:
        keep_canonical(self, *(f.name for f in fields(self)))

    @classmethod
    def of(cls, settings: Any, **changes: str) -> Self:
        """Those of a run's cameras in training, with changes.

        Args:
            settings: With the names in `OPTICS`; those that it lacks are empty.
            **changes: Conditions that are others.
        """
        return cls(**{name: getattr(settings, name, "") for name in OPTICS} | changes)

    @property
    def said(self) -> dict[str, Any]:
        """As rows have them: with `eval_` before the names, None where they are as usual."""
        return {f"eval_{f.name}": getattr(self, f.name) or None for f in fields(self)}

    @property
    def words(self) -> str:
        """In words for messages and names of files; empty where all is as usual."""
        return " ".join(f"{f.name} {v}" for f in fields(self) if (v := getattr(self, f.name)))


OPTICS = ("fovy", "aspect", "centre", "lens")
"""The settings that say which intrinsics cameras have."""


def of_task(settings: _Settings, fovy_deg: float) -> _Settings:
    """Settings where a field of view that is the task's own is none that is asked for.

    That is all of their one form that only the task knows; the rest is `keep_canonical`.

    Args:
        settings: A frozen record with `fovy`.
        fovy_deg: The task's (degrees).
    """
    record: Any = settings
    ends = span(record.fovy, "fovy", FOVY)
    is_own = ends and all(abs(end - fovy_deg) <= _SAME_FOVY for end in ends)
    return replace(record, fovy="") if is_own else settings


def several(usual: Conditions, asked: Mapping[str, Sequence[str]]) -> list[Conditions]:
    """All combinations of the conditions that are asked for, each once.

    Args:
        usual: What those have of which nothing is asked.
        asked: Values by name; none is as usual.

    Raises:
        ConfigError: A value cannot be.
    """
    values = {name: some for name, some in asked.items() if some}
    made = (
        replace(usual, **dict(zip(values, chosen, strict=True)))
        for chosen in itertools.product(*values.values())
    )
    return list(dict.fromkeys(made))


_PARSERS: Mapping[str, Callable[[str, str], Any]] = {
    "pose_noise": degrees_and_cm,
    "pose_drift": degrees_and_cm,
    "fovy": lambda text, name: span(text, name, FOVY),
    "aspect": lambda text, name: span(text, name, ASPECT),
    "centre": lambda text, name: span(text, name, CENTRE),
    "lens": lens_spans,
}
_NEUTRAL: Mapping[str, Any] = {"pose_noise": (0.0, 0.0), "pose_drift": (0.0, 0.0),
                               "aspect": (1.0, 1.0), "centre": (0.0, 0.0),
                               "lens": ("opencv", ())}  # fmt: skip


def keep_canonical(record: Any, *names: str) -> None:
    """Makes texts of a frozen record what they are kept as: those of one meaning become one.

    Args:
        record: While it is made.
        *names: Of its fields, as `Conditions` has them, also with `eval_` before them.

    Raises:
        ConfigError: One of them cannot be.
    """
    for name in names:
        text = _canonical(name.removeprefix("eval_"), getattr(record, name).strip())
        object.__setattr__(record, name, text)


def _canonical(name: str, text: str) -> str:
    text = "" if text == NOMINAL else text
    value = _PARSERS[name](text, name)
    if not text or value == _NEUTRAL.get(name):
        return ""
    if name == "lens":
        model, spans = value
        return f"{model}:" + ",".join(map(_written, spans))
    return ",".join(map(_short, value)) if name.startswith("pose") else _written(value)


def _written(ends: Span) -> str:
    low, high = map(_short, ends)
    return low if low == high else f"{low}:{high}"


def _short(number: float) -> str:
    """As `_number` reads it: no exponent, and as many decimals as it takes."""
    return f"{number:.12f}".rstrip("0").rstrip(".")


def _number(text: str) -> float | None:
    """The number, without a sign where it is 0."""
    is_number = re.fullmatch(r"[+-]?(\d{1,9}\.?\d{0,12}|\.\d{1,12})", text)
    return float(text) + 0.0 if is_number else None
