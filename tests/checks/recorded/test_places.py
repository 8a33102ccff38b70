"""Whether the grip is where pictures move: swapped cameras, other bases, other films."""

from dataclasses import replace

import numpy as np
import pytest
from filmed import calibrations, filmed, with_calibrations, with_pictures

from jaxcam.checks.recorded.bases import other_base
from jaxcam.checks.recorded.looks import Looks
from jaxcam.checks.recorded.motion import films_of
from jaxcam.checks.recorded.places import Evidence, check_places
from jaxcam.data.cameras import READINGS
from jaxcam.rays import invert

GRIP = (0, 1, 2)


@pytest.fixture(scope="module")
def data():
    return filmed(6, 16)


def evidence(data):
    return Evidence.of(data, films_of(Looks(data), range(len(data.episodes)), GRIP))


def judge(data):
    return list(check_places(evidence(data)))


def exchanged(data, one, other, episodes):
    names = {one: other, other: one}
    theirs = calibrations()
    return with_calibrations(
        data, lambda i, view, c: theirs[names.get(view, view)] if i in episodes else c
    )


def test_good_cameras_put_the_grip_where_pictures_move(data):
    judged = judge(data)
    assert [j.finding.mark for j in judged] == ["good"] * 3


def test_a_lens_belongs_to_where_the_grip_is(data):
    bent = filmed(4, 16, lens=[-0.4, 0.1, 0, 0])
    assert {j.finding.mark for j in judge(bent)} == {"good"}


def test_swapped_cameras_are_named(data):
    (judged,) = [
        j for j in judge(exchanged(data, "left", "right", range(6))) if j.finding.mark == "bad"
    ]
    assert judged.finding.where == "views left and right"
    assert judged.finding.got.startswith("left and right are swapped")
    assert judged.finding.fix == "Exchange their calibrations, or their pictures."


def test_cameras_that_are_swapped_from_an_episode_on(data):
    judged = judge(exchanged(data, "left", "right", range(3, 6)))
    (swapped,) = [j for j in judged if j.finding.mark == "bad"]
    assert swapped.episodes == (3, 4, 5)
    assert swapped.finding.where == "views left and right, episodes e3, e4, e5"


def moved(yaw_deg, position):
    angle, base = np.deg2rad(yaw_deg), np.eye(4)
    base[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    base[:3, 3] = position
    return base


@pytest.mark.parametrize(
    ("yaw", "position"), [(90, (0, 0, 0)), (0, (0.56, 0, 0.9)), (180, (0.5, -0.3, 0))]
)
def test_poses_of_another_base_are_found_and_the_base_estimated(data, yaw, position):
    other_from_base = moved(yaw, position)
    spoilt = with_calibrations(
        data, lambda i, view, c: replace(c, base_from_camera=other_from_base @ c.base_from_camera)
    )
    base_from_other = invert(other_from_base)
    base = other_base(evidence(spoilt).films)
    np.testing.assert_allclose(base.position, base_from_other[:3, 3], atol=0.2)
    assert abs((base.yaw_deg + yaw + 180) % 360 - 180) < 15
    judged = judge(spoilt)
    assert {j.finding.mark for j in judged} == {"bad"}
    assert all("Likely cause: poses are of another base" in j.finding.fix for j in judged)


def test_one_camera_at_another_place_is_named_alone(data):
    spoilt = with_calibrations(
        data,
        lambda i, view, c: (
            replace(c, base_from_camera=moved(0, (0, 0.35, 0)) @ c.base_from_camera)
            if view == "front"
            else c
        ),
    )
    judged = {j.finding.where: j.finding for j in judge(spoilt)}
    assert judged["view front"].mark != "good"
    assert judged["view left"].mark == judged["view right"].mark == "good"


def test_a_film_of_another_episode_is_named(data):
    films = {view: np.stack(list(s.decode())) for view, s in data.episodes[4].sights.items()}
    spoilt = with_pictures(
        data, lambda i, view, p: films[view][::-1] if (i, view) == (1, "left") else p
    )
    (judged,) = [j for j in judge(spoilt) if j.finding.mark == "note"]
    assert judged.finding.where == "view left, episode e1"
    assert judged.episodes == (1,)


def test_pictures_that_change_everywhere_tell_nothing(data):
    def flicker(i, view, pictures):
        return np.random.default_rng(i).integers(0, 255, pictures.shape).astype(np.uint8)

    judged = judge(with_pictures(data, flicker))
    assert {j.finding.mark for j in judged} == {"note"}
    assert all(j.finding.got.startswith("not known") for j in judged)


def test_views_without_a_pose_that_stands_are_not_looked_at(data):
    bare = with_calibrations(data, lambda i, view, c: None if view == "left" else c)
    judged = {j.finding.where: j.finding for j in judge(bare)}
    assert judged["view left"].mark == "note"
    assert judged["view left"].got.startswith("not looked at")
    assert other_base([f for f in evidence(data).films if f.view == "left"]) is None


def test_readings_are_held_against_pictures(data):
    spoilt = evidence(
        with_calibrations(
            data, lambda i, view, c: replace(c, base_from_camera=invert(c.base_from_camera))
        )
    )
    fits = [spoilt.of_reading(reading, data.views) for reading in READINGS]
    assert int(np.argmax(fits)) == 0
    assert fits[0] > 0.9
    assert spoilt.of_reading(READINGS[0], ["another"]) is None
