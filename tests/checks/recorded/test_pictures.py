"""Films that show nothing or stand still are named, whatever sensors and codecs add to them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from filmed import AIM, about, calibrations, film, filmed, sight, with_pictures

from jaxcam.checks.recorded.report import check_recorded


def judged(change, **more):
    """What is said of pictures where one film of one view is changed."""

    def spoil(i, view, pictures):
        return change(pictures).astype(np.uint8) if (i, view) == (1, "front") else pictures

    recording = replace(with_pictures(filmed(2, 12), spoil), **more)
    findings = check_recorded(recording).findings
    return [f.got for mark in ("bad", "good") for f in about(findings, "pictures", mark)]


def noisy(pictures, low, high):
    return np.clip(
        pictures + np.random.default_rng(0).integers(low, high + 1, pictures.shape), 0, 255
    )


def one(level, low=0, high=0, count=12):
    def change(pictures):
        flat = noisy(np.full(pictures.shape, level), low, high)
        return np.concatenate([flat[:count], pictures[count:]])

    return change


def stuck(first, last, low=0, high=0):
    def change(pictures):
        pictures = pictures.astype(int)
        pictures[first:last] = pictures[first]
        return noisy(pictures, low, high)

    return change


def through_jpeg(pictures):
    """As a codec does, with another error in every picture."""
    return np.stack([
        cv2.imdecode(cv2.imencode(".jpg", p, [cv2.IMWRITE_JPEG_QUALITY, 75 + i])[1], -1)
        for i, p in enumerate(pictures)
    ])  # fmt: skip


GOOD = "72 looked at; none is blank, no film stands still"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (one(0), "pictures are black"),
        (one(0, 0, 4), "pictures are black"),
        (one(2, count=1), "pictures are black"),
        (one(90), "pictures are of one colour"),
        (one(90, -1, 1), "pictures are of one colour"),
        (one(90, -6, 6), "pictures are of one colour"),
        (one(90, count=2), GOOD),
        (stuck(0, 12), "pictures are all the same"),
        (stuck(0, 12, -1, 1), "pictures are all the same"),
        (stuck(1, 12), "pictures are all the same"),
        (lambda film: through_jpeg(np.uint8(stuck(0, 12)(film))), "pictures are all the same"),
        (through_jpeg, GOOD),
        (lambda pictures: noisy(pictures, -2, 2), GOOD),
    ],
)  # fmt: skip
def test_films_that_show_nothing_or_stand_still(change, said):
    assert judged(change) == [said]


def test_a_film_that_stands_still_is_found_though_nobody_says_where_the_grip_is():
    unnamed = ("a", "b", "c", "d", "e")
    assert judged(stuck(0, 12), state_names=unnamed) == ["pictures are all the same"]
    assert judged(stuck(0, 0), state_names=unnamed) == [GOOD]


def of_front(paths, states):
    """What is said of films of a hand that goes along paths, where nobody says what states are."""
    camera, data = calibrations()["front"], filmed(len(paths), len(paths[0]), views=("front",))
    episodes = [
        replace(one, state=np.float32(state), sights={"front": sight(pictures, camera)})
        for one, state, path in zip(data.episodes, states, paths, strict=True)
        for pictures in [film("front", camera, path)]
    ]
    names = tuple(f"number {i}" for i in range(states[0].shape[1]))
    data = replace(data, episodes=episodes, state_names=names)
    findings = check_recorded(data).findings
    return [f.got for mark in ("bad", "good") for f in about(findings, "pictures", mark)]


def joints(first, last, steps=40):
    """Of an arm that goes from one step to another; and where its hand is (m)."""
    along = np.clip((np.arange(steps) - first) / (last - first), 0, 1)[:, None]
    return along * np.linspace(-1, 1.2, 7), AIM + along * [0.1, 0.1, 0]


STILL = "32 looked at; none is blank, no film stands still"


def test_a_robot_may_wait_whatever_noise_its_state_has():
    random = np.random.default_rng(0)
    state, path = joints(first=32, last=39)
    noisy = [np.hstack([state * (1 + e), random.normal(0, 3, (40, 6)),
                        random.normal(0, 1e-4, (40, 1))]) for e in range(2)]  # fmt: skip
    assert of_front([path, path], noisy) == [STILL]


def test_one_arm_of_two_may_wait():
    state, path = joints(first=0, last=39)
    states = [np.hstack([state, state]), np.hstack([state * 2, state * 0])]
    stands = np.tile(path[0], (40, 1))
    assert of_front([path, stands], states) == [STILL]
    states[1] = np.hstack([state * 2, state])
    assert of_front([path, stands], states) == ["pictures are all the same"]


def test_a_broken_number_does_not_hide_that_a_film_stands_still():
    state, path = joints(first=0, last=39)
    leaps = state.copy()
    leaps[5] = 1e4
    stands = np.tile(path[0], (40, 1))
    assert of_front([path, stands], [leaps * 2, state]) == ["pictures are all the same"]


def test_without_a_state_that_changes_nothing_is_said_of_films_that_stand_still():
    still = with_pictures(filmed(2, 12), lambda i, view, pictures: pictures)
    episodes = [replace(e, state=np.ones_like(e.state)) for e in still.episodes]
    unnamed = replace(still, episodes=episodes, state_names=("a", "b", "c", "d", "e"))
    (good,) = about(check_recorded(unnamed).findings, "pictures", "good")
    assert good.got == "72 looked at; none is blank; whether films stand still is not known"
