"""Environments side by side: the same as one by one, in each way of beginning anew."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics, RescaleAction

from jaxcam.errors import ConfigError

MODES = ("NextStep", "SameStep", "Disabled")


def assert_same(ours, theirs):
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for name in ours:
            assert_same(ours[name], theirs[name])
    elif isinstance(ours, np.ndarray) and ours.dtype == object:
        for one, other in zip(ours, theirs, strict=True):
            assert_same(one, other)
    else:
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype
        np.testing.assert_array_equal(ours, theirs)


@pytest.fixture
def both(make, make_vec):
    """Environments that are stepped together, and as many that gymnasium steps one by one."""

    def both(mode, **options):
        together = make_vec(autoreset_mode=mode, **options)
        apart = SyncVectorEnv(
            [lambda: make(**options) for _ in range(3)], autoreset_mode=AutoresetMode(mode)
        )
        return together, apart

    return both


@pytest.mark.parametrize("mode", MODES)
def test_they_are_the_same_as_one_by_one(both, mode):
    together, apart = both(mode, horizon=4)
    assert together.observation_space == apart.observation_space
    assert together.action_space == apart.action_space
    assert together.metadata["autoreset_mode"] is apart.metadata["autoreset_mode"]
    for ours, theirs in zip(together.reset(seed=5), apart.reset(seed=5), strict=True):
        assert_same(ours, theirs)
    rng = np.random.default_rng(1)
    over = np.zeros(3, bool)
    for step in range(11):
        if mode == "Disabled" and over.any():
            asked = {"reset_mask": over}
            again = zip(together.reset(options={**asked}), apart.reset(options=asked), strict=True)
            for i, (ours, theirs) in enumerate(again):
                if i == 0:  # gymnasium's infos are of those alone that begin, and so are ours
                    assert_same(ours, theirs)
                else:
                    assert_same({k: v[over] for k, v in ours.items()},
                                {k: v[over] for k, v in theirs.items()})  # fmt: skip
        actions = rng.uniform(-0.02, 0.02, (3, 7)).astype(np.float32)
        if step == 2:  # so that they do not begin together
            actions[1, 3] = np.nan
        results = together.step(actions), apart.step(actions)
        for ours, theirs in zip(*results, strict=True):
            assert_same(ours, theirs)
        over = results[0][2] | results[0][3]


def test_episodes_that_are_over_stay_as_they_are_where_nothing_begins_anew(make_vec):
    envs = make_vec(autoreset_mode="Disabled", horizon=5)
    envs.reset(seed=0)
    actions = np.full((3, 7), 0.01)
    broken = actions.copy()
    broken[0, 0] = np.inf
    first, _, terminated, _, infos = envs.step(broken)
    assert terminated.tolist() == [True, False, False]
    assert infos["status"].tolist() == ["policy", "ok", "ok"]
    later, rewards, terminated, truncated, infos = envs.step(actions)
    assert terminated.tolist() == [True, False, False]
    assert infos["steps"].tolist() == [0, 2, 2]
    assert rewards.tolist() == [0, 0, 0]
    np.testing.assert_array_equal(later["state"][0], first["state"][0])
    np.testing.assert_array_equal(later["image"][0], first["image"][0])
    assert (later["state"][1] != first["state"][1]).any()
    for _ in range(3):
        *_, truncated, _ = envs.step(actions)
    assert truncated.tolist() == [False, True, True]


def test_physics_that_fails_cuts_the_episode_and_says_so(make_vec, monkeypatch):
    envs = make_vec()
    envs.reset(seed=0)
    engine = envs.batch.engine
    step = engine.step

    def failing(state, command, active=None):
        after = step(state, command, active)
        after.qpos[1] = np.nan
        return after._replace(ok=after.ok & [True, False, True])

    monkeypatch.setattr(engine, "step", failing)
    observations, _, terminated, truncated, infos = envs.step(np.zeros((3, 7)))
    assert terminated.tolist() == [False, False, False]
    assert truncated.tolist() == [False, True, False]
    assert infos["status"].tolist() == ["ok", "simulator", "ok"]
    assert observations in envs.observation_space
    monkeypatch.undo()
    *_, infos = envs.step(np.zeros((3, 7)))
    assert infos["status"].tolist() == ["ok"] * 3
    assert infos["steps"].tolist() == [2, 0, 2]


def test_pairs_are_given_to_some_or_all(make_vec):
    envs = make_vec()
    _, infos = envs.reset(options={"pair": 7, "split": "validation"})
    assert infos["pair"].tolist() == [7, 8, 9]
    assert infos["episode_seed"].tolist() == [2_000_007, 2_000_008, 2_000_009]
    first, infos = envs.reset(options={"pair": [4, 0, 2]})
    assert infos["pair"].tolist() == [4, 0, 2]
    assert infos["split"].tolist() == ["test"] * 3
    mask = np.array([False, True, False])
    again, infos = envs.reset(options={"pair": 4, "reset_mask": mask})
    assert infos["_pair"].tolist() == mask.tolist()
    assert infos["pair"][1] == 4
    for name, array in again.items():
        np.testing.assert_array_equal(array, first[name][[0, 0, 2]])


def test_gymnasiums_wrappers_take_them(make_vec):
    """Those that learners put around: actions from -1 to 1, returns, infos one by one."""
    envs = make_vec(horizon=2)
    wrapped = RecordEpisodeStatistics(RescaleAction(envs, -1, 1))
    assert wrapped.action_space.high.max() == 1
    wrapped.reset(seed=1)
    for _ in range(2):
        *_, truncated, infos = wrapped.step(np.ones((3, 7), np.float32))
    assert truncated.all()
    assert infos["episode"]["l"].tolist() == [2, 2, 2]
    _, infos = DictInfoToList(envs).reset(options={"pair": 1})
    assert [info["pair"] for info in infos] == [1, 2, 3]


def test_it_draws_for_people_what_it_is_asked_to(make_vec):
    envs = make_vec(render_mode="rgb_array")
    envs.reset(options={"pair": [0, 0, 1]})
    pictures = envs.render()
    assert [picture.shape for picture in pictures] == [(20, 24, 3)] * 3
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any()
    assert make_vec().render() is None


def test_make_vec_is_one_batch_and_not_many_environments(make_vec):
    envs = make_vec(num_envs=5)
    assert envs.unwrapped is envs
    envs.reset(seed=0)
    assert envs.batch.now.progress.state.qpos.shape[0] == 5
    assert gymnasium.spec("jaxcam/Lift-v0").vector_entry_point == "jaxcam.envs.vector:TaskVectorEnv"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs must be 1 to"),
        ({"num_envs": 2.0}, "num_envs must be 1 to"),
        ({"autoreset_mode": "samestep2"}, "did you mean 'SameStep'"),
        ({"render_mode": "human"}, "rgb_array, or None"),
        ({"view": 2}, "Unknown option 'view', did you mean 'views'"),
    ],
)
def test_bad_options_are_refused_in_words(make_vec, options, message):
    with pytest.raises(ConfigError, match=message):
        make_vec(**options)


@pytest.mark.parametrize(
    ("seed", "message"),
    [
        ([1, 2], "2 seeds, and there are 3"),
        (-1, "0 or more"),
        ("one", "whole number"),
        (1.5, "whole number"),
    ],
)
def test_bad_seeds_are_refused_in_words(make_vec, seed, message):
    with pytest.raises(ConfigError, match=message):
        make_vec().reset(seed=seed)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((3, 6)), r"shape \[3, 6\], expected \[3, 7\]"),
        (np.zeros(7), r"shape \[7\], expected \[3, 7\]"),
        ([[0.0], [0.0, 1.0], []], "no array of numbers"),
        ([["a"] * 7] * 3, "no array of numbers"),
        ([["0"] * 7] * 3, "they are <U1"),
        (np.full((3, 7), 1j), "they are complex128"),
        (None, "no array of numbers|shape"),
    ],
)
def test_bad_actions_are_refused_in_words(make_vec, actions, message):
    envs = make_vec()
    envs.reset(seed=0)
    with pytest.raises(ConfigError, match=message):
        envs.step(actions)


def test_nothing_is_stepped_before_it_begins_or_after_it_ends(make_vec):
    envs = make_vec(render_mode="rgb_array")
    for use in (lambda: envs.step(np.zeros((3, 7))), envs.render):
        with pytest.raises(ConfigError, match="call reset first"):
            use()
    with pytest.raises(ConfigError, match="all environments must begin"):
        envs.reset(options={"reset_mask": np.array([True, False, True])})
    envs.reset(seed=0)
    envs.close()
    envs.close()
    for use in (lambda: envs.step(np.zeros((3, 7))), envs.render, envs.reset):
        with pytest.raises(ConfigError, match="is closed"):
            use()
