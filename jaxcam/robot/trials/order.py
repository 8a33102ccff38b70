"""Who is tried when, from where, through which cameras, and under which letter; by a seed alone.

All policies meet the same conditions: a placement of the cameras, those of them that are used, and
a start. Cameras are heavy to move and objects easy, so all rollouts of a placement come together,
and in it those of a condition, one after the other. Who is first takes turns: in every block of as
many conditions as there are policies each is first once, second once, and so on. So wherever a
trial stops, no policy has had more conditions than another by more than one, nor the better places.
"""

import itertools
import string
import zlib
from dataclasses import dataclass

import numpy as np

from jaxcam.robot.trials.sheet import Sheet


@dataclass(frozen=True)
class Condition:
    """What every policy meets.

    Attributes:
        number: From 0, in the order in which conditions come.
        placement: Where the cameras stand; empty if they never move.
        cameras: Those that are used, in the sheet's order; none if the sheet has none.
        start: Number of the start, from 0.
    """

    number: int
    placement: str
    cameras: tuple[str, ...]
    start: int


@dataclass(frozen=True)
class Rollout:
    """One policy under one condition.

    Attributes:
        number: From 1, in the order of the trial.
        condition: What it meets.
        policy: Number of the policy in the sheet, from 0.
        letter: What the operator calls it.
    """

    number: int
    condition: Condition
    policy: int
    letter: str


def letters(sheet: Sheet) -> tuple[str, ...]:
    """The letter of each policy, in the sheet's order.

    The names count beside the seed, so that who always takes the same seed does not learn where in
    the sheet "A" stands.
    """
    names = zlib.crc32("\n".join(policy.name for policy in sheet.policies).encode())
    order = np.random.default_rng([sheet.seed, names]).permutation(len(sheet.policies))
    return tuple(string.ascii_uppercase[i] for i in order)


def conditions(sheet: Sheet) -> list[Condition]:
    """What every policy meets, in order.

    Each placement is combined with each choice of cameras, `repeats` times, and each combination
    has one start; starts take turns. Where nothing but the start varies, each start is repeated.
    """
    rng = np.random.default_rng([sheet.seed, 0])
    chosen: list[tuple[str, ...]] = [()]
    if sheet.cameras:
        chosen = list(itertools.combinations(sheet.cameras.names, sheet.used))
    places = list(sheet.placements)
    rng.shuffle(places)
    if len(chosen) * len(places) == 1:
        chosen = chosen * len(sheet.starts)
    seen_through = []
    for place in places:
        block = [(place, cameras) for cameras in chosen * sheet.repeats]
        rng.shuffle(block)
        seen_through += block
    turns = -(-len(seen_through) // len(sheet.starts))
    starts = [int(i) for _ in range(turns) for i in rng.permutation(len(sheet.starts))]
    return [
        Condition(number, str(place), tuple(map(str, cameras)), start)
        for number, ((place, cameras), start) in enumerate(zip(seen_through, starts, strict=False))
    ]


def rollouts(sheet: Sheet) -> list[Rollout]:
    """All rollouts of a sheet, in order."""
    count, names = len(sheet.policies), letters(sheet)
    rng = np.random.default_rng([sheet.seed, 1])
    planned: list[Rollout] = []
    turns: list[list[int]] = []
    for condition in conditions(sheet):
        if not turns:  # a square in whose rows and columns each policy stands once
            some = rng.permutation(count)
            turns = [[int(some[(i + j) % count]) for j in range(count)] for i in range(count)]
            rng.shuffle(turns)
        for policy in turns.pop():
            planned.append(Rollout(len(planned) + 1, condition, policy, names[policy]))
    return planned
