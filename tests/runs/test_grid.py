"""Grids of runs: what a file expands to, and what is refused in it."""

import json
from dataclasses import replace

import pytest
from small_grid import GRIDS, SMALL

from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.conditions import Conditions
from jaxcam.config.fields import to_json
from jaxcam.config.flags import parse
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models import policy_settings
from jaxcam.runs.grid import progress_of, read_grid
from jaxcam.runs.identity import identity, network_of


def test_a_grid_is_every_combination_once(write):
    text = SMALL + "  - {{task: lift, conditioning: late, seed: [0, 1], action_space: eef_abs}}\n"
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


def test_twins_are_the_same_network_image_only(write):
    """Each is what its own run is but for what it is told, and the preset's own needs no words."""
    plan = read_grid(
        write(
            grid_of({"conditioning": ["keypoints", "late", "none"], "model": [["width=64"]],
                     "twins": True}, {"conditioning": "late", "twins": True})
        )
    )  # fmt: skip
    got = [(r.config.conditioning, r.config.model) for r in plan.runs]
    assert got == [
        ("keypoints", ("width=64",)), ("none", ("width=64",)),
        ("late", ("width=64",)), ("none", ("width=64", "twin_of=late")),
        ("late", ()), ("none", ("twin_of=late",)),
    ]  # fmt: skip
    for run in plan.runs:
        network = policy_settings(run.config, ("Lift",)).network
        assert network == network_of(identity(run.config))
    assert parse(TrainConfig, plan.runs[3].commands()[0][3:]).model == ("width=64", "twin_of=late")


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
        ("preset: laptop", "preset: laptop, twins: 2", "'twins' must be true or false, got 2"),
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


def test_further_evaluations_are_commands_of_their_own_and_asked_for(write):
    more = "evaluations:\n  - {{pose_noise: ['0,0', '1,1'], pose_drift: '2,0'}}\n  - {{fovy: 45}}\n"
    run = read_grid(write(SMALL.replace("runs:", f"{more}runs:"))).runs[0]
    _, noisy, plain = run.commands()
    config = parse(EvaluateConfig, noisy[3:])
    assert config.run == (str(run.folder),)
    assert config.step == 40
    assert (config.pose_noise, config.pose_drift) == (("0,0", "1,1"), ("2,0",))
    assert parse(EvaluateConfig, plain[3:]).fovy == ("45",)
    drift = Conditions(pose_drift="2,0")
    assert run.conditions == [Conditions(), drift, replace(drift, pose_noise="1,1")]
    assert progress_of(run).asked == 3 * run.pairs
    with pytest.raises(ConfigError, match="evaluation 1: pose_noise must be DEG,CM"):
        read_grid(write(SMALL.replace("runs:", f"{more}runs:".replace("1,1", "1"))))


@pytest.mark.parametrize(
    "path", sorted(GRIDS.glob("*/*.yaml")), ids=lambda p: f"{p.parent.name}-{p.stem}"
)
def test_the_grids_of_the_repository_are_whole(path):
    plan = read_grid(path)
    assert plan.runs
    assert len({r.folder for r in plan.runs}) == len(plan.runs)
    if path.parent.name == "beyond":
        return  # these are no protocol of the paper's
    seeds = {r.config.policy: set() for r in plan.runs}
    for r in plan.runs:
        seeds[r.config.policy].add(r.config.seed)
        assert len(r.steps) == 10
    ways = {(r.config.policy, network_of(identity(r.config)), r.config.conditioning == "none")
            for r in plan.runs}  # fmt: skip
    if any(is_image_only for *_, is_image_only in ways):  # then each has its own twin
        assert {way[:2] for way in ways if way[2]} == {way[:2] for way in ways if not way[2]}
    assert all(s == ({0} if policy == "smolvla" else {0, 1, 2}) for policy, s in seeds.items())


PATHS = [
    {"dataset": "a/mine.hdf5"}, {"dataset": "b/mine.hdf5"}, {"data_dir": "elsewhere"},
    {"weights": "a/r18.pth"}, {"weights": "b/r18.pth"}, {"weights": "a/r18.pt"},
    {"lr": 0.0001234567891}, {"lr": 0.0001234567892}, {"lr": 0.000123457}, {"views": 1},
]  # fmt: skip


def grid_of(*runs):
    """The small grid with these runs instead of its own; its file is formatted once more."""
    lines = (f"  - {json.dumps({'task': 'lift', 'seed': 0} | run)}\n" for run in runs)
    return SMALL.partition("  - ")[0] + "".join(lines).replace("{", "{{").replace("}", "}}")


def test_runs_that_differ_in_a_path_or_in_a_late_digit_are_planned_apart(write):
    plan = read_grid(write(grid_of(*PATHS)))
    assert len({run.folder for run in plan.runs}) == len(PATHS)
    assert [run.config.lr for run in plan.runs[6:8]] == [0.0001234567891, 0.0001234567892]


def test_a_run_that_version_0_1_0_began_keeps_its_folder(write):
    ours, others = (grid_of({"dataset": f"{folder}/mine.hdf5"}) for folder in "ab")
    (run,) = read_grid(write(ours)).runs
    old = run.folder.with_name("lift-randomized-act-laptop-keypoints-steps40-datasetmine-0")
    assert run.folder != old
    old.mkdir(parents=True)
    (old / "config.json").write_text(to_json(run.config))
    assert read_grid(write(ours)).runs[0].folder == old
    assert read_grid(write(others)).runs[0].folder != old


@pytest.mark.parametrize("changed", [{"pairs": [4, 8]}, {"accumulate": [1, 2]}, {"videos": [0, 1]}])
def test_runs_that_would_share_a_folder_are_refused(write, changed):
    (name,) = changed
    with pytest.raises(ConfigError, match=f"differ only in {name}"):
        read_grid(write(grid_of(changed)))


def test_a_folder_of_a_run_with_other_settings_is_not_what_the_grid_asks_for(write):
    """As where its preset had another action space; the name says only what the preset has not."""
    run = read_grid(write()).runs[0]
    run.folder.mkdir(parents=True)
    on_accelerator = replace(run.config, steps_per_call=10)
    (run.folder / "config.json").write_text(to_json(on_accelerator))
    assert progress_of(run).step == 0
    (run.folder / "config.json").write_text(to_json(replace(run.config, action_space="eef_delta")))
    with pytest.raises(
        ConfigError, match=r"other settings .action_space: 'eef_delta' -> 'eef_abs'"
    ):
        progress_of(run)


def test_a_long_name_is_cut_and_told_apart(write):
    models = [[f"heat_gain={i}.{1:0200d}"] for i in (1, 2)]
    names = {run.name for run in read_grid(write(grid_of({"model": models}))).runs}
    assert len(names) == 2
    assert max(map(len, names)) < 255 - len(".log")


@pytest.mark.parametrize("device", ["/dev/full", "/dev/zero", "/dev/null"])
def test_a_device_is_no_grid(device):
    """Some of them never end."""
    with pytest.raises(ConfigError, match="not a regular file"):
        read_grid(device)
