"""How settings become flags: their choices, their defaults in words, and their parsing.

Attribute docstrings are what `--help` prints. Nothing here imports JAX, so help is fast.
"""

import dataclasses
import inspect
import sys
import typing
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
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
            metavar = _choices(names) if names else str(getattr(kind, "__name__", kind)).upper()
            hint = "(default: the preset's)"
            return Annotated[kind | None, tyro.conf.arg(metavar=metavar, help_behavior_hint=hint)]


PRESET: Any = None


def _choices(names: Iterable[str]) -> str:
    return "{" + ",".join(names) + "}"


Groups = Mapping[str, str]
"""Which settings `--help NAME` shows, by its name: fields with spaces between. A record of many
settings has them as `GROUPS`; the group "" is what `--help` alone shows, and `all` is all."""


def default(text: str) -> Any:
    """Marks a setting whose default `--help` tells in words."""
    return tyro.conf.arg(help_behavior_hint=f"(default: {text})")


def parse(kind: type[C], argv: Sequence[str] | None = None, prog: str | None = None) -> C:
    """The settings that flags give; a flag that is wrong ends the process with exit code 2.

    Args:
        kind: Record of settings.
        argv: Flags; those of the process when None.
        prog: The command as it was typed, for `--help`. Records with `GROUPS` show a group of their
            settings: see `Groups`.

    Raises:
        ConfigError: A flag is given twice: the first one would be forgotten without a word.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    words = words[: words.index("--")] if "--" in words else words
    groups: Groups = getattr(kind, "GROUPS", {})
    asked = [i for i, word in enumerate(words) if word in ("-h", "--help")]
    if groups and asked:
        after = words[asked[0] + 1 : asked[0] + 2]
        show_help(kind, after[0] if after and after[0] in (*groups, "all") else "", prog)
    names = [word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--")]
    given = Counter(f"--{name.removeprefix('--').removeprefix('no-')}" for name in names)
    if twice := [name for name, times in given.items() if times > 1]:
        raise ConfigError(f"{twice[0]} is given twice. Give it once, with all its values.")
    return tyro.cli(kind, args=argv, prog=prog, registry=_REGISTRY)


def show_help(kind: type[Any], group: str, prog: str | None = None) -> typing.NoReturn:
    """Print the help of a group of settings, and end the process.

    Args:
        kind: Record of settings, with `GROUPS`.
        group: A name among them, or "all".
        prog: The command as it was typed.

    Raises:
        SystemExit: Always.
    """
    groups: Groups = kind.GROUPS
    fields = [field.name for field in dataclasses.fields(kind)]
    shown = fields if group == "all" else groups[group].split()
    hints = typing.get_type_hints(kind, include_extras=True)
    hidden = {n: Annotated[hints[n], tyro.conf.Suppress] for n in fields if n not in shown}
    about = {"__annotations__": hidden, "__doc__": kind.__doc__, "__module__": kind.__module__}
    part = type(kind.__name__, (kind,), about)
    others = [f"--help {name}" for name in (*groups, "all") if name not in ("", group)]
    more = f"{inspect.getdoc(kind)}\n\nMore settings: {', '.join(others)}."
    tyro.cli(part, args=["--help"], prog=prog, description=more, registry=_REGISTRY)
    raise SystemExit(0)  # pyright: ignore[reportUnreachable]


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
