"""Requests that arrive together are computed together, and in order."""

import asyncio
import threading

import numpy as np
import pytest

from jaxcam.robot.asked import Question
from jaxcam.robot.batching import Batcher


class Policy:
    """Stands for a policy: gives the number of the call, and notes what it was asked at once."""

    def __init__(self, width=3):
        self.width, self.batches = width, []
        self.go = threading.Event()
        self.go.set()

    def together(self, asked):
        return [i for i, one in enumerate(asked) if one.row == asked[0].row][: self.width]

    def chunks(self, asked):
        self.go.wait(5)
        self.batches.append([one.call for one in asked])
        if any(one.call == 13 for one in asked):
            raise RuntimeError("unlucky")
        return [np.full((1, 1), one.call) for one in asked]


def ask(policy, asked, clients=8, before=lambda tasks: None):
    """Asks all at once; what each gets."""

    async def run():
        batcher = Batcher(policy, lambda: clients)  # pyright: ignore
        serving = asyncio.create_task(batcher.run())
        tasks = [asyncio.create_task(batcher.answer(one)) for one in asked]
        await asyncio.sleep(0.05)
        before(tasks)
        answers = await asyncio.gather(*tasks, return_exceptions=True)
        serving.cancel()
        return answers

    return asyncio.run(run())


def calls(*numbers, row=0):
    return [Question({}, number, row) for number in numbers]


def test_what_arrives_together_is_computed_together():
    policy = Policy()
    answers = ask(policy, calls(1, 2, 3, 4, 5))
    assert [int(answer.chunk[0, 0]) for answer in answers] == [1, 2, 3, 4, 5]
    assert policy.batches == [[1, 2, 3], [4, 5]]
    assert all(answer.seconds >= 0 for answer in answers)


def test_what_cannot_be_computed_together_is_computed_in_order():
    policy = Policy()
    ask(policy, [*calls(1), *calls(2, row=1), *calls(3), *calls(4, row=1)])
    assert policy.batches == [[1, 3], [2, 4]]


def test_nobody_waits_for_more_clients_than_there_are():
    policy = Policy(width=50)
    assert len(ask(policy, calls(1), clients=1)) == 1
    assert policy.batches == [[1]]


def test_an_error_is_told_to_those_who_asked_and_the_next_are_answered():
    policy = Policy(width=1)
    first, second, third = ask(policy, calls(1, 13, 3))
    assert (int(first.chunk[0, 0]), int(third.chunk[0, 0])) == (1, 3)
    with pytest.raises(RuntimeError, match="unlucky"):
        raise second


def test_what_a_client_that_is_gone_asked_is_not_computed():
    policy = Policy(width=1)
    policy.go.clear()

    def leave(tasks):
        tasks[1].cancel()
        policy.go.set()

    ask(policy, calls(1, 2, 3), before=leave)
    assert policy.batches == [[1], [3]]
