"""How settings become flags: their choices, their defaults in words, and their parsing.

Attribute docstrings are what `--help` prints. Nothing here imports JAX, so help is fast.
"""

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, cast, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from jaxcam.config.fields import C
from jaxcam.config.names import names_of
from jaxcam.errors import ConfigError, closest

T = TypeVar("T")

if TYPE_CHECKING:  # Every reader of a config sees it resolved, so for them the value is a plain T.
    FromPreset = Annotated[T, "from the preset"]
else:

    class FromPreset:
        """`FromPreset[T]` is `T | None` with the help text of a plain T."""

        def __class_getitem__(cls, kind):
            names = names_of(kind)
            metavar = _choices(names) if names else kind.__name__.upper()
            hint = "(default: the preset's)"
            return Annotated[kind | None, tyro.conf.arg(metavar=metavar, help_behavior_hint=hint)]


PRESET: Any = None


def _choices(names: Iterable[str]) -> str:
    return "{" + ",".join(names) + "}"


def default(text: str) -> Any:
    """Marks a setting whose default `--help` tells in words."""
    return tyro.conf.arg(help_behavior_hint=f"(default: {text})")


def parse(kind: type[C], argv: Sequence[str] | None = None, prog: str | None = None) -> C:
    """The settings that flags give; a flag that is wrong ends the process with exit code 2.

    Args:
        kind: Record of settings.
        argv: Flags; those of the process when None.
        prog: The command as it was typed, for `--help`.

    Raises:
        ConfigError: A flag is given twice: the first one would be forgotten without a word.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    words = words[: words.index("--")] if "--" in words else words
    names = [word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--")]
    given = Counter(f"--{name.removeprefix('--').removeprefix('no-')}" for name in names)
    if twice := [name for name, times in given.items() if times > 1]:
        raise ConfigError(f"{twice[0]} is given twice. Give it once, with all its values.")
    return tyro.cli(kind, args=argv, prog=prog, registry=_REGISTRY)


_REGISTRY = ConstructorRegistry()


@_REGISTRY.primitive_rule  # pyright: ignore[reportUnknownMemberType]
def _name_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Names on the command line, one or several: an unknown one is answered with the closest."""
    kind = cast(Any, info.type)  # pyright: ignore[reportUnknownMemberType]
    is_tuple = get_origin(kind) is tuple
    if not (names := names_of(kind)):
        return None

    def read(words: list[str]) -> str | tuple[str, ...]:
        for word in words:
            if word not in names:
                raise ValueError(f"unknown name '{word}'{closest(word, names)}")
        return tuple(words) if is_tuple else words[0]

    return PrimitiveConstructorSpec(
        nargs="*" if is_tuple else 1,
        metavar=_choices(names),
        instance_from_str=read,
        is_instance=lambda x: x is None or isinstance(x, tuple) or x in names,
        str_from_instance=lambda x: list(x) if is_tuple else [str(x)],
    )
