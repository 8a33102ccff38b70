"""Who is tried when: balanced, paired, and the same for a seed."""

from collections import Counter
from itertools import combinations, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxcam.robot.trials.order import conditions, letters, rollouts
from jaxcam.robot.trials.sheet import CamerasEntry, PolicyEntry, Sheet

PLACES = tuple("1234567")


def sheet(policies=2, places=PLACES, starts=4, seed=0, **changes):
    entries = tuple(PolicyEntry(f"p{i}", f"ws://x:{i}") for i in range(policies))
    cameras = CamerasEntry(("a", "b", "c"), 2, "cameras.json", places)
    values = {"cameras": cameras} | changes
    names = tuple(f"start {i}" for i in range(starts))
    return Sheet("t", "s", "h", entries, names, seed=seed, **values)


def test_twenty_one_rollouts_a_policy_as_in_the_paper():
    planned = rollouts(sheet())
    assert [rollout.number for rollout in planned] == list(range(1, 43))
    pairs = [*combinations("abc", 2)]
    for policy in (0, 1):
        met = [r.condition for r in planned if r.policy == policy]
        assert Counter((c.placement, c.cameras) for c in met) == Counter(
            (place, pair) for place in PLACES for pair in pairs
        )
        assert max(Counter(c.start for c in met).values()) == 6  # 21 rollouts, four starts
        assert min(Counter(c.start for c in met).values()) == 5


SHEETS = st.builds(
    sheet,
    policies=st.integers(1, 5),
    places=st.sampled_from([(), ("x",), PLACES]),
    starts=st.integers(1, 6),
    repeats=st.integers(1, 2),
    seed=st.integers(0, 2**32 - 1),
)


@given(SHEETS)
@settings(max_examples=40, deadline=None)
def test_all_policies_meet_the_same_conditions_one_after_the_other(some):
    planned, count = rollouts(some), len(some.policies)
    for i in range(0, len(planned), count):
        assert len({r.condition for r in planned[i : i + count]}) == 1
        assert {r.policy for r in planned[i : i + count]} == set(range(count))
    places = [r.condition.placement for r in planned]
    moves = 1 + sum(a != b for a, b in pairwise(places))
    assert moves == len(some.placements)  # cameras are heavy


@given(SHEETS)
@settings(max_examples=40, deadline=None)
def test_wherever_it_stops_nobody_was_first_more_often(some):
    planned, count = rollouts(some), len(some.policies)
    for stop in range(1, len(planned) // count + 1):
        for place in range(count):
            at = Counter(planned[i * count + place].policy for i in range(stop))
            each = [at[policy] for policy in range(count)]
            assert max(each) - min(each) <= 1


def test_where_only_the_start_varies_each_start_is_repeated():
    met = conditions(sheet(cameras=None, repeats=3))
    assert Counter(c.start for c in met) == Counter(dict.fromkeys(range(4), 3))
    assert {(c.placement, c.cameras) for c in met} == {("", ())}


def test_a_seed_gives_one_order_and_another_seed_another():
    assert rollouts(sheet(seed=3)) == rollouts(sheet(seed=3))
    assert conditions(sheet(seed=3)) != conditions(sheet(seed=4))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_letters_do_not_tell_where_in_the_sheet_a_policy_stands(count):
    each = {letters(sheet(count, seed=seed)) for seed in range(40)}
    assert {frozenset(some) for some in each} == {frozenset("ABCDE"[:count])}
    assert len(each) > 1 or count == 1
    # nor does the seed that somebody always takes
    names = [
        Sheet("t", "s", "h", tuple(PolicyEntry(f"{word}{i}", "ws://x") for i in (1, 2)), ("a",))
        for word in "abcdefgh"
    ]
    assert len({letters(some) for some in names}) == 2
