"""Grids of runs: what a file expands to, and what is refused in it."""

import pytest
from small_grid import GRIDS, SMALL

from jaxcam.config.flags import parse
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.runs.grid import read_grid


def test_a_grid_is_every_combination_once(write):
    text = SMALL + "  - {{task: lift, conditioning: late, seed: [0, 1], action_space: eef_delta}}\n"
    text += "  - {{task: lift, conditioning: late, seed: 0, crop_min: 1.0, n: 10, m: 0}}\n"
    plan = read_grid(write(text))
    usual = "lift-randomized-act-laptop-{}-steps40-{}"
    assert [r.name for r in plan.runs] == [
        usual.format("none", 0), usual.format("none", 1),
        usual.format("late", 0), usual.format("late", 1),  # stating a default is no other run
        "lift-randomized-act-laptop-late-steps40-crop_min1-n10-m0-0",
    ]  # fmt: skip
    (command,) = plan.runs[-1].commands()
    config = parse(TrainConfig, command[3:])
    assert (config.n, config.m, config.crop_min, config.steps) == (10, 0, 1.0, 40)
    assert config.run_dir == str(plan.runs[-1].folder)


def test_model_changes_are_lists_of_lists(write):
    text = SMALL + "  - {{task: lift, seed: 0, model: [[width=64], [width=64, heads=2], []]}}\n"
    models = [r.config.model for r in read_grid(write(text)).runs[4:]]
    assert models == [("width=64",), ("width=64", "heads=2"), ()]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("task: lift", "tsak: lift", "run 1: unknown setting 'tsak', did you mean 'task'"),
        ("task: lift", "task: lfit", "run 1: Unknown task 'lfit', did you mean 'lift'"),
        ("preset: laptop", "present: laptop", "settings: unknown setting 'present', did you mean"),
        ("runs_dir", "run_dirs", "unknown setting 'run_dirs', did you mean 'runs_dir'"),
        ("preset: laptop, ", "", "there is no 'preset'"),
        (", seed: [0, 1]", "", "there is no 'seed'"),
        ("[none, late]", "[]", "'conditioning' is an empty list"),
        ("title: small", "protocol: papr", "unknown protocol 'papr', did you mean 'paper'"),
        ("title: small", "protocol: paper", "takes the last 10 checkpoints, but .* keeps 4"),
        ("steps: 40", "steps: many", "steps must be int"),
        ("runs:", "runs: [", "cannot be read"),
    ],
)
def test_mistakes_in_a_grid_are_named(write, old, new, message):
    assert old in SMALL
    with pytest.raises(ConfigError, match=message):
        read_grid(write(SMALL.replace(old, new)))


@pytest.mark.parametrize(
    "path", sorted(GRIDS.glob("*/*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_grids_of_the_repository_are_whole(path):
    plan = read_grid(path)
    assert plan.runs
    assert len({r.folder for r in plan.runs}) == len(plan.runs)
    seeds = {r.config.policy: set() for r in plan.runs}
    for r in plan.runs:
        seeds[r.config.policy].add(r.config.seed)
        assert len(r.steps) == 10
    assert all(s == ({0} if policy == "smolvla" else {0, 1, 2}) for policy, s in seeds.items())
