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


class Settings(Protocol):
    """Any record of settings: a dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


MOST = 2**63 - 1
"""The largest whole number of 64 bits."""
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 100
C = TypeVar("C", bound=Settings)


def to_json(config: Settings) -> str:
    """A config as JSON text that `from_json` turns back into an equal config."""
    return json.dumps(dataclasses.asdict(config), indent=2) + "\n"


def from_json(kind: type[C], text: str, what: str = "configuration") -> C:
    """The config a JSON text holds.

    Args:
        kind: Config class.
        text: What `to_json` wrote. Settings it lacks, because it is older, take their defaults.
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
    values = cast("dict[str, Any]", values)
    known = {f.name: f for f in dataclasses.fields(kind)}
    for name in values:
        if name not in known:
            raise ConfigError(f"Unknown setting {name!r:.80}{closest(name, known)}.")
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
    record = kind(**values | tuples)
    check_types(record, where=f"{what}: " if what != "configuration" else "")
    return record


def short(value: Any) -> str:
    """A value as Python writes it, or the beginning of that."""
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
        except (ValueError, SyntaxError):
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
    changed = dataclasses.replace(settings, **values)
    check_types(changed, where="model: ")
    return changed


def check_types(config: Settings, where: str = "") -> None:
    """Refuses values whose type is not the annotated one, and names that are unknown.

    Args:
        config: Settings.
        where: Start of the message.

    Raises:
        ConfigError: There is such a value; of a name the message has the closest that is known.
    """
    for field, hint in typing.get_type_hints(type(config)).items():
        value = getattr(config, field)
        if wanted := _misfit(hint, value):
            raise ConfigError(f"{where}{field} must be {wanted}, got {short(value)}.")
        if names := names_of(hint):
            _check_names(f"{where}Unknown {field}", value, names)


def _misfit(hint: Any, value: Any) -> str:
    """What a value should be whose type is not the annotated one; empty if it is."""
    kinds = _kinds(hint)
    if object in kinds:
        return ""
    is_number = type(value) is int and float in kinds
    if type(value) not in kinds and not is_number:
        return " or ".join(k.__name__ for k in kinds)
    if isinstance(value, int) and abs(value) > MOST:
        return "a number of 64 bits"
    if isinstance(value, str) and not _can_be_path(value):
        return "text without zero bytes and halves of characters"
    for part_hint, part in _parts(hint, value):
        if wanted := _misfit(part_hint, part):
            return f"{type(value).__name__} of {wanted}"
    return ""


def _can_be_path(text: str) -> bool:
    try:
        return b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        return False


def _parts(hint: Any, value: Any) -> Iterable[tuple[Any, Any]]:
    """What is in a list, a tuple or a dict, each part with what an annotation says of it."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        same = (part for part in args if typing.get_origin(part) is type(value))
        return _parts(next(same, Any), value)
    if origin is dict:
        return [pair for item in value.items() for pair in zip(args, item, strict=True)]
    if origin is list or (origin is tuple and Ellipsis in args):
        return [(args[0], part) for part in value]
    return []


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
    for name in cast("tuple[Any, ...]", value) if isinstance(value, tuple) else (value,):
        if name is not None and name not in names:
            raise ConfigError(f"{what} {name!r:.80}{closest(str(name), names)}.")


def check_least(config: Settings, least: float, fields: str, *, or_equal: bool = True) -> None:
    """Refuses settings below (or, without `or_equal`, at) a bound."""
    for field in fields.split():
        value = getattr(config, field)
        if value is None:
            continue
        if not math.isfinite(value) or value < least or (value == least and not or_equal):
            bound = "at least" if or_equal else "finite and more than"
            raise ConfigError(f"{field} must be {bound} {least}, got {value}.")


def check_window(n: int | None, m: int | None) -> None:
    """Refuses a camera schedule that skips cameras."""
    if n is not None and m is not None and m > n:
        raise ConfigError(f"m ({m}) must be at most n ({n}), or cameras would be skipped.")
