"""What every record of settings shares: flags, checks, JSON form.

Attribute docstrings are what `--help` prints. Nothing here imports JAX, so help is fast.
"""

import ast
import dataclasses
import json
import math
import typing
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from jaxcam.config.presets import NAMES
from jaxcam.errors import ConfigError, closest

T = TypeVar("T")
C = TypeVar("C")
if TYPE_CHECKING:  # Every reader of a config sees it resolved, so for them the value is a plain T.
    FromPreset = Annotated[T, "from the preset"]
else:

    class FromPreset:
        """`FromPreset[T]` is `T | None` with the help text of a plain T."""

        def __class_getitem__(cls, kind):
            hint = "(default: the preset's)"
            return Annotated[
                kind | None, tyro.conf.arg(metavar=kind.__name__.upper(), help_behavior_hint=hint)
            ]


PRESET: Any = None


def one_of(field: str) -> Any:
    """Marks a setting whose value is one of `NAMES[field]`."""
    return tyro.conf.arg(metavar="{" + ",".join(NAMES[field]) + "}")


def default(text: str) -> Any:
    """Marks a setting whose default `--help` tells in words."""
    return tyro.conf.arg(help_behavior_hint=f"(default: {text})")


def to_json(config: Any) -> str:
    """A config as JSON text that `from_json` turns back into an equal config."""
    return json.dumps(dataclasses.asdict(config), indent=2) + "\n"


def from_json(kind: type[C], text: str) -> C:
    """The config a JSON text holds.

    Args:
        kind: Config class.
        text: What `to_json` wrote. Settings it lacks, because it is older, take their defaults.

    Raises:
        ConfigError: The text is not JSON, or a name or value in it is not this class's.
    """
    try:
        values = json.loads(text)
    except ValueError as error:
        raise ConfigError(f"The configuration is not JSON: {error}.") from error
    if not isinstance(values, dict):
        raise ConfigError(f"The configuration is a JSON {type(values).__name__}, not an object.")
    known = [f.name for f in dataclasses.fields(kind)]  # pyright: ignore[reportArgumentType]
    for name in values:
        if name not in known:
            raise ConfigError(f"Unknown setting '{name}'{closest(name, known)}.")
    return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})


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
    known = [f.name for f in dataclasses.fields(settings)]  # pyright: ignore[reportArgumentType]
    for name in values:
        if name not in known:
            raise ConfigError(f"model: unknown setting '{name}'{closest(name, known)}.")
    changed = dataclasses.replace(settings, **values)  # pyright: ignore[reportArgumentType]
    check_types(changed, where="model: ")
    return typing.cast(C, changed)


def check_types(config: Any, where: str = "") -> None:
    """Refuses values whose type is not the annotated one."""
    for name, hint in typing.get_type_hints(type(config)).items():
        value = getattr(config, name)
        kinds = tuple(typing.get_origin(t) or t for t in (typing.get_args(hint) or (hint,)))
        if typing.get_origin(hint) is tuple:
            kinds = (tuple,)
        is_number = type(value) is int and float in kinds
        if all(isinstance(k, type) for k in kinds) and type(value) not in kinds and not is_number:
            wanted = " or ".join(k.__name__ for k in kinds)
            raise ConfigError(f"{where}{name} must be {wanted}, got {value!r}.")


def check_names(config: Any) -> None:
    """Refuses names that are not known, naming the closest."""
    for field, known in NAMES.items():
        value = getattr(config, field, None)
        for name in value if isinstance(value, tuple) else (value,):
            if name is not None and name not in known:
                raise ConfigError(f"Unknown {field} '{name}'{closest(name, known)}.")


def check_least(config: Any, least: float, fields: str, *, or_equal: bool = True) -> None:
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
