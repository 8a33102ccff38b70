"""Settings: presets, validation that helps, exact JSON, differences, and the command line."""

import dataclasses
import re
import subprocess
import sys
import time

import pytest
import tyro

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.fields import from_json, overrides, to_json, with_overrides
from jaxcam.config.presets import NAMES, PRESETS
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.runs.identity import FREE_TO_CHANGE, differences, resolve

LAPTOP = resolve(TrainConfig(), accelerator=False)
PAPER = resolve(TrainConfig(), accelerator=True)


def test_auto_follows_the_hardware():
    assert LAPTOP.preset == "laptop"
    assert PAPER.preset == "paper"
    assert resolve(TrainConfig(preset="paper"), accelerator=False).preset == "paper"


def test_paper_preset_is_the_authors():
    assert (PAPER.lr, PAPER.weight_decay, PAPER.clip_norm) == (2e-5, 1e-4, 1.0)
    assert (PAPER.schedule, PAPER.warmup, PAPER.batch, PAPER.steps) == ("constant", 0, 70, 60_000)
    assert (PAPER.resolution, PAPER.crop_min, PAPER.precision) == (256, 0.8, "bfloat16")
    assert (PAPER.n, PAPER.m, PAPER.demos, PAPER.validation, PAPER.ema) == (3, 1, 200, 10, 0)
    assert PAPER.conditioning == "late"
    assert PAPER.steps // PAPER.eval_every == 20  # Every 1000 epochs of 3 updates.


@pytest.mark.parametrize("accelerator", [True, False])
@pytest.mark.parametrize("key", list(PRESETS))
def test_resolve_leaves_nothing_open_and_is_idempotent(key, accelerator):
    policy, preset = key
    config = resolve(TrainConfig(policy=policy, preset=preset), accelerator=accelerator)
    assert None not in dataclasses.asdict(config).values()
    assert resolve(config, accelerator=not accelerator) is config
    assert set(PRESETS[key]) < {f.name for f in dataclasses.fields(TrainConfig)}


def test_given_values_win_over_the_preset():
    config = resolve(TrainConfig(lr=0.5, conditioning="none", run_dir="x"), accelerator=False)
    assert (config.lr, config.conditioning, config.run_dir) == (0.5, "none", "x")
    assert config.batch == LAPTOP.batch


def test_run_folder_is_named_by_what_the_run_is():
    assert LAPTOP.run_dir == f"runs/lift-randomized-act-laptop-{LAPTOP.conditioning}-0"
    other = resolve(TrainConfig(conditioning="none", seed=2), accelerator=False)
    assert other.run_dir == "runs/lift-randomized-act-laptop-none-2"


def test_steps_per_call_divide_the_run():
    assert LAPTOP.steps_per_call == 1
    assert PAPER.steps_per_call == 10
    assert resolve(TrainConfig(steps=6), accelerator=True).steps_per_call == 2
    with pytest.raises(
        ConfigError, match=r"steps \(6\) must be a multiple of steps_per_call \(4\)"
    ):
        resolve(TrainConfig(steps=6, steps_per_call=4), accelerator=True)


def test_short_runs_get_a_short_warmup():
    assert resolve(TrainConfig(steps=40), accelerator=False).warmup == 4
    with pytest.raises(ConfigError, match=r"warmup \(50\) must be shorter than steps \(40\)"):
        TrainConfig(steps=40, warmup=50)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task": "lfit"}, "Unknown task 'lfit', did you mean 'lift'. Known: lift"),
        ({"policy": "atc"}, "Unknown policy 'atc', did you mean 'act'"),
        ({"scene": "randomised"}, "did you mean 'randomized'"),
        ({"conditioning": "keypoint"}, "did you mean 'keypoints'"),
        ({"action_space": "ee_delta"}, "did you mean 'eef_delta'"),
        ({"preset": "papr"}, "did you mean 'paper'"),
        ({"batch": 0}, "batch must be at least 1, got 0"),
        ({"lr": 0.0}, "lr must be finite and more than 0"),
        ({"lr": float("nan")}, "lr must be"),
        ({"clip_norm": float("inf")}, "clip_norm must be"),
        ({"crop_min": 1.5}, "crop_min is a share of the image"),
        ({"ema": 1.0}, "ema must be below 1"),
        ({"n": 3, "m": 4}, r"m \(4\) must be at most n \(3\)"),
        ({"views": 4, "n": 3}, r"views \(4\) needs as many cameras"),
        ({"seed": -1}, "seed must be at least 0"),
        ({"steps": 1.5}, "steps must be int or NoneType, got 1.5"),
        ({"batch": True}, "batch must be int"),
        ({"task": None}, "task must be str, got None"),
        ({"model": ("width",)}, "model: expected name=value, got 'width'"),
        ({"model": ("a=1", "a=2")}, "'a' is given twice"),
    ],
)
def test_bad_values_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        TrainConfig(**changes)


def test_other_commands_are_validated_too():
    with pytest.raises(ConfigError, match="did you mean 'lift'"):
        CollectConfig(task="lifts")
    with pytest.raises(ConfigError, match="did you mean 'validation'"):
        EvaluateConfig(("run",), split="valid")
    with pytest.raises(ConfigError, match="width must be at least 1"):
        EvaluateConfig(("run",), width=0)


@pytest.mark.parametrize("config", [
    TrainConfig(), LAPTOP, PAPER, TrainConfig(lr=0.1 + 0.2, model=("width=8", "depth=2")),
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


def test_differences_say_what_makes_another_run():
    other = dataclasses.replace(LAPTOP, lr=0.5, pairs=7)
    found = differences(LAPTOP, other)
    assert [(d.field, d.new, d.changes_program) for d in found] == [
        ("lr", 0.5, True), ("pairs", 7, False)
    ]  # fmt: skip
    assert str(found[1]) == "pairs: 50 -> 7"
    assert differences(LAPTOP, LAPTOP) == []
    assert {f.name for f in dataclasses.fields(TrainConfig)} > FREE_TO_CHANGE


def test_a_run_may_be_prolonged_only_if_its_rate_is_constant():
    def longer(config):
        (found,) = differences(config, dataclasses.replace(config, steps=2 * config.steps))
        return found.changes_program

    assert longer(LAPTOP)
    assert not longer(PAPER)


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


def test_flags():
    flags = "--task lift --scene fixed --policy act --conditioning late --action-space joint_abs"
    flags += " --views 2 --seed 3 --preset paper --model width=8 layers=2 --lr 1e-4"
    assert tyro.cli(TrainConfig, args=flags.split()) == TrainConfig(
        scene="fixed", conditioning="late", action_space="joint_abs", views=2, seed=3,
        preset="paper", model=("width=8", "layers=2"), lr=1e-4,
    )  # fmt: skip
    evaluate = tyro.cli(EvaluateConfig, args=["runs/a", "--pairs", "4"])
    assert evaluate == EvaluateConfig(("runs/a",), pairs=4)
    assert tyro.cli(TrainConfig, args=[]) == TrainConfig()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--task", "lfit"], "did you mean 'lift'"),
        (["--conditioning", "lat"], "did you mean 'late'"),
        (["--sed", "1"], "--seed INT"),
        (["--steps", "many"], "Error parsing --steps"),
    ],
)
def test_bad_flags_exit_with_2_and_help(flags, message, capsys):
    with pytest.raises(SystemExit) as stop:
        tyro.cli(TrainConfig, args=flags)
    assert stop.value.code == 2
    shown = capsys.readouterr().err
    assert message in " ".join(shown.split())
    assert "For full helptext" in shown
    assert "Traceback" not in shown


def test_help_shows_choices_and_presets(capsys):
    with pytest.raises(SystemExit) as stop:
        tyro.cli(TrainConfig, args=["--help"])
    assert stop.value.code == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "--conditioning {none,token,early,late,keypoints}" in shown
    assert "Learning rate at its peak. (default: the preset's)" in shown
    assert "None" not in shown
    for field in dataclasses.fields(TrainConfig):
        assert re.search(rf"--{field.name.replace('_', '-')}[ ,]", shown)


def test_help_is_fast_and_imports_no_jax():
    script = (
        "import sys, jaxcam.train as t\n"
        "try: t.COMMAND.run(['--help'])\n"
        "finally: print({'jax', 'flax', 'numpy', 'mujoco'} & set(sys.modules), file=sys.stderr)"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert time.perf_counter() - start < 3
    assert done.returncode == 0
    assert done.stderr.strip() == "set()"


def test_every_preset_is_of_known_names():
    assert {policy for policy, _ in PRESETS} == set(NAMES["policy"])
    assert {preset for _, preset in PRESETS} | {"auto"} == set(NAMES["preset"])


def test_conditionings_are_those_of_the_policies():
    from jaxcam.models import FAMILIES

    assert {(kind, name) for kind, f in FAMILIES.items() for name in f.presets} == set(PRESETS)
    for (kind, name), values in PRESETS.items():
        assert FAMILIES[kind].presets[name].conditioning == values["conditioning"]
    assert with_overrides(FAMILIES["act"].presets["laptop"], ["width=64"]).width == 64
