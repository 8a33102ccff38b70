"""Batches hold what their index names."""

from dataclasses import replace

import numpy as np
import pytest
from many_cameras import with_errors

from jaxcam.config.train import TrainConfig
from jaxcam.data.batches import demo_actions, make_dataset, seen_by_cameras, stacked_batches
from jaxcam.models.normalization import STD_FLOOR
from jaxcam.sim.actions import ACTION_SPACES, action_dim

CHUNK = 10


@pytest.fixture(scope="module")
def dataset(demos, pictures, scene):
    return make_dataset(demos, pictures, "eef_delta", scene)


def assert_equal(a, b):
    assert a.keys() == b.keys()
    for key in a:
        np.testing.assert_array_equal(a[key], b[key], err_msg=key)


def test_a_batch_holds_what_its_index_names(dataset, demos, pictures, scene):
    demo, t, views = np.array([3, 0]), np.array([0, 7]), np.array([[2, 0], [1, 2]])
    batch = dataset.batch(demo, t, views, CHUNK)
    expected = {
        "image": ((2, 2, 24, 24, 3), "uint8"),
        "K": ((2, 2, 3, 3), "float32"),
        "base_from_camera": ((2, 2, 4, 4), "float32"),
        "proprio": ((2, 11), "float32"),
        "action": ((2, CHUNK, 7), "float32"),
        "is_pad": ((2, CHUNK), "bool"),
    }
    assert {k: (batch[k].shape, batch[k].dtype.name) for k in expected} == expected
    for b in range(2):
        d = demos.train[demo[b]]
        moves = demo_actions(d, "eef_delta", scene)
        np.testing.assert_allclose(batch["action"][b], moves[t[b] : t[b] + CHUNK], atol=1e-6)
        qpos = d.qpos[t[b]]
        np.testing.assert_allclose(batch["proprio"][b, :7], qpos[:7], atol=1e-6)
        reach = scene.world_from_base @ np.append(batch["proprio"][b, 7:10], 1)
        np.testing.assert_allclose(reach[:3], d.eef_pos[t[b]], atol=1e-6)
        for v in range(2):
            row = pictures.layout.at(demo[b], t[b], views[b, v])
            np.testing.assert_array_equal(batch["image"][b, v], pictures.rgb[row])
            world = scene.world_from_base @ batch["base_from_camera"][b, v]
            expected = demos.header.world_from_camera[d.cameras[views[b, v]]]
            np.testing.assert_allclose(world, expected, atol=1e-6)


@pytest.mark.parametrize(("views", "obs_steps"), [(1, 1), (2, 3)])
def test_wanted_pictures_are_those_that_batches_hold(dataset, views, obs_steps):
    rows = np.arange(dataset.pictures.layout.total)
    numbered = np.stack([rows % 256, rows // 256, 0 * rows], -1).astype(np.uint8)[:, None, None]
    dataset = replace(dataset, pictures=replace(dataset.pictures, rgb=numbered))
    sizes = {"views": views, "chunk": CHUNK, "obs_steps": obs_steps}
    made = [dataset.validation(**sizes)]
    for seed in (0, 3):
        made += [batch for _, batch in stacked_batches(dataset, seed, 0, 6, 1, 2, **sizes)]
    held = [b["image"].astype(int)[..., 0] + 256 * b["image"].astype(int)[..., 1] for b in made]
    wanted = dataset.samples.wanted((0, 3), 6, 2, views, obs_steps)
    expected = np.unique(np.concatenate([h.ravel() for h in held]))
    np.testing.assert_array_equal(np.flatnonzero(wanted), expected)
    assert dataset.samples.wanted((0,), 1000, 64, views, obs_steps) is None  # nearly all


def test_errors_and_what_follows_those_ahead_are_masked_and_the_rest_is_as_without(dataset):
    errors = np.zeros(dataset.actions.shape[:2], bool)
    errors[0, 3:6] = errors[1, 0] = True
    demo, t = np.array([0, 1, 2]), np.array([1, 0, 1])  # before errors, in one, and without any
    erring, usual = (
        d.batch(demo, t, np.zeros((3, 1), int), CHUNK)
        for d in (replace(dataset, errors=errors), dataset)
    )
    expected = np.zeros((3, CHUNK), bool)
    expected[0, 2:] = expected[1, 0] = True
    np.testing.assert_array_equal(erring["is_pad"], expected)
    for name in usual.keys() - {"is_pad"}:
        keep = ~expected[..., None] if name in ("action", "keyframe") else True
        np.testing.assert_array_equal(erring[name], usual[name] * keep)


def test_errors_that_are_only_observed_hide_nothing_that_follows(dataset):
    errors = np.zeros(dataset.actions.shape[:2], bool)
    errors[0, 5] = errors[0, 9] = True
    batch = replace(dataset, errors=errors).batch(
        np.array([0]), np.array([6]), np.zeros((1, 1), int), CHUNK, obs_steps=2
    )
    assert batch["is_pad"][0].tolist() == [True] + [False] * 3 + [True] * (CHUNK - 4)


def test_no_keyframe_is_known_before_a_change_of_the_gripper_that_errs(demos, pictures, scene):
    first = demos.train[0]
    (close,) = np.flatnonzero(np.diff(np.sign(first.actions[:, -1]))) + 1
    erring = with_errors(first, close - 2, close + 3)
    some = replace(demos, train=[erring, *demos.train[1:]])
    dataset = make_dataset(some, pictures, "eef_delta", scene)
    lengths, place = dataset.lengths, np.arange(dataset.actions.shape[1])
    expected = np.zeros(dataset.actions.shape[:2], bool)
    expected[0] = place < close
    np.testing.assert_array_equal(dataset.keyframe_errors, expected)
    demo, t = np.array([0, 0, 1]), np.array([0, close + 3, 0])
    batch = dataset.batch(demo, t, np.zeros((3, 1), int), CHUNK)
    assert batch["keyframe_is_pad"][0].all()
    assert not batch["keyframe_is_pad"][1, : lengths[0] - close - 3].any()
    assert not batch["keyframe_is_pad"][2].any()
    plain = make_dataset(demos, pictures, "eef_delta", scene)
    assert plain.errors is plain.keyframe_errors is None
    assert "keyframe_is_pad" not in plain.batch(demo, t, np.zeros((3, 1), int), CHUNK)


def test_what_is_past_the_end_is_masked_and_zero(dataset):
    demo = np.arange(4)
    t = dataset.lengths[:4] - np.array([1, 4, CHUNK, CHUNK + 1])
    batch = dataset.batch(demo, t, np.zeros((4, 1), int), CHUNK)
    assert (~batch["is_pad"]).sum(1).tolist() == [1, 4, CHUNK, CHUNK]
    assert (np.diff(batch["is_pad"].astype(int), axis=1) >= 0).all()
    assert not batch["action"][batch["is_pad"]].any()
    assert batch["action"][~batch["is_pad"]][:, -1].all()  # the gripper's sign is never 0


def test_statistics_are_of_the_training_demonstrations(dataset, demos, scene):
    moves = np.concatenate([demo_actions(d, "eef_delta", scene) for d in demos.train])
    felt = np.concatenate([scene.proprio(d.qpos, d.eef_pos)[:-1] for d in demos.train])
    stats = dataset.stats()
    assert all(v.dtype == np.float32 for v in stats.values())
    expected = {
        "action_mean": moves.sum(0) / len(moves),
        "action_std": np.maximum(np.sqrt(((moves - moves.mean(0)) ** 2).mean(0)), STD_FLOOR),
        "action_min": moves.min(0),
        "action_max": moves.max(0),
        "proprio_mean": felt.sum(0) / len(felt),
        "proprio_std": np.sqrt(((felt - felt.mean(0)) ** 2).mean(0)),
    }
    for key, value in expected.items():
        np.testing.assert_allclose(stats[key], value, rtol=1e-3, atol=1e-6, err_msg=key)


def test_statistics_of_many_steps_do_not_drift(dataset):
    """In float32 the mean of 400,000 times 0.3 is 5e-4 off, and that is then the deviation."""
    count, layout = len(dataset.lengths), dataset.pictures.layout
    longer = replace(layout, lengths=np.full(count, 100_000))
    still = {name: np.full((count, 100_000, 3), 0.3, np.float32)
             for name in ("actions", "keyframes", "proprio")}  # fmt: skip
    pictures = replace(dataset.pictures, layout=longer)
    stats = replace(dataset, pictures=pictures, **still).stats()
    for name in ("action", "keyframe", "proprio"):
        np.testing.assert_array_equal(stats[f"{name}_mean"], np.float32(0.3))
        np.testing.assert_array_equal(stats[f"{name}_std"], np.float32(STD_FLOOR))


@pytest.mark.parametrize("space", ACTION_SPACES)
def test_action_spaces_differ_in_actions_alone(space, demos, pictures, scene, dataset):
    other = make_dataset(demos, pictures, space, scene)
    assert other.actions.shape[-1] == action_dim(space)
    np.testing.assert_array_equal(other.proprio, dataset.proprio)
    assert (other.fingerprint == dataset.fingerprint) == (space == "eef_delta")


def test_old_runs_find_their_data(demos, pictures, scene):
    """Version 0.1.0 wrote eef_abs for what is eef_abs_world now; the new one is other data."""
    prints = {
        space: make_dataset(demos, pictures, space, scene).fingerprint
        for space in ("eef_abs", "eef_abs_world", "joint_abs")
    }
    assert prints["eef_abs_world"].endswith("px-eef_abs")
    assert prints["joint_abs"].endswith("px-joint_abs")
    assert prints["eef_abs"].endswith("px-eef_abs_nominal")


def test_batches_do_not_depend_on_where_reading_starts(dataset):
    sizes = {"views": 2, "chunk": CHUNK}
    whole = dict(stacked_batches(dataset, 5, 0, 12, 2, 3, **sizes))
    assert list(whole) == [0, 2, 4, 6, 8, 10]
    assert whole[0]["image"].shape[:2] == (2, 3)
    for step, batch in stacked_batches(dataset, 5, 6, 12, 2, 3, **sizes):
        assert_equal(batch, whole[step])
    for step, batch in stacked_batches(dataset, 5, 0, 12, 1, 3, **sizes):
        part = {k: v[step % 2] for k, v in whole[step - step % 2].items()}
        assert_equal({k: v[0] for k, v in batch.items()}, part)


@pytest.mark.parametrize("shards", [2, 3])
def test_shards_are_stretches_of_the_same_batches(dataset, shards):
    sizes = {"views": 2, "chunk": CHUNK}
    whole = dict(stacked_batches(dataset, 5, 0, 4, 2, 6, **sizes))
    each = [
        dict(stacked_batches(dataset, 5, 0, 4, 2, 6, (i, shards), **sizes)) for i in range(shards)
    ]
    assert list(whole) == [0, 2]
    assert whole[0]["image"].shape[:2] == (2, 6)
    assert all(part[2]["image"].shape[:2] == (2, 6 // shards) for part in each)
    for step, batch in whole.items():
        assert_equal({k: np.concatenate([part[step][k] for part in each], 1) for k in batch}, batch)


def test_reading_can_stop_early(dataset):
    batches = stacked_batches(dataset, 0, 0, 10**9, 1, 2, views=1, chunk=CHUNK)
    assert next(batches)[0] == 0
    batches.close()
    assert list(stacked_batches(dataset, 0, 4, 4, 1, 2, views=1, chunk=CHUNK)) == []


def test_validation_is_fixed_and_of_held_out_demonstrations(dataset, demos):
    batch = dataset.validation(CHUNK, 1, per_demo=5)
    assert_equal(batch, dataset.validation(CHUNK, 1, per_demo=5))
    assert len(batch["action"]) == 10
    poses = np.unique(batch["base_from_camera"].reshape(-1, 16), axis=0)
    training = dataset.base_from_camera[np.unique(np.concatenate(dataset.windows[:4]))]
    assert len(poses) == 2
    assert not (poses[:, None] == training.reshape(-1, 16)).all(-1).any()
    assert (batch["proprio"][0] == dataset.proprio[4, 0]).all()
    assert (batch["proprio"][4] == dataset.proprio[4, dataset.lengths[4] - 1]).all()


def test_a_keyframe_is_where_the_grip_is_when_its_command_next_changes(dataset, demos, scene):
    demo = demos.train[0]
    closing = int(np.argmax(demo.actions[:, 6] > 0))
    assert 0 < closing < demo.length
    base = scene.world_from_base[:3, 3]
    expected = np.where(
        np.arange(demo.length)[:, None] < closing, demo.eef_pos[closing], demo.eef_pos[-1]
    )
    np.testing.assert_allclose(
        dataset.keyframes[0, : demo.length], expected - base, rtol=0, atol=1e-6
    )
    batch = dataset.batch(np.array([0]), np.array([closing - 1]), np.array([[0]]), 3)
    np.testing.assert_allclose(
        batch["keyframe"][0], (expected - base)[closing - 1 : closing + 2], atol=1e-6
    )


@pytest.mark.parametrize("space", ["eef_delta", "eef_abs"])
def test_statistics_of_what_cameras_see_are_of_each_that_sees(demos, pictures, scene, space):
    """By hand, of each demonstration as each of its cameras sees it."""
    plain = make_dataset(demos, pictures, space, scene)
    base_from_world = np.linalg.inv(scene.world_from_base)
    config = TrainConfig(action_space=space, action_frame="camera", views=1)
    stats = seen_by_cameras(plain, config, base_from_world).stats()
    kept, values, points = plain.stats(), [], []
    for d, demo in enumerate(demos.train):
        for camera in demo.cameras:
            world_from_camera = demos.header.world_from_camera[camera]
            turn, centre = world_from_camera[:3, :3], world_from_camera[:3, 3]
            moves = demo_actions(demo, space, scene)
            ends = moves[:, :3] - (centre if space == "eef_abs" else 0)
            values.append(np.concatenate([ends @ turn, moves[:, 3:6] @ turn, moves[:, 6:]], -1))
            keys = plain.keyframes[d, : demo.length] @ scene.world_from_base[:3, :3].T
            points.append((keys + scene.world_from_base[:3, 3] - centre) @ turn)
    for name, all_of in (("action", values), ("keyframe", points)):
        all_of = np.concatenate(all_of)
        np.testing.assert_allclose(stats[f"{name}_mean"], all_of.mean(0), rtol=1e-3, atol=1e-4)
        wanted = np.maximum(all_of.std(0), STD_FLOOR)
        np.testing.assert_allclose(stats[f"{name}_std"], wanted, rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(stats[f"{name}_min"], all_of.min(0), rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(stats["proprio_mean"], kept["proprio_mean"])
    assert seen_by_cameras(plain, TrainConfig(action_space=space), base_from_world) is plain


def test_cameras_that_move_see_their_own_step_and_the_last_is_never_first(dataset):
    rng = np.random.default_rng(0)
    count, views = len(dataset.lengths), 2
    poses = np.tile(np.eye(4, dtype=np.float32), (5000, 1, 1))
    poses[:, :3, 3] = rng.normal(size=(5000, 3))  # turned by nothing: a move is a move everywhere
    windows = [rng.integers(0, 5000, (n, 3)) for n in dataset.lengths]
    moving = replace(dataset, base_from_camera=poses, windows=windows, ordered=True)
    config = TrainConfig(action_space="eef_abs", action_frame="camera", views=views)
    stats = seen_by_cameras(moving, config, np.eye(4)).stats()
    viewed = [
        dataset.actions[d, :n, None, :3] - poses[windows[d][:, :2], :3, 3]
        for d, n in enumerate(dataset.lengths[: dataset.train])
    ]
    viewed = np.concatenate([part.reshape(-1, 3) for part in viewed])
    np.testing.assert_allclose(stats["action_max"][:3], viewed.max(0), rtol=1e-5)
    np.testing.assert_allclose(stats["action_mean"][:3], viewed.mean(0), rtol=1e-3, atol=1e-5)
    assert count > dataset.train
