"""A foreign policy as rollouts ask it: each episode that goes on, one by one or several at once.

What is wrong with an answer is a failure of that episode alone, and is kept in words.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from jaxcam.config.foreign import MOST_STEPS
from jaxcam.console.words import plain_line
from jaxcam.errors import PortError
from jaxcam.evaluation.mapping import Names, observation_sent, sent
from jaxcam.evaluation.sources import FailedError, PolicyFunction, PolicySource, Talk, answered
from jaxcam.sim.actions import BEYOND

_LONGEST = 300
"""Letters of a cause that are kept."""


@dataclass
class Asking:
    """The policy of one batch of rollouts; a `jaxcam.sim.rollout.PolicyCall`.

    Args:
        source: Where it is.
        names: What it is sent.
        prompt: What it is told to do.
        answer: Its name for the actions.
        size: Numbers of an action.
        execute: Steps of a chunk that are executed; as many as its first one has when None.
    """

    source: PolicySource
    names: Names
    prompt: str
    answer: str
    size: int
    execute: int | None
    causes: dict[int, str] = field(default_factory=dict[int, str])
    """Why episodes got no actions."""
    _talks: dict[int, Talk] = field(default_factory=dict[int, Talk])
    _pool: ThreadPoolExecutor | None = None

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Keeps what it needs; connections are ended afterwards."""
        with ExitStack() as stack:
            if self.source.at_once > 1:
                self._pool = ThreadPoolExecutor(self.source.at_once)
                stack.callback(self._pool.shutdown, cancel_futures=True)
            try:
                yield
            finally:
                for episode in list(self._talks):
                    self._talks.pop(episode).close()

    def __call__(self, obs: Mapping[str, np.ndarray], call: int, active: np.ndarray) -> np.ndarray:
        """Chunks float32 [B, T, A]; no numbers for episodes that got none.

        Raises:
            NoServerError: The server is gone.
            PortError: The policy refuses the first observation of each episode.
        """
        asked = np.flatnonzero(active).tolist()
        questions = [
            sent(self.names, observation_sent(obs, int(call), i, self.prompt)) for i in asked
        ]
        answers = self._answers(asked, questions)
        self._check_not_all_refused(call, answers)
        chunks = dict(zip(asked, map(self._chunk, answers), strict=True))
        if self.execute is None:
            lengths = [len(c) for c in chunks.values() if isinstance(c, np.ndarray)]
            self.execute = min(lengths[0], MOST_STEPS) if lengths else None
        steps = self.execute or 1
        actions = np.full((len(active), steps, self.size), np.nan, np.float32)
        for episode, chunk in chunks.items():
            if isinstance(chunk, np.ndarray) and len(chunk) < steps:
                chunk = f"actions have {len(chunk)} steps, and {steps} are to be executed"
            if isinstance(chunk, np.ndarray):
                actions[episode] = chunk[:steps]
            else:
                self._failed(episode, chunk)
        return actions

    def _answers(
        self, asked: Sequence[int], questions: Sequence[Mapping[str, Any]]
    ) -> list[Any | FailedError]:
        """What is answered to each, or why nothing is."""
        batched = self.source.batched if isinstance(self.source, PolicyFunction) else None
        if batched:
            try:
                answers = answered(lambda several: list(batched(several)), questions)
            except FailedError as error:
                return [error] * len(asked)
            wrong = FailedError(f"{len(answers)} answers to {len(asked)} observations")
            return answers if len(answers) == len(asked) else [wrong] * len(asked)
        pairs = list(zip(asked, questions, strict=True))
        if self._pool:
            return list(self._pool.map(self._ask, pairs))
        return [self._ask(pair) for pair in pairs]

    def _ask(self, pair: tuple[int, Mapping[str, Any]]) -> Any | FailedError:
        episode, question = pair
        try:
            if episode not in self._talks:
                self._talks[episode] = self.source.talk(self.answer)
            return self._talks[episode].ask(question)
        except FailedError as error:
            return error

    def _check_not_all_refused(self, call: int, answers: Sequence[Any]) -> None:
        refused = [a for a in answers if isinstance(a, FailedError) and a.refused]
        if call == 0 and answers and len(refused) == len(answers):
            raise PortError(
                "The policy refuses the first observation of each rollout, so something is wrong "
                f"with what it is sent, and nothing was written. {_brief(str(refused[0]))} It was "
                f"sent {', '.join(self.names)}; --obs MAP.yaml renames."
            )

    def _chunk(self, answer: Any) -> np.ndarray | str:
        """The actions of an answer, float32 [T, A], or what is wrong with it."""
        if isinstance(answer, FailedError):
            return str(answer)
        if isinstance(answer, Mapping):
            content = cast("Mapping[str, Any]", answer)
            if self.answer not in content:
                return f"an answer without {self.answer}: {sorted(map(str, content))}"
            answer = content[self.answer]
        expected = f"expected numbers [T, {self.size}]"
        try:
            given = np.asarray(answer)
            if given.dtype.kind not in "fiub":  # text and complex numbers would be converted
                kind = given.dtype if isinstance(answer, np.ndarray) else type(answer).__name__
                return f"actions are {kind}, {expected}"
            with np.errstate(over="ignore", invalid="ignore"):
                chunk = given.astype(np.float32)
        except Exception:  # whatever theirs does where it cannot become an array
            return f"actions are {type(answer).__name__}, {expected}"
        if chunk.ndim != 2 or chunk.shape[1] != self.size or not len(chunk):
            return f"actions have the shape {list(chunk.shape)}, expected [T, {self.size}]"
        good = np.abs(chunk) < BEYOND  # False for what is no number, too
        if not good.all():
            step, number = np.argwhere(~good)[0].tolist()
            return f"actions have {chunk[step, number]} at step {step}, number {number}"
        return chunk

    def _failed(self, episode: int, words: str) -> None:
        self.causes[episode] = _brief(words)
        if episode in self._talks:
            self._talks.pop(episode).close()


def _brief(words: str) -> str:
    """Words as one line; of a traceback its last, which says what happened."""
    before, is_traceback, trace = words.partition("Traceback (most recent call last)")
    if is_traceback:
        words = before + next(line for line in reversed(trace.splitlines()) if line.strip())
    return plain_line(words[:_LONGEST])
