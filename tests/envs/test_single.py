"""One environment: gymnasium's checkers, and the promises of its interface."""

import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from small_envs import SMALL

from jaxcam.envs import env_id
from jaxcam.errors import ConfigError


@pytest.mark.parametrize("options", [{}, {"chunk": 2, "views": 2, "resolution": "16x20"}])
def test_gymnasiums_checker_passes_without_a_warning(make, options):
    env = make(render_mode="rgb_array", **options)
    check_env(env.unwrapped)
    assert env.observation_space["image"].shape == ((2, 16, 20, 3) if options else (1, 16, 16, 3))


@pytest.mark.parametrize("space", ["eef_abs", "joint_abs"])
def test_the_checker_minds_only_the_units_of_absolute_actions(make, space):
    """They are metres and radians: gymnasium recommends numbers from -1 to 1."""
    with pytest.warns(UserWarning, match="symmetric and normalized") as warnings:
        check_env(make(action_space=space).unwrapped, skip_render_check=True)
    assert len(warnings) == 1


def test_what_it_says_of_itself(make):
    env = make()
    observation, info = env.reset(seed=1)
    assert observation.keys() == {"image", "K", "base_from_camera", "state"}
    assert env.unwrapped.metadata["instruction"] == "Lift the cube"
    assert env.metadata["render_fps"] == 20
    assert info == {
        "success": False, "status": "ok", "steps": 0, "pair": -1, "split": "train",
        "episode_seed": info["episode_seed"],
    }  # fmt: skip
    assert 42 <= info["episode_seed"] < 900_042
    *_, truncated, info = [env.step(np.zeros(7)) for _ in range(6)][-1]
    assert truncated is True
    assert info["steps"] == 6


def test_an_action_that_is_no_number_ends_the_episode_as_a_failure(make):
    env = make()
    env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step(np.full(7, np.nan))
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert (info["status"], info["success"]) == ("policy", False)
    assert observation in env.observation_space


def test_pictures_for_people(make):
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    assert env.render().shape == (20, 24, 3)


def test_what_is_for_several_is_refused(make):
    with pytest.raises(ConfigError, match=r"num_envs: use gymnasium\.make_vec"):
        make(num_envs=3)
    env = make().unwrapped
    with pytest.raises(ConfigError, match="reset_mask is for several"):
        env.reset(options={"reset_mask": np.array([True])})
    for seed, message in ((-1, "0 or more"), (1.5, "whole number"), (True, "whole number")):
        with pytest.raises(ConfigError, match=message):
            env.reset(seed=seed)
    with pytest.raises(ConfigError, match="call reset first"):
        env.step(np.zeros(7))
    env.reset()
    with pytest.raises(ConfigError, match=r"shape \[1, 7\], expected \[7\]"):
        env.step(np.zeros((1, 7)))


def test_all_six_tasks_have_names():
    ids = [name for name in gymnasium.registry if name.startswith("jaxcam/")]
    assert sorted(ids) == [
        "jaxcam/Lift-v0", "jaxcam/LiftUpright-v0", "jaxcam/PickPlaceCan-v0", "jaxcam/Push-v0",
        "jaxcam/RollBall-v0", "jaxcam/Square-v0",
    ]  # fmt: skip
    assert env_id("pick_place_can") in ids


def test_a_name_with_its_module_needs_no_import():
    assert gymnasium.make("jaxcam.envs:jaxcam/Lift-v0", **SMALL).action_space.shape == (7,)


def test_without_gymnasium_it_says_how_to_get_it():
    code = """
import sys
sys.modules["gymnasium"] = None
from jaxcam.errors import ConfigError
try:
    import jaxcam.envs
except ConfigError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'jaxcam[gym]'" in done.stdout


def test_a_task_of_maniskill(maniskill, make):
    env = make("push", engine="auto", render_mode="rgb_array")
    first, info = env.reset(options={"pair": 1})
    assert env.unwrapped.metadata["instruction"] == "Push the cube to the target"
    after, *_ = env.step(np.array([0.02, 0, 0, 0, 0, 0, 1], np.float32))
    assert after in env.observation_space
    assert after["state"][7] > first["state"][7]
    assert env.render().shape == (20, 24, 3)
    again, _ = env.reset(options={"pair": 1})
    np.testing.assert_array_equal(again["state"], first["state"])
    assert info["pair"] == 1


def test_a_copy_is_another_environment_of_the_same_kind(make):
    env = make(views=2).unwrapped
    other = pickle.loads(pickle.dumps(env))
    assert other.action_space == env.action_space
    seeds = [e.reset(seed=s)[1]["episode_seed"] for e, s in ((env, 3), (other, np.int64(3)))]
    assert seeds[0] == seeds[1]
