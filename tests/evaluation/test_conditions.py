"""Pairs under conditions: what is told has its error, what is drawn its range, repeatably."""

import numpy as np
import pytest

from jaxcam.config.conditions import Conditions
from jaxcam.data.pairs import make_pairs
from jaxcam.data.splits import TRAIN_CAMERAS
from jaxcam.evaluation.conditions import ConditionedPairs
from jaxcam.rays import invert, sample_poses
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim import make_task

SIZE, NUMBERS = (24, 32), [4, 1, 2]


@pytest.fixture(scope="module")
def world():
    task = make_task("lift")
    return task, task.scene("randomized")


def seen(world, split="test", numbers=NUMBERS, rays_from="true", **conditions):
    task, scene = world
    pairs = make_pairs(task, scene, 2, split, numbers)
    made = ConditionedPairs(task, scene, Conditions(**conditions), rays_from)
    return made.seen(pairs, split, numbers, SIZE), invert(scene.world_from_base) @ pairs.cameras


def errors(world, **more):
    """Rotation vectors and shifts of the poses that are told [B, V, 3]."""
    shown, true = seen(world, **more)
    poses = shown.claimed.base_from_camera
    relative = np.swapaxes(true[..., :3, :3], -1, -2) @ poses[..., :3, :3]
    return rotvec_from_matrix(relative), poses[..., :3, 3] - true[..., :3, 3]


def test_usual_pairs_are_told_what_is_so(world):
    shown, _ = seen(world)
    assert shown.claimed == (None, None, None)
    assert shown.lens is None
    assert shown.fovy_deg is None
    assert np.array_equal(shown.K, np.broadcast_to(intrinsics(45.0, *SIZE), (3, 2, 3, 3)))


def test_errors_have_their_size_and_are_each_pair_s_own(world):
    turn, shift = errors(world, pose_noise="2,3")
    assert np.allclose(np.linalg.norm(turn, axis=-1), np.deg2rad(2), atol=3e-4)
    assert np.allclose(np.linalg.norm(shift, axis=-1), 0.03, atol=1e-5)
    assert len(np.unique(shift.reshape(-1, 3).round(5), axis=0)) == 6
    again = errors(world, pose_noise="2,3", numbers=[1, 4])[1]
    assert np.allclose(again, shift[[1, 0]], atol=1e-6)  # whoever else is in the batch
    other = errors(world, pose_noise="2,3", split="validation")[1]
    assert not np.allclose(other, shift, atol=1e-3)


def test_an_error_of_another_size_has_the_same_direction(world):
    turn, shift = errors(world, pose_noise="2,3")
    more_turn, more_shift = errors(world, pose_noise="8,6")
    assert np.allclose(4 * turn, more_turn, atol=2e-3)
    assert np.allclose(2 * shift, more_shift, atol=1e-5)


def test_drift_has_its_speed(world):
    drift = seen(world, pose_drift="2,3")[0].claimed.drift
    assert np.allclose(np.linalg.norm(drift[..., :3], axis=-1), np.deg2rad(2))
    assert np.allclose(np.linalg.norm(drift[..., 3:], axis=-1), 0.03)


def test_fields_of_view_are_drawn_and_told(world):
    shown, _ = seen(world, fovy="25:75", lens="opencv:-0.2:0")
    assert np.all((shown.fovy_deg >= 25) & (shown.fovy_deg <= 75))
    assert np.ptp(shown.fovy_deg) > 1
    expected = [intrinsics(fovy, *SIZE) for fovy in shown.fovy_deg]
    assert np.allclose(shown.K[:, 0], expected)
    assert shown.lens.shape == (3, 2, 9)
    assert shown.claimed.K is None
    fewer = seen(world, fovy="25:75", numbers=[2])[0]
    assert np.allclose(fewer.fovy_deg, shown.fovy_deg[2])
    assert fewer.lens is None


def test_with_nominal_rays_the_usual_k_is_told(world):
    claimed = seen(world, fovy="25:75", rays_from="nominal")[0].claimed
    assert np.array_equal(claimed.K[0, 0], intrinsics(45.0, *SIZE))


def test_cameras_that_training_saw_come_again_with_what_they_had(world):
    task, scene = world
    known = sample_poses(task.cameras, 3, TRAIN_CAMERAS)
    pairs = make_pairs(task, scene, 1, "train", range(5), known)
    conditions = Conditions(fovy="30:60", lens="opencv:-0.2:0")
    shown = ConditionedPairs(task, scene, conditions, cameras=3).seen(
        pairs, "train", range(5), SIZE
    )
    lens, fovy = shown.lens, shown.fovy_deg
    assert lens is not None
    assert fovy is not None
    assert np.array_equal(pairs.cameras[3:], pairs.cameras[:2])
    assert np.array_equal(shown.K[3:], shown.K[:2])
    assert np.array_equal(lens[3:], lens[:2])
    assert np.array_equal(fovy[3:], fovy[:2])
    assert len(np.unique(fovy)) == 3
