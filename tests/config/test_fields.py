"""What records of settings share: checks, exact JSON, and changes to a network."""

import dataclasses
from typing import Literal

import pytest

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.fields import check_types, fill, from_json, overrides, to_json, with_overrides
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError


@pytest.mark.parametrize("config", [
    TrainConfig(), TrainConfig(lr=0.1 + 0.2, model=("width=8", "depth=2"), seeds=(1, 2)),
    EvaluateConfig(("a/b",), step=3), CollectConfig(demos=1),
])  # fmt: skip
def test_json_round_trip_is_exact(config):
    assert from_json(type(config), to_json(config)) == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("[1]", "JSON list, not an object"),
        ('{"stepz": 3}', "Unknown setting 'stepz', did you mean 'steps'"),
        ('{"steps": "3"}', "steps must be int"),
        ('{"task": "pour"}', "Unknown task 'pour'"),
    ],
)
def test_bad_json_is_refused(text, message):
    with pytest.raises(ConfigError, match=message):
        from_json(TrainConfig, text)


@dataclasses.dataclass(frozen=True)
class Network:
    """Stands for a policy's settings."""

    width: int = 4
    rate: float = 0.5
    kind: str = "mlp"
    sizes: tuple[int, ...] = (1,)
    wide: bool = False


def test_network_overrides():
    pairs = ("width=8", "rate=1", "kind=conv", "sizes=(3, 4)", "wide=true")
    assert with_overrides(Network(), pairs) == Network(8, 1, "conv", (3, 4), True)
    assert overrides(["a=None", "b=1e-3", "c=x=y"]) == {"a": None, "b": 1e-3, "c": "x=y"}
    with pytest.raises(ConfigError, match="unknown setting 'with', did you mean 'width'"):
        with_overrides(Network(), ["with=3"])
    with pytest.raises(ConfigError, match="model: width must be int, got 'big'"):
        with_overrides(Network(), ["width=big"])


@dataclasses.dataclass(frozen=True)
class Mixed:
    """Fields of every kind of annotation."""

    name: Literal["a", "b"] = "a"
    maybe: Literal["a", "b"] | None = None
    rate: float | None = None
    names: tuple[str, ...] = ()


def test_types_and_names_of_every_kind_of_field():
    check_types(Mixed("b", "a", 1, ("x",)))
    for bad, message in [
        (Mixed(name="c"), "Unknown name 'c'"),  # pyright: ignore[reportArgumentType]
        (Mixed(name=None), "name must be str, got None"),  # pyright: ignore[reportArgumentType]
        (Mixed(maybe="c"), "Unknown maybe 'c'"),  # pyright: ignore[reportArgumentType]
        (Mixed(rate="1"), "rate must be float or NoneType"),  # pyright: ignore[reportArgumentType]
        (Mixed(names="x"), "names must be tuple"),  # pyright: ignore[reportArgumentType]
    ]:
        with pytest.raises(ConfigError, match=message):
            check_types(bad)


def test_filling_leaves_what_is_given():
    assert fill(Mixed(rate=0.0), rate=2.0, maybe="b") == Mixed(rate=0.0, maybe="b")
