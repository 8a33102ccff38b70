"""What every record of settings shares: checks, changes and its JSON form."""

import ast
import dataclasses
import json
import math
import os
import reprlib
import types
import typing
from collections.abc import Iterable
from typing import Any, ClassVar, Literal, Protocol, TypeVar, cast

from jaxcam.config.names import names_of
from jaxcam.errors import ConfigError, closest


class SettingsRecord(Protocol):
    """Any record of settings: a dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 100
C = TypeVar("C", bound=SettingsRecord)


def to_json(config: SettingsRecord) -> str:
    """A config as JSON text that `from_json` turns back into an equal config."""
    return json.dumps(dataclasses.asdict(config), indent=2) + "\n"


def from_json(kind: type[C], text: str, what: str = "configuration") -> C:
    """The config a JSON text holds.

    Args:
        kind: Config class.
        text: What `to_json` wrote. Settings it lacks, because it is older, take their defaults, or
            what the class says that they were (`completed`).
        what: Of which file, for messages.

    Raises:
        ConfigError: The text is not JSON, or a name or value in it is not this class's.
    """
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:  # The last is of lists inside of lists.
        raise ConfigError(f"The {what} is not JSON: {error}.") from error
    return as_record(kind, values, what)


def as_record(kind: type[C], values: Any, what: str = "configuration") -> C:
    """The record that the values of a JSON text are: of known names, and of their types.

    Args:
        kind: A dataclass. Names that the values lack take its defaults.
        values: The parsed text.
        what: Of which file, for messages.

    Raises:
        ConfigError: The values are no object, or a name or a value is not this class's.
    """
    if not isinstance(values, dict):
        raise ConfigError(f"The {what} is a JSON {type(values).__name__}, not an object.")
    where = f"{what}: " if what != "configuration" else ""
    values = cast("dict[str, Any]", values)
    completed = getattr(kind, "completed", None)
    values = completed(values) if completed else values
    known = {f.name: f for f in dataclasses.fields(kind)}
    for name in values:
        if name not in known:
            raise ConfigError(f"{where}Unknown setting {name!r:.80}{closest(name, known)}.")
    for name, field in known.items():
        needed = dataclasses.MISSING is field.default is field.default_factory
        if needed and name not in values:
            raise ConfigError(f"The {what} has no '{name}'.")
    hints = typing.get_type_hints(kind)
    tuples = {
        name: tuple(cast("list[Any]", value))
        for name, value in values.items()
        if isinstance(value, list) and list not in _kinds(hints[name])
    }
    records = {
        name: as_record(hints[name], value, what)
        for name, value in values.items()
        if dataclasses.is_dataclass(hints[name]) and isinstance(value, dict)
    }
    values = values | tuples | records
    for name, value in values.items():  # before the record's own checks compute with them
        check_value(where, name, value, hints[name])
    return kind(**values)


def short(value: Any) -> str:
    """A value for a message: as Python writes it, without all of what is long or nested."""
    if type(value) is int and abs(value) >= 2**63:
        return f"a whole number of {value.bit_length()} bits"
    return _SHORT.repr(value)


def fill(config: C, **values: Any) -> C:
    """The config with these values where it has none of its own; others it keeps."""
    return dataclasses.replace(
        config, **{k: v for k, v in values.items() if getattr(config, k) is None}
    )


def overrides(pairs: Iterable[str]) -> dict[str, Any]:
    """Name=value texts as a dict; numbers, booleans, tuples and None become such."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not (name.isidentifier() and equals and text):
            raise ConfigError(f"model: expected name=value, got '{pair}'.")
        if name in values:
            raise ConfigError(f"model: '{name}' is given twice.")
        try:
            values[name] = ast.literal_eval({"true": "True", "false": "False"}.get(text, text))
        except (ValueError, SyntaxError, RecursionError, MemoryError):
            values[name] = text
    return values


def with_overrides(settings: C, pairs: Iterable[str]) -> C:
    """A policy's settings with the changes of `TrainConfig.model`.

    Args:
        settings: A frozen dataclass, such as a policy's preset.
        pairs: Texts such as "width=256".

    Raises:
        ConfigError: No such setting, or a value of another type.
    """
    values = overrides(pairs)
    known = [f.name for f in dataclasses.fields(settings)]
    for name in values:
        if name not in known:
            raise ConfigError(f"model: unknown setting '{name}'{closest(name, known)}.")
    # Types first: the settings' own checks compute with them.
    hints = typing.get_type_hints(type(settings))
    for name, value in values.items():
        check_value("model: ", name, value, hints[name])
    return dataclasses.replace(settings, **values)


def check_types(config: SettingsRecord, where: str = "") -> None:
    """Refuses values whose type is not the annotated one, and names that are unknown.

    Numbers are finite and have at most 64 bits, and texts could be paths.

    Args:
        config: Settings.
        where: Start of the message.

    Raises:
        ConfigError: There is such a value; of a name the message has the closest that is known.
    """
    for field, hint in typing.get_type_hints(type(config)).items():
        if typing.get_origin(hint) is not ClassVar:
            check_value(where, field, getattr(config, field), hint)


def check_value(where: str, field: str, value: Any, hint: Any) -> None:
    """Refuses a value whose type is not the annotated one, see `check_types`.

    Args:
        where: Start of the message.
        field: Its name.
        value: The value.
        hint: Its annotation.

    Raises:
        ConfigError: It is of another type.
    """
    kinds = _kinds(hint)
    is_number = type(value) is int and float in kinds
    if object not in kinds and type(value) not in kinds and not is_number:
        wanted = " or ".join(k.__name__ for k in kinds)
        raise ConfigError(f"{where}{field} must be {wanted}, got {short(value)}.")
    if type(value) is int and abs(value) >= 2**63:
        raise ConfigError(f"{where}{field} has more than 64 bits: {short(value)}.")
    if type(value) is float and not math.isfinite(value):
        raise ConfigError(f"{where}{field} must be finite, got {value}.")
    if type(value) is str and not _can_be_name(value):
        raise ConfigError(f"{where}{field} has what no file's name can: {short(value)}.")
    for part_hint, part in _parts(f"{where}{field}", hint, value):
        check_value(where, field, part, part_hint)
    if not isinstance(value, tuple | list | dict) and (names := names_of(hint)):
        _check_names(f"{where}Unknown {field}", value, names)


def _can_be_name(text: str) -> bool:
    """Whether a text could be a path: without a zero byte, and with nothing that is no letter."""
    try:
        return b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        return False


def _parts(what: str, hint: Any, value: Any) -> Iterable[tuple[Any, Any]]:
    """What is in a list, a tuple or a dict, each part with what an annotation says of it."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        same = (part for part in args if typing.get_origin(part) is type(value))
        return _parts(what, next(same, Any), value)
    if origin is dict:
        return [pair for item in value.items() for pair in zip(args, item, strict=True)]
    if origin is tuple and Ellipsis not in args:
        if len(args) != len(value):
            raise ConfigError(f"{what} has {len(args)} values, got {short(value)}.")
        return list(zip(args, value, strict=True))
    return [(args[0], part) for part in value] if origin in (list, tuple) else []


def _kinds(hint: Any) -> tuple[type, ...]:
    """The types of the values that an annotation allows; `object` where it cannot be said."""
    origin = typing.get_origin(hint)
    if origin is Literal:
        return (str,)
    if origin in (typing.Union, types.UnionType):
        return tuple(kind for part in typing.get_args(hint) for kind in _kinds(part))
    kind = origin or hint
    return (kind,) if isinstance(kind, type) and kind is not Any else (object,)


def _check_names(what: str, value: Any, names: tuple[str, ...]) -> None:
    if value is not None and value not in names:
        raise ConfigError(f"{what} {short(value)}{closest(str(value), names)}.")


def check_least(
    config: SettingsRecord, least: float, fields: str, *, or_equal: bool = True
) -> None:
    """Refuses settings below (or, without `or_equal`, at) a bound."""
    for field in fields.split():
        value = getattr(config, field)
        if value is None:
            continue
        if not math.isfinite(value) or value < least or (value == least and not or_equal):
            bound = "at least" if or_equal else "finite and more than"
            raise ConfigError(f"{field} must be {bound} {least}, got {value}.")


def check_rotation_form(action_space: str, rotations: str) -> None:
    """Refuses rotations that the actions do not have."""
    if rotations != "nominal" and action_space != "eef_abs":
        raise ConfigError(f"rotations is for action_space eef_abs, not {action_space}.")


def check_action_frame(action_space: str | None, action_frame: str) -> None:
    """Refuses actions that are not poses in a frame, or of which nobody says so."""
    if action_frame == "camera" and action_space not in (None, "eef_delta", "eef_abs"):
        raise ConfigError(
            "action_frame camera is for grip poses, action_space eef_delta or eef_abs, and not "
            f"{action_space}: no camera sees its numbers as positions and rotations."
        )


def check_ray_frame(ray_frame: str, action_frame: str, conditioning: str | None) -> None:
    """Refuses cameras told in a frame other than the base's to what counts on that one."""
    for what, counts in (
        ("action_frame camera", action_frame == "camera"),
        ("conditioning warp", conditioning == "warp"),
    ):
        if counts and ray_frame != "base":
            raise ConfigError(
                f"{what} needs the cameras' poses in the robot's base: ray_frame base, not "
                f"{ray_frame}."
            )


def check_most(config: SettingsRecord, most: float, fields: str) -> None:
    """Refuses settings above a bound."""
    for field in fields.split():
        value = getattr(config, field)
        if value is not None and value > most:
            raise ConfigError(f"{field} must be at most {most}, got {value}.")


def check_seeds(*seeds: int) -> None:
    """Refuses seeds that are not 0 to 2**32 - 1: JAX would give others the key of one of those."""
    for seed in seeds:
        if not 0 <= seed < 2**32:
            raise ConfigError(f"A seed must be 0 to {2**32 - 1}, got {seed}.")


def check_window(n: int | None, m: int | None) -> None:
    """Refuses a camera schedule that skips cameras."""
    if n is not None and m is not None and m > n:
        raise ConfigError(f"m ({m}) must be at most n ({n}), or cameras would be skipped.")
