"""Which run it is: settings in full, names, and what makes another run."""

import dataclasses
import json

import pytest
from places import REPO

from jaxcam.config.fields import to_json
from jaxcam.config.presets import PRESETS
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.reports.run_page import reproduce_command
from jaxcam.runs.identity import (
    FREE_TO_CHANGE,
    changes,
    differences,
    full_name,
    identity,
    read_config,
    resolve,
    usual_way,
)

LAPTOP = resolve(TrainConfig(), accelerator=False)


PAPER = resolve(TrainConfig(), accelerator=True)


def test_auto_follows_the_hardware():
    assert LAPTOP.preset == "laptop"
    assert PAPER.preset == "paper"
    assert resolve(TrainConfig(preset="paper"), accelerator=False).preset == "paper"


@pytest.mark.parametrize("accelerator", [True, False])
@pytest.mark.parametrize("key", list(PRESETS))
def test_resolve_leaves_nothing_open_and_is_idempotent(key, accelerator):
    policy, preset = key
    config = resolve(TrainConfig(policy=policy, preset=preset), accelerator=accelerator)
    assert None not in dataclasses.asdict(config).values()
    assert resolve(config, accelerator=not accelerator) is config


def test_cameras_of_one_meaning_are_one_run(tmp_path):
    """Also one whose settings were written down before they had one form."""
    same = TrainConfig(fovy="45", aspect="1:1", centre="-0", lens="opencv:0:0,0")
    assert resolve(same, accelerator=False) == LAPTOP
    (tmp_path / "config.json").write_text(to_json(dataclasses.replace(LAPTOP, fovy="45")))
    assert read_config(tmp_path) == LAPTOP
    assert resolve(TrainConfig(fovy="44:45"), accelerator=False).fovy == "44:45"


@pytest.mark.parametrize(("space", "rotations"), [("eef_abs", "world"), ("eef_delta", "nominal")])
def test_a_run_of_version_0_1_0_keeps_its_rotations(tmp_path, space, rotations):
    """Its config.json has no such setting; what it learned were vectors from the world's axes."""
    now = resolve(TrainConfig(action_space=space), accelerator=False)
    old = json.loads(to_json(now))
    del old["rotations"]
    (tmp_path / "config.json").write_text(json.dumps(old))
    config = read_config(tmp_path)
    assert config == dataclasses.replace(now, rotations=rotations)
    other = [str(d) for d in differences(config, now)]
    assert other == (["rotations: 'world' -> 'nominal'"] if space == "eef_abs" else [])


def test_rotations_are_of_one_action_space():
    with pytest.raises(ConfigError, match="rotations is for action_space eef_abs, not eef_delta"):
        TrainConfig(action_space="eef_delta", rotations="world")
    with pytest.raises(ConfigError, match="rotations is for action_space eef_abs, not eef_delta"):
        resolve(TrainConfig(preset="paper", rotations="world"), accelerator=False)
    assert "rotations" not in identity(dataclasses.replace(LAPTOP, action_space="eef_delta"))
    new, old = (
        resolve(TrainConfig(action_space="eef_abs", rotations=r), accelerator=False)
        for r in ("nominal", "world")
    )
    assert changes(identity(new) | {"engine": "native"}) == {}
    delta = resolve(TrainConfig(action_space="eef_delta"), accelerator=False)
    assert changes(identity(delta) | {"engine": "native"}) == {"action_space": "eef_delta"}
    assert delta.run_dir.endswith("-keypoints-eef_delta-0")
    assert changes(identity(old))["rotations"] == "world"
    assert identity(new) != identity(old)


def test_the_robots_frame_of_actions_is_not_told_and_another_one_is():
    """Results from before there was another one are compared with those since."""
    assert "action_frame" not in identity(LAPTOP)
    other = identity(changed(action_frame="camera"))
    assert changes(other | {"engine": "native"}) == {"action_frame": "camera"}
    assert changed(action_frame="camera").run_dir.endswith("-keypoints-camera_frame-0")
    (difference,) = differences(LAPTOP, dataclasses.replace(LAPTOP, action_frame="camera"))
    assert difference.changes_program


def test_lenses_of_two_meanings_have_two_folders_and_two_names():
    runs = [changed(lens=lens) for lens in ("opencv:-0.3:0,0.1", "opencv:-0.3,0:0.1")]
    assert len({run.run_dir for run in runs}) == len({full_name(run) for run in runs}) == 2


def test_settings_with_commas_alone_keep_the_names_of_version_0_2_0():
    """Their runs go on in the folders they have, and grids find them."""
    run = changed(pose_noise="1,1", model=("cut=(1,2)",), weights="a,b.pt")
    assert run.run_dir.endswith("-pose_noise1_1-a_b-0")
    assert "-pose_noise1_1-modelcut=_1_2_-weightsa_b-" in full_name(run)


def test_single_tasks_have_values_of_their_own():
    lift, square = (resolve(TrainConfig(task=t), accelerator=False) for t in ("lift", "square"))
    assert (lift.steps, square.steps) == (2000, 6000)
    assert lift.warmup == square.warmup == 200
    assert changes(identity(lift) | {"engine": "native"}) == {}


def test_a_preset_may_change_the_network_and_says_so_in_the_runs_settings(tmp_path):
    """So that a run made before the preset changed is still rebuilt as it was."""

    def attention(*model: str) -> TrainConfig:
        return resolve(TrainConfig(preset="attention", model=model), accelerator=False)

    own = PRESETS["act", "attention"].model
    assert own == ("drop_proprio=true",)
    assert attention().model == attention(*own).model == own
    assert changes(identity(attention()) | {"engine": "native"}) == {}
    assert attention("fold=3").model == (*own, "fold=3")
    assert attention("drop_proprio=false").model == ("drop_proprio=false",)
    before = dataclasses.replace(attention(), model=(), beta2=None)  # nor had it this setting
    (tmp_path / "config.json").write_text(to_json(before))
    read = read_config(tmp_path)
    assert read == dataclasses.replace(attention(), model=("drop_proprio=false",))
    assert changes(identity(read) | {"engine": "native"}) == {"model": ["drop_proprio=false"]}
    same = attention("drop_proprio=False")
    assert [d for d in differences(read, same) if d.changes_program] == []
    assert "--model drop_proprio=false" in reproduce_command(read)
    record = {"policy": "act", "preset": "attention", "model": ["fold=3"]}  # as results keep it
    assert TrainConfig.completed(record)["model"] == ["drop_proprio=false", "fold=3"]
    for odd in ({"policy": []}, {"model": 3}, {"preset": "none"}):
        assert TrainConfig.completed(record | odd) == record | odd
    assert [d.field for d in differences(read, attention())] == ["model"]


def test_runs_of_today_can_be_compared_with_published_ones():
    """A new setting belongs into `UNSAID`, or else no older run is one of the same arm."""
    published = json.loads((REPO / "results/lift-laptop/runs.json").read_text("utf-8"))[0]
    now = identity(LAPTOP) | usual_way("lift")
    assert now == published["settings"]


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


def test_differences_say_what_makes_another_run():
    other = dataclasses.replace(LAPTOP, lr=0.5, pairs=7)
    changes = differences(LAPTOP, other)
    assert [(d.field, d.new, d.changes_program) for d in changes] == [
        ("lr", 0.5, True), ("pairs", 7, False)
    ]  # fmt: skip
    assert str(changes[1]) == "pairs: 50 -> 7"
    assert differences(LAPTOP, LAPTOP) == []
    assert {f.name for f in dataclasses.fields(TrainConfig)} > FREE_TO_CHANGE


def test_a_run_may_be_prolonged_only_if_its_rate_is_constant():
    def longer(config):
        (change,) = differences(config, dataclasses.replace(config, steps=2 * config.steps))
        return change.changes_program

    assert longer(LAPTOP)
    assert not longer(PAPER)


def changed(**changes_):
    return resolve(TrainConfig(**changes_), accelerator=False)


def test_what_is_not_the_default_is_in_the_folders_name():
    config = changed(action_space="joint_abs", n=5, m=2, views=2, weights="a/r18.pt", seed=3)
    kind = "lift-randomized-act-laptop-keypoints"
    assert config.run_dir == f"runs/{kind}-joint_abs-n5m2-2views-r18-3"


def test_a_preset_that_the_policy_lacks_is_refused():
    with pytest.raises(ConfigError, match="act has no preset 'tiny', only paper, lerobot"):
        changed(preset="tiny")


def test_runs_compared_as_one_differ_in_seed_and_in_how_updates_are_computed_alone():
    same = identity(LAPTOP)
    for free in ({"seed": 4}, {"accumulate": 2}, {"keep": 3}, {"data_dir": "x"}, {"pairs": 9}):
        assert identity(changed(**free)) == same
    for other in ({"lr": 0.5}, {"dataset": "x/mine.hdf5"}, {"ensemble": 0.01}, {"demos": 7}):
        assert identity(changed(**other)) != same


def test_changes_are_against_the_preset_and_do_not_repeat_what_follows():
    assert changes(identity(LAPTOP) | {"engine": "native"}) == {}
    shorter = identity(changed(steps=100, lr=0.5)) | {"engine": "native"}
    assert changes(shorter) == {"steps": 100, "lr": 0.5}  # the shorter warm-up follows


def test_the_engine_of_a_tasks_own_simulator_is_no_change():
    push = identity(resolve(TrainConfig(task="push"), accelerator=False))
    assert changes(push | {"engine": "sapien"}) == {}
    assert changes(push | {"engine": "sapien-gpu"}) == {"engine": "sapien-gpu"}
    assert "engine" not in full_name(resolve(TrainConfig(task="push"), accelerator=False))
    assert "ensemble0.01" in full_name(changed(ensemble=0.01))


def test_full_names_tell_runs_apart_in_words_of_a_folder():
    name = full_name(changed(model=("width=64", "heads=2"), lr=0.0005, seed=1))
    assert name == "lift-randomized-act-laptop-keypoints-lr0.0005-modelwidth=64_heads=2-1"
    assert full_name(LAPTOP) == "lift-randomized-act-laptop-keypoints-0"


def test_settings_newer_than_a_run_are_its_presets(tmp_path):
    old = dataclasses.replace(LAPTOP, beta2=None)
    (tmp_path / "config.json").write_text(to_json(old))
    assert read_config(tmp_path) == LAPTOP
