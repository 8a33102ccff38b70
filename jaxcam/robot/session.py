"""What the server knows of one client: what it asked before, and how far its episode is."""

from collections import deque
from typing import Any

import numpy as np

from jaxcam.errors import PortError, closest
from jaxcam.robot.asked import Question, observation_of
from jaxcam.robot.averaging import Averaging
from jaxcam.robot.requests import RequestReader, Shown

CONTROL = "__ctrl__"
CONTROLS = ("episode_start", "episode_end")
"""What a client may tell of its episodes; either forgets what came before."""


class Session:
    """One client's requests, from its connection or the start of an episode on.

    Args:
        reader: Of requests.
        steps: Observations that the policy sees at once.
        row: Of the batch, where a request names none.
        averaging: For the client's actions; None is none.
    """

    def __init__(
        self,
        reader: RequestReader,
        steps: int = 1,
        row: int = 0,
        averaging: Averaging | None = None,
    ) -> None:
        self._reader, self._steps, self._row = reader, steps, row
        self._averaging = averaging
        self._moments: deque[Shown] = deque(maxlen=steps)
        self._call = 0

    def control(self, message: Any) -> str | None:
        """Obeys a message that is no observation; what it was, or None if it is one.

        Raises:
            PortError: There is no such word.
        """
        if not isinstance(message, dict) or CONTROL not in message:
            return None
        word = message[CONTROL]
        if not isinstance(word, str) or word not in CONTROLS:
            raise PortError(f"Unknown {CONTROL} {word!r:.80}{closest(str(word)[:80], CONTROLS)}.")
        self._moments.clear()
        self._call = 0
        if self._averaging:
            self._averaging.restart()
        return word

    def ask(self, message: Any) -> Question:
        """What a message asks of the policy; a bad one changes nothing.

        Raises:
            JaxcamError: It is no good request.
        """
        request = self._reader.read(message)
        moments = request.moments
        if len(moments) < self._steps and not self._moments:
            moments = moments * self._steps  # before the start they are the first one
        self._moments.extend(moments)
        call = self._call if request.call is None else request.call
        self._call = call + 1
        return Question(
            observation_of(list(self._moments)),
            call,
            self._row if request.row is None else request.row,
        )

    def actions(self, chunk: np.ndarray) -> np.ndarray:
        """What the client gets for a chunk [T, A].

        Raises:
            PortError: The policy gave what is no number.
        """
        if not np.isfinite(chunk).all():
            raise PortError(
                "The policy gave actions that are no numbers. Its training has diverged, or it "
                "has never seen anything like this observation."
            )
        return self._averaging(chunk) if self._averaging else chunk
