"""A camera that was bumped is found by what never moves in its pictures, and the episode named."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from filmed import calibrations, filmed, room, turned, with_calibrations, with_pictures

from jaxcam.checks.recorded.looks import Looks
from jaxcam.checks.recorded.stills import Background, Shift, check_stills, shift

EPISODES = 6


@pytest.fixture(scope="module")
def data():
    return filmed(EPISODES, 12, views=("front", "left"))


def judge(data, episodes=None):
    looked = range(len(data.episodes)) if episodes is None else episodes
    return list(check_stills(Looks(data), list(looked)))


def turn(axis, degrees):
    return cv2.Rodrigues(np.deg2rad(degrees) * np.eye(3)[axis])[0]


def bumped(data, view, episodes, rotation):
    K = calibrations()[view].K
    return with_pictures(
        data, lambda i, v, p: turned(p, K, rotation) if v == view and i in episodes else p
    )


def test_cameras_that_stand_still(data):
    judged = judge(data)
    assert [(j.finding.mark, j.finding.where) for j in judged] == [
        ("good", "view front"),
        ("good", "view left"),
    ]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_bump_of_three_degrees_is_found_with_its_camera_and_episode(data, axis):
    spoilt = bumped(data, "left", range(3, EPISODES), turn(axis, 3))
    (judged,) = [j for j in judge(spoilt) if j.finding.mark == "bad"]
    assert judged.finding.where == "view left, from episode e3 on"
    assert judged.episodes == (3, 4, 5)
    pattern = r"turned about its middle by ([\d.]+)°" if axis == 2 else r"\(([\d.]+)°\)"
    degrees = float(re.search(pattern, judged.finding.got)[1])
    assert degrees == pytest.approx(3, abs=0.3)


def test_the_first_episode_is_looked_for_between_those_that_are_looked_at(data):
    spoilt = bumped(data, "front", range(2, EPISODES), turn(1, -3))
    (judged,) = [j for j in judge(spoilt, [0, 5]) if j.finding.mark == "bad"]
    assert judged.finding.where == "view front, from episode e2 on"


def test_a_camera_that_comes_back(data):
    spoilt = bumped(data, "left", [2, 3], turn(0, 3))
    (judged,) = [j for j in judge(spoilt) if j.finding.mark == "bad"]
    assert judged.finding.where == "view left, episodes e2, e3"
    assert judged.episodes == (2, 3)


def test_a_pose_that_was_given_anew_is_no_fault(data):
    spoilt = bumped(data, "left", range(3, EPISODES), turn(1, 3))
    pose = np.eye(4)
    pose[:3, :3] = turn(1, 3)
    anew = with_calibrations(
        spoilt,
        lambda i, view, c: (
            replace(c, base_from_camera=c.base_from_camera @ pose)
            if view == "left" and i >= 3
            else c
        ),
    )
    assert {j.finding.mark for j in judge(anew)} == {"good"}


def test_a_pose_that_changes_while_the_picture_does_not_is_told(data):
    pose = np.eye(4)
    pose[:3, :3] = turn(1, 10)
    spoilt = with_calibrations(
        data,
        lambda i, view, c: (
            replace(c, base_from_camera=c.base_from_camera @ pose)
            if view == "left" and i >= 4
            else c
        ),
    )
    (judged,) = [j for j in judge(spoilt) if j.finding.mark == "note"]
    assert judged.finding.got == "its pose changes before episodes e4; its picture does not"
    assert judged.episodes == (4,)


def test_objects_that_are_moved_are_no_bump(data):
    def moved(i, view, pictures):
        pictures = pictures.copy()
        rng = np.random.default_rng([i, len(view)])
        for _ in range(4):
            row, column = rng.integers(0, 56), rng.integers(0, 80)
            pictures[:, row : row + 14, column : column + 14] = rng.integers(0, 255, 3)
        return pictures

    assert {j.finding.mark for j in judge(with_pictures(data, moved))} == {"good"}


def test_light_and_noise_are_no_bump(data):
    def darker(i, view, pictures):
        noise = np.random.default_rng(i).normal(0, 3, pictures.shape)
        return np.clip(pictures * (1 - 0.04 * i) + noise, 0, 255).astype(np.uint8)

    assert {j.finding.mark for j in judge(with_pictures(data, darker))} == {"good"}


def test_surroundings_that_are_always_others_are_told(data):
    def elsewhere(i, view, pictures):
        return np.roll(pictures, 4 * i, axis=2)

    judged = judge(with_pictures(data, elsewhere))
    assert {j.finding.mark for j in judged} == {"note"}
    assert "elsewhere in 6 of 6 episodes" in judged[0].finding.got


def test_what_cannot_be_looked_at_is_said(data):
    plain = with_pictures(data, lambda i, view, p: np.full_like(p, 90))
    assert "too little that never moves" in judge(plain)[0].finding.got
    moving = with_calibrations(
        data,
        lambda i, view, c: replace(c, base_from_camera=np.tile(c.base_from_camera, (12, 1, 1))),
    )
    assert "it is said to move" in judge(moving)[0].finding.got


@pytest.mark.parametrize("by", [0.0, 0.5, 2.0, 7.0])
def test_the_shift_is_that_of_the_picture(by):
    grey = cv2.cvtColor(room("front"), cv2.COLOR_RGB2GRAY)
    warp = np.array([[1, 0, by], [0, 1, 0]], float)
    other = cv2.warpAffine(grey, warp, grey.shape[::-1], borderMode=cv2.BORDER_REFLECT)
    still = np.ones_like(grey)
    apart = shift(Background(grey, still), Background(other, still))
    assert apart.pixels == pytest.approx(by, abs=0.1)
    assert apart.roll_deg == pytest.approx(0, abs=0.2)
    assert shift(Background(grey, 0 * still), Background(other, still)) is None


@pytest.mark.parametrize(
    ("last", "mark"),
    [
        ({0: 0.4, 3: 0.2, 4: None}, "good"),  # a little drift: it is where it stood last
        ({0: 0.4, 3: 0.4, 4: 0.4}, "note"),  # one episode alone, a little off
        ({0: 3.0, 3: 3.0, 4: 3.0}, "bad"),
    ],
)
def test_one_episode_a_little_off_is_no_bump(data, monkeypatch, last, mark):
    """How far the last episode's background is from those before; the others are at one place."""
    made = {}

    def numbered(look):
        number = len(made)
        made[number] = Background(np.full((96, 96), number, np.uint8), np.ones((96, 96), np.uint8))
        return made[number]

    def apart(one, other):
        a, b = sorted((int(one.picture[0, 0]), int(other.picture[0, 0])))
        pixels = 0.0 if b < 5 or a == b else last.get(a, last[3])
        return None if pixels is None else Shift(pixels, 0.0)

    monkeypatch.setattr("jaxcam.checks.recorded.stills.background", numbered)
    monkeypatch.setattr("jaxcam.checks.recorded.stills.shift", apart)
    one_view = replace(
        data,
        views=("front",),
        episodes=[replace(e, sights={"front": e.sights["front"]}) for e in data.episodes],
    )
    assert [j.finding.mark for j in judge(one_view)] == [mark]
