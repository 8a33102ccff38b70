"""Recorded datasets as arrays: who is held out, and which camera goes with which picture."""

import dataclasses

import numpy as np
import pytest
import robots

from jaxcam.data.recorded.fitting import fit
from jaxcam.data.recorded.parts import HeldOut, Meaning, make_recorded, opens_gripper, parts_of
from jaxcam.data.recorded.pictures import load_recorded_pictures
from jaxcam.errors import ConfigError

SIZE = (24, 32)


ONE = HeldOut(count=1)
NOTHING_KNOWN = Meaning()


def made(folder, recording, held_out=ONE, views=1, meaning=NOTHING_KNOWN):
    parts = parts_of(recording, held_out, views)
    pictures = load_recorded_pictures(recording, parts, SIZE, folder)
    return parts, make_recorded(recording, parts, pictures, meaning)


def test_episodes_and_views_are_held_out(tmp_path):
    recording = robots.recording(tmp_path, views=("front", "side", "wrist"))
    held_out = HeldOut(("wrist",), (1,))
    parts = parts_of(recording, held_out, 2)
    said = [(p.episode, p.views, p.group) for p in parts.all]
    assert said == [
        (0, ("front", "side"), "training"),
        (2, ("front", "side"), "training"),
        (3, ("front", "side"), "training"),
        (1, ("front", "side"), "new episodes"),
        (1, ("wrist", "front"), "new cameras"),
    ]
    assert parts.train == 3


def test_the_datasets_own_split_and_the_usual_one(tmp_path):
    recording = robots.recording(tmp_path, episodes=11)
    own = dataclasses.replace(recording, valid=(2, 5))
    groups = [p.episode for p in parts_of(own, HeldOut(), 1).all if p.group == "new episodes"]
    assert groups == [2, 5]
    usual = parts_of(recording, HeldOut(), 1)
    assert len(usual.all) - usual.train == 2  # one of five
    assert parts_of(recording, HeldOut(count=0), 1).train == 11


@pytest.mark.parametrize(
    ("held_out", "views", "words"),
    [
        (HeldOut(views=("frnt",)), 1, "has no view 'frnt'.*did you mean 'front'"),
        (HeldOut(episodes=(9,)), 1, "has no episode 9: its 4 are 0 to 3"),
        (HeldOut(episodes=(0, 1, 2, 3)), 1, "no episode remains"),
        (HeldOut(), 3, r"episode '0' is seen by 2 views .* Give --views 2"),
        (HeldOut(views=("side",)), 2, "Give --views 1"),
        (HeldOut(views=("side", "front")), 1, "no view remains for training"),
    ],
)
def test_what_cannot_be_held_out(tmp_path, held_out, views, words):
    with pytest.raises(ConfigError, match=words):
        parts_of(robots.recording(tmp_path), held_out, views)


def test_a_view_that_is_held_out_twice_is_judged_once(tmp_path):
    recording = robots.recording(tmp_path)
    once, twice = (parts_of(recording, HeldOut(("side",) * n, (1,)), 1) for n in (1, 2))
    assert once == twice


def test_a_view_that_did_not_see_an_episode(tmp_path):
    views = ("front", "side", "wrist")
    recording = robots.recording(tmp_path, views=views)
    del recording.episodes[2].sights["side"]
    with pytest.raises(ConfigError, match=r"'2' is seen by 2 views .*front, wrist.* --views 2"):
        parts_of(recording, ONE, 3)
    parts, data = made(tmp_path, recording, ONE, views=2)
    assert [len(window) for window in data.windows] == [len(p.views) for p in parts.all]
    for seed in range(20):
        demo, t, cameras = data.samples.index(seed, 0, parts.train, 2)
        batch = data.batch(demo, t, cameras, chunk=2)
        for row, d in enumerate(demo):
            part = parts.all[d]
            for place, camera in enumerate(cameras[row]):
                sight = recording.episodes[part.episode].sights[part.views[camera]]
                pose = sight.calibration.base_from_camera
                np.testing.assert_allclose(batch["base_from_camera"][row, place], pose, rtol=1e-6)
    del recording.episodes[1].sights["side"], recording.episodes[1].sights["front"]
    with pytest.raises(ConfigError, match=r"is seen by 0 views .* Leave the episode out"):
        parts_of(recording, HeldOut(("wrist",), (3,)), 1)


def test_each_picture_has_its_own_camera(tmp_path):
    """Every row of every batch: the picture, its K, pose and lens are those of one sight."""
    views = ("front", "side", "wrist")
    recording = robots.recording(tmp_path, views=views, moving=("wrist",))
    parts, data = made(tmp_path, recording, HeldOut(count=1), views=3)
    demo = np.arange(len(parts.all)).repeat(9)
    t = np.tile(np.arange(9), len(parts.all))
    batch = data.batch(demo, t, np.tile([2, 0, 1], (len(demo), 1)), chunk=3)
    for row, (d, step) in enumerate(zip(demo, t, strict=True)):
        episode = recording.episodes[parts.all[d].episode]
        for place, view in enumerate(("wrist", "front", "side")):
            sight, fitted = episode.sights[view], fit(robots.SIZES[view], SIZE)
            expected = fitted.picture(robots.picture(int(episode.name), view, step))
            np.testing.assert_array_equal(batch["image"][row, place], expected)
            calibration = sight.calibration
            K = fitted.intrinsics(calibration.K)
            np.testing.assert_allclose(batch["K"][row, place], K, rtol=1e-6)
            poses = calibration.base_from_camera
            pose = poses[step] if poses.ndim == 3 else poses
            np.testing.assert_allclose(batch["base_from_camera"][row, place], pose, rtol=1e-6)
            lens = calibration.distortion
            np.testing.assert_allclose(batch["distortion"][row, place], lens, rtol=1e-6)
        np.testing.assert_array_equal(batch["proprio"][row], episode.state[step])
        np.testing.assert_array_equal(batch["action"][row, 0], episode.action[step])


def test_several_observations(tmp_path):
    recording = robots.recording(tmp_path, moving=("side",))
    _, data = made(tmp_path, recording)
    demo, t, views = np.array([0, 1]), np.array([0, 5]), np.array([[1], [1]])
    batch = data.batch(demo, t, views, chunk=4, obs_steps=2)
    poses = recording.episodes[0].sights["side"].calibration.base_from_camera
    np.testing.assert_allclose(batch["base_from_camera"][0, :, 0], poses[[0, 0]], rtol=1e-6)
    assert batch["distortion"].shape == (2, 2, 1, 9)
    single = data.batch(demo, t - [0, 1], views, chunk=4)
    np.testing.assert_array_equal(batch["image"][1, 0], single["image"][1])


def test_pinholes_have_no_lens(tmp_path):
    _, data = made(tmp_path, robots.recording(tmp_path, lens=False))
    assert data.distortion is None
    batch = data.batch(np.array([0]), np.array([0]), np.array([[0]]), chunk=2)
    assert "distortion" not in batch
    assert "keyframe" not in batch


def test_named_cameras_keep_their_order(tmp_path):
    recording = robots.recording(tmp_path, views=("front", "side", "wrist"))
    _, data = made(tmp_path, recording, views=2)
    shown = np.concatenate([data.samples.index(0, step, 6, 2)[2] for step in range(20)])
    assert (np.diff(shown, axis=1) > 0).all()
    assert set(map(tuple, shown)) == {(0, 1), (0, 2), (1, 2)}


def test_keyframes_are_where_the_gripper_changes(tmp_path):
    recording = robots.recording(tmp_path)
    first = recording.episodes[0]
    first.action[:, 4] = [0, 0, 0, 1, 1, 1, 0, 0, 0, 0]
    meaning = Meaning(grip=(0, 1, 2), gripper=4)
    _, data = made(tmp_path, recording, HeldOut(episodes=(3,)), meaning=meaning)
    where = [3, 3, 3, 6, 6, 6, 9, 9, 9, 9]
    np.testing.assert_array_equal(data.keyframes[0, :10], first.state[where, :3])
    assert data.errors is None
    assert data.keyframe_errors is None


def test_actions_that_err_are_not_imitated(tmp_path):
    recording = robots.recording(tmp_path)
    first = recording.episodes[0]
    first.action[:, 4] = [0, 0, 0, 1, 1, 1, 0, 0, 0, 0]
    err = np.isin(np.arange(10), [2, 3])
    recording.episodes[0] = dataclasses.replace(first, errors=err)
    meaning = Meaning(grip=(0, 1, 2), gripper=4)
    parts, data = made(tmp_path, recording, HeldOut(episodes=(3,)), meaning=meaning)
    for samples in (data.samples, parts.samples(recording)):
        drawn = [samples.index(0, step, 6, 1) for step in range(99)]
        demo, t, _ = (np.concatenate(part) for part in zip(*drawn, strict=True))
        assert set(t[demo == 0]) == set(np.flatnonzero(~err))
        assert set(t[demo == 1]) == set(range(11))
    batch = data.batch(np.array([0, 0]), np.array([0, 4]), np.array([[0], [0]]), chunk=4)
    np.testing.assert_array_equal(batch["is_pad"], [[0, 0, 1, 1], [0, 0, 0, 0]])
    np.testing.assert_array_equal(batch["keyframe_is_pad"][1], [0, 0, 0, 0])
    assert batch["keyframe_is_pad"][0].all()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("gripper", True),
        ("right_gripper.pos", True),
        ("gripper_position", True),
        ("main_gripper", True),
        ("grip_x", False),
        ("gripper_pos_z", False),
        ("gripper.position.x", False),
        ("gripper_roll", False),
        ("grip_rx", False),
        ("joint_1", False),
    ],
)
def test_a_gripper_is_no_place(name, expected):
    assert opens_gripper(name) == expected
