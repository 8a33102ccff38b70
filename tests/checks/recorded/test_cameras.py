"""Calibrations that cannot be are found, and what they may mean is named."""

from dataclasses import replace

import numpy as np
import pytest
from filmed import calibrations, filmed, with_calibrations
from robots import recording as robot

from jaxcam.checks.recorded.cameras import check_calibrations, check_sights, stands_of
from jaxcam.data.cameras import READINGS
from jaxcam.data.recorded.parts import meaning_of
from jaxcam.rays import invert, opengl_from_opencv
from jaxcam.rays.lens import pack
from jaxcam.rays.rotations import matrix_from_quaternion, quaternion_from_matrix


@pytest.fixture(scope="module")
def data():
    return filmed(episodes=3, length=12)


def about(judged, what):
    return [j for j in judged if j.finding.what == what]


def test_good_calibrations(data, tmp_path):
    for good in (data, filmed(2, 8, lens=[-0.2, 0.05, 0, 0]), robot(tmp_path)):
        judged = [*check_calibrations(good), *check_sights(good, meaning_of(good).grip)]
        assert [j.finding.mark for j in judged] == ["good"] * 5


def test_calibrations_that_lack_are_told(data):
    bare = with_calibrations(data, lambda i, view, c: None if view == "left" else c)
    (finding,) = [j.finding for j in about(check_calibrations(bare), "calibrations")]
    assert finding.mark == "note"
    assert finding.where == "views left"
    assert {stand.view for stand in stands_of(bare)} == {"front", "right"}


def with_intrinsics(data, change, views=("left",), first=0):
    return with_calibrations(
        data,
        lambda i, view, c: replace(c, K=change(c.K)) if view in views and i >= first else c,
    )


@pytest.mark.parametrize("ratio", [0.5, 0.75, 1.5, 2.0, 6.67])
def test_intrinsics_for_another_size_is_named_with_the_ratio(data, ratio):
    spoilt = with_intrinsics(data, lambda K: np.diag([ratio, ratio, 1]) @ K, first=1)
    (judged,) = about(check_calibrations(spoilt), "K")
    finding = judged.finding
    assert finding.mark == "bad"
    assert finding.where == "view left, episodes e1, e2"
    assert judged.episodes == (1, 2)
    assert f"{96 * ratio:.0f} x {72 * ratio:.0f}, {ratio:.3g} times these" in finding.fix


def shifted(K):
    return K + np.array([[0, 0, 0], [0, 0, 20.0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("change", "mark", "words"),
    [
        (shifted, "note", "principal point"),
        (lambda K: np.diag([1.0, 1.4, 1]) @ K @ np.diag([1, 1, 1]), "note", "principal point"),
        (lambda K: K * [[1.3, 1, 1]] * 1.0, "note", "fx 143 and fy 110"),
        (lambda K: K * [[10, 10, 1]], "note", "a field of view of"),
        (lambda K: K * np.nan, "bad", "K ="),
    ],
)
def test_odd_intrinsics(data, change, mark, words):
    (judged,) = about(check_calibrations(with_intrinsics(data, change)), "K")
    assert judged.finding.mark == mark
    assert words in judged.finding.got


def test_poses_that_are_not_rigid_are_bad(data):
    spoilt = with_calibrations(
        data,
        lambda i, view, c: (
            replace(c, base_from_camera=c.base_from_camera * 1.1) if view == "right" else c
        ),
    )
    (judged,) = about(check_calibrations(spoilt), "camera poses")
    assert judged.finding.mark == "bad"
    assert judged.finding.got.startswith("view right")


def test_a_lens_that_leaves_pixels_without_a_ray(data):
    lens = np.asarray(pack(np.array([-1.5, 0.0, 0.0, 0.0])))
    spoilt = with_calibrations(
        data, lambda i, view, c: replace(c, distortion=lens) if view == "front" else c
    )
    (judged,) = about(check_calibrations(spoilt), "lenses")
    assert judged.finding.mark != "good"
    assert "of the pixels have a ray" in judged.finding.got


def rotated(pose, rotation):
    pose = pose.copy()
    pose[:3, :3] = rotation
    return pose


def scaled(pose, factor):
    pose = pose.copy()
    pose[:3, 3] *= factor
    return pose


def quaternions(pose, by):
    q = np.roll(quaternion_from_matrix(pose[:3, :3]), by, -1)
    return rotated(pose, matrix_from_quaternion(q))


MIX_UPS = [
    invert,
    opengl_from_opencv,
    lambda pose: invert(opengl_from_opencv(pose)),
    lambda pose: rotated(pose, pose[:3, :3].T),
    lambda pose: quaternions(pose, -1),
    lambda pose: quaternions(pose, 1),
    lambda pose: scaled(pose, 1000),
    lambda pose: scaled(pose, 100),
]
"""What was done to poses, in the order of `READINGS`; the ninth, another base, needs pictures."""


@pytest.mark.parametrize("number", range(len(MIX_UPS)))
def test_a_mix_up_of_conventions_is_named(data, number):
    spoilt = with_calibrations(
        data,
        lambda i, view, c: replace(
            c, base_from_camera=np.asarray(MIX_UPS[number](c.base_from_camera))
        ),
    )

    def fits(reading, views):  # as pictures tell
        return 0.95 if reading is READINGS[number] else 0.5

    judged = list(check_sights(spoilt, meaning_of(data).grip, fits))
    assert {j.finding.mark for j in judged} == {"bad"}
    for j in judged:
        assert f"Likely cause: {READINGS[number].words}." == j.finding.fix
        assert j.explained


def test_a_mix_up_that_pictures_contradict_is_not_named(data):
    spoilt = with_calibrations(
        data, lambda i, view, c: replace(c, base_from_camera=invert(c.base_from_camera))
    )
    judged = list(check_sights(spoilt, meaning_of(data).grip, lambda reading, views: 0.5))
    assert all("No usual mix-up" in j.finding.fix for j in judged)
    assert not any(j.explained for j in judged)


def test_only_the_view_and_the_episodes_that_are_wrong_are_named(data):
    pose = calibrations()["left"].base_from_camera.copy()
    pose[2, 3] += 9
    spoilt = with_calibrations(
        data,
        lambda i, view, c: replace(c, base_from_camera=pose) if (view, i) == ("left", 2) else c,
    )
    (judged,) = check_sights(spoilt, meaning_of(data).grip)
    assert judged.finding.where == "view left, episode e2"
    assert judged.episodes == (2,)


def test_an_upside_down_camera_is_told_and_usable(data):
    spoilt = with_calibrations(
        data,
        lambda i, view, c: (
            replace(c, base_from_camera=c.base_from_camera @ np.diag([-1.0, -1, 1, 1]))
            if view == "front"
            else c
        ),
    )
    (judged,) = check_sights(spoilt, meaning_of(data).grip)
    assert judged.finding.mark == "note"
    assert "upside down" in judged.finding.got


def test_a_camera_that_the_robot_carries_may_be_near_and_turned(tmp_path):
    data = robot(tmp_path, views=("front", "wrist"), moving=("wrist",), lens=False)
    grip = meaning_of(data).grip
    near = with_calibrations(
        data, lambda i, view, c: carried(data, grip, i, c) if view == "wrist" else c
    )
    assert [j.finding.mark for j in check_sights(near, grip)] == ["good"]


def carried(data, grip, episode, calibration):
    """A camera 8 cm above the grip that looks down on it and turns as the hand does."""
    places = data.episodes[episode].state[:, list(grip)].astype(float)
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    angle = np.linspace(0, 3, len(places))
    poses[:, 0, 0], poses[:, 0, 1] = np.cos(angle), np.sin(angle)
    poses[:, 1, 0], poses[:, 1, 1] = np.sin(angle), -np.cos(angle)
    poses[:, 2, 2] = -1
    poses[:, :3, 3] = places + np.array([0, 0, 0.08])
    return replace(calibration, base_from_camera=poses)
