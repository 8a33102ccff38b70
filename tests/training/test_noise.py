"""Errors of poses in training: of the size that is asked, and drawn anew for what is asked."""

import jax
import numpy as np
import pytest

from jaxcam.rays import look_at
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.training.noise import pose_noise

B, S, V = 6, 2, 3
ROOT = jax.random.key(4)
POSES = np.tile(look_at(np.array([1.0, 0, 1]), np.zeros(3)), (B, S, V, 1, 1)).astype(np.float32)
DEMO, CAMERA = np.array([0, 0, 1, 1, 2, 0]), np.tile([5, 6, 7], (B, 1))
CAMERA[5] = 6, 5, 7


def errors(size="2,3", per="sample", step=0):
    """Rotation vectors (camera's axes) and shifts of what is told [B, S, V, 3] each."""
    batch = {"base_from_camera": POSES, "demo": DEMO, "camera": CAMERA, "image": 1}
    changed = jax.jit(pose_noise(size, per))(batch, ROOT, step)
    assert set(changed) == {"base_from_camera", "image"}
    wrong = np.asarray(changed["base_from_camera"])
    relative = np.swapaxes(POSES[..., :3, :3], -1, -2) @ wrong[..., :3, :3]
    return rotvec_from_matrix(relative), wrong[..., :3, 3] - POSES[..., :3, 3]


@pytest.mark.parametrize("per", ["sample", "episode", "camera"])
def test_errors_have_their_size_and_are_one_for_all_observations(per):
    turn, shift = errors(per=per)
    assert np.allclose(np.linalg.norm(turn, axis=-1), np.deg2rad(2), atol=2e-4)
    assert np.allclose(np.linalg.norm(shift, axis=-1), 0.03, atol=1e-5)
    assert np.allclose(turn[:, 0], turn[:, 1], atol=1e-6)


def test_each_sample_has_its_own_anew_at_every_step_and_again_the_same():
    shift = errors()[1][:, 0].reshape(-1, 3)
    assert len(np.unique(shift.round(6), axis=0)) == B * V
    assert not np.allclose(shift, errors(step=1)[1][:, 0].reshape(-1, 3))
    assert np.array_equal(shift, errors()[1][:, 0].reshape(-1, 3))


def test_an_episode_s_camera_is_always_wrong_in_one_way():
    shift = errors(per="episode")[1][:, 0]
    assert np.array_equal(shift[0], shift[1])
    assert np.array_equal(shift[2], shift[3])
    assert not np.isclose(shift[0], shift[2]).all(-1).any()
    assert np.array_equal(shift[5], shift[0][[1, 0, 2]])  # the same cameras in another order
    assert np.array_equal(shift, errors(per="episode", step=9)[1][:, 0])


def test_a_camera_is_wrong_in_one_way_in_all_episodes():
    shift = errors(per="camera")[1][:, 0]
    assert np.array_equal(shift[0], shift[4])
    assert np.array_equal(shift[5], shift[0][[1, 0, 2]])
    assert not np.isclose(shift[0, 0], shift[0, 1]).any()


def test_directions_are_uniform():
    batch = {"base_from_camera": np.tile(np.eye(4, dtype=np.float32), (4000, 1, 1, 1))}
    wrong = np.asarray(pose_noise("1,100", "sample")(batch, ROOT, 0)["base_from_camera"])[:, 0]
    second = np.einsum("bi,bj->ij", wrong[:, :3, 3], wrong[:, :3, 3]) / 4000
    assert abs(wrong[:, :3, 3].mean(0)).max() < 0.05
    assert abs(second - np.eye(3) / 3).max() < 0.03


def test_no_error_is_no_change():
    assert pose_noise("", "sample") is None
