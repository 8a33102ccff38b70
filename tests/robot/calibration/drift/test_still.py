"""Which episodes are held against which."""

import numpy as np
import pytest

from jaxcam.robot.calibration.drift.still import FLOOR, doubt, limit_of
from jaxcam.robot.calibration.drift.still import still_episodes as still_by

SIGMA = np.repeat([0.004, 0.006], 3)
BUMP = np.r_[0.01, 0, 0, 0, 0, 0.012]


def still_episodes(changes, spreads):
    return still_by(changes, spreads, limit_of(spreads))


def drawn(rng, offsets, sigma=SIGMA):
    return np.stack(offsets) + rng.normal(0, 1, (len(offsets), 6)) * sigma


def told(changes, sigma=SIGMA):
    return np.repeat((np.diag(sigma**2) + FLOOR)[None], len(changes), 0)


def test_what_one_episode_cannot_tell_a_run_of_them_can():
    """A bump of six standard deviations, five episodes of twelve; hardly ever a false one."""
    hits, false = 0, 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        changes = drawn(rng, [2 * BUMP if e >= 7 else 0 * BUMP for e in range(12)])
        still = still_episodes(changes, told(changes))
        hits += bool((~still[7:]).sum() >= 4)
        quiet = still_episodes(drawn(rng, [0 * BUMP] * 12), told(changes))
        false += (~still[:6]).sum() + (~quiet).sum()
    assert hits >= 45
    assert false <= 0.003 * 50 * 18


@pytest.mark.parametrize("moved", [range(5, 20), range(4), range(8, 12)])
def test_the_given_poses_say_which_side_moved(moved):
    offsets = [4 * BUMP if e in moved else 0 * BUMP for e in range(20)]
    changes = drawn(np.random.default_rng(0), offsets)
    assert np.flatnonzero(~still_episodes(changes, told(changes))).tolist() == list(moved)


def test_a_small_push_early_on_is_told_from_the_fault_of_joints():
    """What most ask for is a push where others ask for nothing, and a fault where all have it."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        way, fault = rng.normal(size=(2, 6)) * np.repeat([0.008, 0.012], 3)
        late = np.arange(20) >= 7
        pushed = drawn(rng, late[:, None] * way, SIGMA / 4)
        still = still_episodes(pushed, told(pushed, SIGMA / 4))
        assert np.flatnonzero(~still).tolist() == list(range(7, 20))
        early = drawn(rng, fault + ~late[:, None] * way, SIGMA / 4)
        still = still_episodes(early, told(early, SIGMA / 4))
        assert np.flatnonzero(~still).tolist() == list(range(7))


def test_two_moves_are_both_found():
    offsets = [5 * BUMP * ((e >= 4) - 2.0 * (e >= 9)) for e in range(14)]
    changes = drawn(np.random.default_rng(0), offsets)
    assert np.flatnonzero(still_episodes(changes, told(changes))).tolist() == [0, 1, 2, 3]


def test_covariances_that_are_too_small_are_noticed_whatever_moved():
    rng = np.random.default_rng(0)
    offsets = [10 * BUMP if e >= 5 else 0 * BUMP for e in range(20)]
    changes = drawn(rng, offsets, 3 * SIGMA)
    small = np.repeat(np.diag(SIGMA**2)[None], 20, 0)
    factor = doubt(changes, small)
    assert 5 < factor < 20
    assert np.flatnonzero(~still_episodes(changes, small * factor)).tolist() == list(range(5, 20))
    assert doubt(drawn(rng, offsets), told(offsets)) < 1.6


def test_pictures_that_tell_little_must_tell_it_twice_as_clearly():
    """Small pictures ask for centimetres in directions that they only seem to tell well."""
    for share, stood in ((1.0, False), (5.0, True)):  # of what neighbours differ by on films
        sigma = share * np.repeat([0.003, 0.004], 3)
        changes = drawn(np.random.default_rng(0), [0 * BUMP] * 16, sigma)
        changes[6] += np.r_[8 * sigma[0], 0, 0, 0, 0, 0]
        assert still_episodes(changes, told(changes, sigma))[6] == stood


def test_one_episode_and_two():
    assert still_episodes(np.zeros((1, 6)), told([0])).tolist() == [True]
    changes = np.stack([0 * BUMP, 5 * BUMP])
    assert still_episodes(changes, told(changes)).tolist() == [True, False]


def test_few_neighbours_do_not_tell_how_much_is_chance():
    """Seven differences said anything from 3 to 22 on films in which 7 was usual."""
    rng = np.random.default_rng(0)
    spread = np.diag([0.002**2] * 3 + [0.001**2] * 3)
    for episodes, low, high in ((2, 7, 7), (8, 2.5, 13), (200, 3.5, 5.5)):
        spreads = np.repeat(spread[None], episodes, 0)
        doubts = [doubt(2 * rng.multivariate_normal(np.zeros(6), spread, episodes), spreads)
                for _ in range(50)]  # fmt: skip
        assert low * 0.999 <= min(doubts)
        assert max(doubts) <= high * 1.001
