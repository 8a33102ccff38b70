"""The command line of settings: values, choices, and answers to typos."""

import dataclasses
import re
import subprocess
import sys
import time

import pytest

from jaxcam.config.commands import CheckConfig, EvaluateConfig, WeightsConfig
from jaxcam.config.datasets import ReplayConfig
from jaxcam.config.flags import parse
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError


def test_flags():
    flags = "--task lift --scene fixed --policy act --conditioning late --action-space joint_abs"
    flags += " --views 2 --seed 3 --preset paper --model width=8 layers=2 --lr 1e-4"
    assert parse(TrainConfig, flags.split()) == TrainConfig(
        scene="fixed", conditioning="late", action_space="joint_abs", views=2, seed=3,
        preset="paper", model=("width=8", "layers=2"), lr=1e-4,
    )  # fmt: skip
    spaces = parse(ReplayConfig, ["file", "--action-space", "eef_abs", "joint_abs"])
    assert spaces == ReplayConfig("file", action_space=("eef_abs", "joint_abs"))
    evaluate = parse(EvaluateConfig, ["runs/a", "--pairs", "4"])
    assert evaluate == EvaluateConfig(("runs/a",), pairs=4)
    assert parse(TrainConfig, []) == TrainConfig()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--task", "lfit"], "did you mean 'lift'"),
        (["--conditioning", "lat"], "did you mean 'late'"),
        (["--log", "wandb", "tensorbord"], "did you mean 'tensorboard'"),
        (["--sed", "1"], "--seed INT"),
        (["--steps", "many"], "Error parsing --steps"),
    ],
)
def test_bad_flags_exit_with_2_and_help(flags, message, capsys):
    with pytest.raises(SystemExit) as stop:
        parse(TrainConfig, flags)
    assert stop.value.code == 2
    shown = capsys.readouterr().err
    assert message in " ".join(shown.split())
    assert "For full helptext" in shown
    assert "Traceback" not in shown


def test_help_shows_choices_and_presets(capsys):
    with pytest.raises(SystemExit) as stop:
        parse(TrainConfig, ["--help", "all"])
    assert stop.value.code == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "--conditioning {none,token,early,late,keypoints,warp,prope,gta,ray_rope}" in shown
    assert "Learning rate at its peak. (default: the preset's)" in shown
    assert "None" not in shown
    for field in dataclasses.fields(TrainConfig):
        assert re.search(rf"--{field.name.replace('_', '-')}[ ,]", shown)


@pytest.mark.parametrize("kind", [TrainConfig, EvaluateConfig])
def test_help_is_by_groups_which_fit_a_screen(kind, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = {}
    for group in kind.GROUPS:
        with pytest.raises(SystemExit, match="0"):
            parse(kind, ["--help", group] if group else ["-h"])
        shown[group] = capsys.readouterr().out
        assert len(shown[group].splitlines()) <= (50 if group else 46), group
    assert "--help all" in shown[""]
    names = {name for fields in kind.GROUPS.values() for name in fields.split()}
    assert names == {field.name for field in dataclasses.fields(kind)}


def test_a_group_s_help_has_its_settings_and_no_others(capsys):
    with pytest.raises(SystemExit, match="0"):
        parse(TrainConfig, ["--steps", "3", "--help", "updates"], prog="train")
    shown = capsys.readouterr().out.partition("-h, --help")[2]
    flags = re.findall(r"^\W*--(?:no-)?([a-z0-9-]+)", shown, re.MULTILINE)
    assert [f.replace("-", "_") for f in flags] == TrainConfig.GROUPS["updates"].split()


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


@pytest.mark.parametrize(
    "flags",
    [
        ["--model", "width=64", "--model", "heads=4"],
        ["--seed", "1", "--seed=1"],
        ["--run-dir", "a", "--run_dir", "b"],
        ["--distributed", "--no-distributed"],
    ],
)
def test_a_flag_that_is_given_twice_is_refused(flags):
    """The first `--model` would be forgotten, and another network trained."""
    with pytest.raises(ConfigError, match=f"{flags[0]} is given twice"):
        parse(TrainConfig, flags)
    assert parse(EvaluateConfig, ["--pairs", "3", "--", "-a"]) == EvaluateConfig(("-a",), pairs=3)


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (WeightsConfig, {"source": "a", "task": "square"}),
        (WeightsConfig, {"source": "a", "export": "b", "action_space": "joint_abs"}),
        (WeightsConfig, {"source": "a", "run_dir": "b", "step": 3}),
        (CheckConfig, {"env": True, "out": "a.html"}),
    ],
)
def test_what_would_be_forgotten_is_refused(kind, given):
    with pytest.raises(ConfigError, match=r"only|leave out"):
        kind(**given)
