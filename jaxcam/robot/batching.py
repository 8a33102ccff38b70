"""Requests of many clients, computed together as they arrive."""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from jaxcam.robot.asked import AskedPolicy, Question

PATIENCE = 0.005
"""Seconds that the first of a batch waits for the next one."""


@dataclass(frozen=True)
class Answer:
    """A chunk, and how long it took."""

    chunk: np.ndarray
    seconds: float
    """That the policy computed, for all that was asked together with it."""


@dataclass(frozen=True)
class _Waiting:
    asked: Question
    answer: asyncio.Future[Answer]


class Batcher:
    """Asks a policy for all that has arrived, in the order of arrival.

    Args:
        policy: The policy; it is asked in a thread of its own.
        clients: Tells how many clients there are: nobody waits for more than those.
    """

    def __init__(self, policy: AskedPolicy, clients: Callable[[], int]) -> None:
        self._policy, self._clients = policy, clients
        self._arrived: asyncio.Queue[_Waiting] = asyncio.Queue()
        self._thread = ThreadPoolExecutor(1, "policy")

    async def answer(self, asked: Question) -> Answer:
        """The policy's answer; what it raises is raised here."""
        waiting = _Waiting(asked, asyncio.get_running_loop().create_future())
        self._arrived.put_nowait(waiting)
        return await waiting.answer

    async def run(self) -> None:
        """Answers until it is cancelled."""
        waiting: list[_Waiting] = []
        while True:
            waiting = [w for w in waiting if not w.answer.done()]  # whose client has gone
            if not waiting:
                waiting.append(await self._arrived.get())
            await self._gather(waiting)
            chosen = self._policy.together([w.asked for w in waiting])
            batch = [waiting[i] for i in chosen]
            waiting = [w for i, w in enumerate(waiting) if i not in set(chosen)]
            await self._compute(batch)

    async def _gather(self, waiting: list[_Waiting]) -> None:
        """Adds what has arrived, and what does in a moment, where there is room for it."""
        while True:
            while not self._arrived.empty():
                waiting.append(self._arrived.get_nowait())
            if len(waiting) >= min(self._policy.width, self._clients()):
                return
            try:
                async with asyncio.timeout(PATIENCE):
                    waiting.append(await self._arrived.get())
            except TimeoutError:
                return

    async def _compute(self, batch: list[_Waiting]) -> None:
        asked, began = [w.asked for w in batch], time.perf_counter()
        loop = asyncio.get_running_loop()
        try:
            chunks = await loop.run_in_executor(self._thread, self._policy.chunks, asked)
        except Exception as error:  # whatever it is, the server goes on
            for waiting in batch:
                if not waiting.answer.done():
                    waiting.answer.set_exception(error)
            return
        seconds = time.perf_counter() - began
        for waiting, chunk in zip(batch, chunks, strict=True):
            if not waiting.answer.done():
                waiting.answer.set_result(Answer(chunk, seconds))
