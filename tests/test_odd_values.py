"""Odd values of every flag of every command: a sentence and an exit code, never a traceback.

The commands run in this process and in an empty folder, where nothing long can begin.
"""

import dataclasses
from importlib import import_module

import pytest
from running import exit_code

from jaxcam.__main__ import NAMES
from jaxcam.config.calibrate import HandEyeConfig, LensConfig, TagsConfig
from jaxcam.config.calibrate_arm import ArmConfig, DriftConfig
from jaxcam.config.fields import check_types, overrides
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models import policy_settings
from jaxcam.runs.identity import resolve

ODD = (
    "",
    " ",
    "-1",
    "-0",
    "0",
    "1",
    "1.5",
    "1e3",
    "1e999",
    "-1e999",
    "nan",
    "inf",
    "-inf",
    "0x10",
    "1_000",
    "٣",
    "²",
    str(2**31),
    str(2**32),
    str(2**63),
    str(2**64),
    str(-(2**64)),
    "9" * 5000,
    "99999999999",
    "true",
    "None",
    "()",
    "[]",
    "{}",
    "a=b",
    "=",
    "a=",
    "=b",
    "[/red]",
    "[bold]x",
    "out[/red]",
    "%s",
    "{0}",
    "$HOME",
    "`id`",
    "'",
    '"',
    "\\",
    "\n",
    "\t",
    "ä",
    "\u202e",
    "\ud800",
    "\udcff",
    "\0",
    "🦾" * 80,
    "n" * 300,
    "n/" * 3000,
    ".",
    "..",
    "~",
    "~nobody",
    "/dev/null",
    "/dev/full",
    "/proc/self/mem",
    "none.hdf5",
    "none.yaml",
    "--",
    "-",
    "lfit",
    "LIFT",
)
"""Values that people, scripts and other languages give."""

POSITIONAL = {"evaluate": 1, "replay": 1, "report": 1, "sweep": 1, "check": 1, "view": 1,
              "weights": 1, "robomimic": 1, "maniskill": 1, "lerobot": 2}  # fmt: skip
SWITCHES = ("--env", "--distributed", "--list", "--validation")
HARMLESS = {"train": ["--dataset", "none.hdf5"], "collect": ["--demos", "0"]}
"""What ends the commands that could begin something, whatever else is given."""


@pytest.fixture(autouse=True)
def empty(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))


def flags(name):
    fields = dataclasses.fields(import_module(f"jaxcam.{name}").COMMAND.settings)
    places = [f.name for f in fields][: POSITIONAL.get(name, 0)]
    return ["--" + f.name.replace("_", "-") for f in fields if f.name not in places]


def ends(capsys, name, *argv):
    """What a command prints that must not succeed in silence; its exit code is one of ours."""
    code = exit_code(name, *argv)
    shown = capsys.readouterr()
    assert code in (0, 1, 2, 3, 4, 5, 7), (name, argv, shown)
    assert "Traceback" not in shown.out + shown.err
    assert code == 0 or shown.out + shown.err
    return shown.out + shown.err


@pytest.mark.parametrize("name", sorted(POSITIONAL))
def test_odd_places(name, capsys):
    for value in ODD:
        places = [value] * POSITIONAL[name]
        ends(capsys, name, *places)


@pytest.mark.parametrize("name", NAMES)
def test_odd_flags(name, capsys):
    """Each value goes to one of the command's flags, in turn."""
    places = ["none"] * POSITIONAL.get(name, 0)
    tried = [flag for flag in flags(name) if flag not in SWITCHES]
    for number, value in enumerate(ODD):
        flag = tried[number % len(tried)]
        given = HARMLESS.get(name, [])
        if flag not in given:
            ends(capsys, name, *places, *given, flag, value)


@pytest.mark.parametrize(
    ("form", "settings"),
    [("lens", LensConfig), ("tags", TagsConfig), ("hand-eye", HandEyeConfig), ("arm", ArmConfig),
     ("drift", DriftConfig)],
)  # fmt: skip
def test_odd_flags_of_forms(form, settings, capsys):
    tried = ["--" + f.name.replace("_", "-") for f in dataclasses.fields(settings)][1:]
    for number, value in enumerate(ODD):
        ends(capsys, "calibrate", form, "none", tried[number % len(tried)], value)


@pytest.mark.parametrize(
    "given",
    [
        {"seed": 2**32}, {"seeds": (1, 2**32)}, {"seeds": (1,), "seed": 2}, {"demos": 99999999999},
        {"steps": 2**64}, {"lr": float("inf")}, {"lr": 10**400}, {"data_dir": "a\0b"},
        {"seeds": (1, "2")}, {"log": ("wandb", "x")}, {"resolution": 10**9},
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused(given):
    with pytest.raises(ConfigError):
        TrainConfig(**given)


@pytest.mark.parametrize("policy", ["act", "diffusion", "smolvla"])
@pytest.mark.parametrize(
    "value",
    [
        "width=0", "width=text", "width=-8", "width=99999999999999999999", "chunk=0", "chunk=1.5",
        "keypoints=0", "keypoints=()", "channels=()", "channels=(1.5,)", "channels=(0,)", "heads=0",
        "heads=None", "dropout=2", "dropout=1e999", "execute=999", "execute=-1", "kernel=0",
        "groups=0", "layers=0", "hidden=0", "nominal_pose=((1,),)", "nominal_pose=1", "steps=0",
        "tokens=(1.5,)", "patch=0", "shuffle=0", "obs_steps=0", "sample_steps=0", "step_width=0",
        "compute_dtype=float8", "encoder_width=0", "encoder_depth=0", "width=" + "9" * 5000,
        "width=" + "(" * 500, "nothing=1", "warp_height=1e999", "warp_fovy_deg=180", "fold=0",
        "action_frame='camera'", "base_from_actions=((1,),)",
    ],
)  # fmt: skip
def test_odd_networks_are_refused(policy, value):
    name = value.partition("=")[0]
    preset = "tiny" if policy == "smolvla" else "laptop"
    config = resolve(TrainConfig(policy=policy, preset=preset), accelerator=False)
    config = dataclasses.replace(config, model=(value,))
    with pytest.raises(ConfigError) as refused:
        policy_settings(config, ("Lift the cube.",))
    assert name in str(refused.value) or "tages" in str(refused.value)


@pytest.mark.parametrize("text", [value for value in ODD if "=" not in value])
def test_a_change_of_the_network_is_a_name_and_a_value(text):
    with pytest.raises(ConfigError, match="expected name=value"):
        overrides((text,))


def test_values_of_records_that_are_no_flags():
    @dataclasses.dataclass(frozen=True)
    class Pair:
        ends: tuple[int, int] = (1, 2)

    check_types(Pair())
    for wrong in ((1,), (1, 2, 3), (1, "2"), (1, 2**63)):
        with pytest.raises(ConfigError, match="ends"):
            check_types(Pair(wrong))


@pytest.mark.parametrize(("task", "engine"), [("lift", "sapien"), ("push", "native")])
def test_an_engine_that_cannot_step_the_task_is_told_before_anything_is_made(
    task, engine, tmp_path, capsys
):
    assert exit_code("train", "--task", task, "--engine", engine) == 2
    assert "cannot step this task's world" in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())
