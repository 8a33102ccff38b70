"""One address for somebody's own loop, behind which the policies take turns, without their names.

A loop connects before each rollout. Its connection is accepted at once and greeted, as openpi's
clients wait for, when the operator begins the rollout; so that is what starts the robot. When the
rollout is over, questions are answered with that, which ends the loop's rollout. It sends all
cameras under the names of the sheet, and the relay takes those that are used.
"""

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.protocol import State
from websockets.sync.server import ServerConnection, serve

from jaxcam.client import MOST_BYTES, Client, from_wire, to_wire
from jaxcam.errors import ConfigError, JaxcamError
from jaxcam.robot.trials.attempts import Attempt, Ran

SHOWN = (
    "task", "image_size", "state_names", "action_names", "action_space", "rotations", "rate",
    "chunk", "execute", "observation_steps", "conventions",
)  # fmt: skip
"""What of a server's metadata the loop is told: nothing by which the policy could be known."""
OVER = "The rollout is over. Connect anew for the next one."
_STEP = 0.05


class Relay:
    """Listens on the loopback and passes questions on to whose turn it is. A `Runner`.

    Args:
        port: To listen at; 0 is any that is free.

    Raises:
        ConfigError: Something listens there already.
    """

    def __init__(self, port: int) -> None:
        self._attempt: Attempt | None = None
        self._changed = threading.Condition()
        self._first: float | None = None
        self._fault, self._answers, self._is_gone = "", 0, False
        self._loops: set[ServerConnection] = set()
        self._is_closed = False
        try:
            self._server = serve(
                self._serve,
                "127.0.0.1",
                port,
                compression=None,
                max_size=MOST_BYTES,
                origins=[None],  # a page in a browser has no business here
            )
        except OSError as error:
            raise ConfigError(
                f"Cannot listen at port {port}: {error.strerror}. Likely cause: another trial or "
                "server is there. Set 'listen' in the sheet to another one."
            ) from error
        self.url = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        """Where loops connect."""
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def run(self, attempt: Attempt, is_over: Callable[[], bool]) -> Ran:
        """Let loops ask for one rollout, see `Runner`; its time begins with the first question.

        Where no loop can be connected to the policy it is over: nothing would come any more.
        """
        with self._changed:
            self._attempt, self._first, self._fault, self._answers = attempt, None, "", 0
            self._is_gone = False
            self._changed.notify_all()
        try:
            while not (is_over() or self._has_run(attempt.seconds) or self._is_gone):
                time.sleep(_STEP)
        finally:
            with self._changed:
                self._attempt = None
        taken = time.monotonic() - self._first if self._first is not None else 0.0
        fault = self._fault or ("" if self._answers else "no loop asked for actions")
        return Ran(taken, fault, f"{self._answers} answers")

    def close(self) -> None:
        """Listen no more, and let loops go that wait, also those that are just being let in."""
        self._server.shutdown()
        with self._changed:
            self._is_closed = True
            loops = [*self._loops]
        for connection in loops:
            connection.close()
        self._thread.join(5)

    def _has_run(self, seconds: float) -> bool:
        return self._first is not None and time.monotonic() - self._first > seconds

    def _serve(self, connection: ServerConnection) -> None:
        """One connection of a loop."""
        with self._changed:
            if self._is_closed:
                return
            self._loops.add(connection)
        try:
            self._talk(connection)
        finally:
            with self._changed:
                self._loops.discard(connection)

    def _talk(self, connection: ServerConnection) -> None:
        """Wait for a rollout with a loop, and pass its questions on."""
        with self._changed:
            while self._attempt is None:
                self._changed.wait(_STEP)
                if connection.state is not State.OPEN:
                    return
            attempt = self._attempt
        with contextlib.suppress(ConnectionClosed):
            try:
                with attempt.served.connect() as client:
                    client.reset()
                    connection.send(to_wire(_shown(attempt)))
                    for message in connection:
                        connection.send(self._answer(attempt, client, message))
            except JaxcamError as error:
                fault = attempt.blinded(error)
                if attempt is self._attempt:
                    self._fault, self._is_gone = fault, True
                connection.send(fault)

    def _answer(self, attempt: Attempt, client: Client, message: str | bytes) -> str | bytes:
        if attempt is not self._attempt:
            return OVER
        self._first = self._first or time.monotonic()
        try:
            content = from_wire(message) if isinstance(message, bytes) else None
            if not isinstance(content, dict):
                return "Expected an observation: names to arrays, as msgpack."
            if (control := content.get("__ctrl__")) is not None:
                if control == "episode_start":
                    client.reset()
                return to_wire({"__ack__": control})
            answer = attempt.answer(client, content)
        except JaxcamError as error:
            self._fault = attempt.blinded(error)
            return self._fault
        self._answers += 1
        self._fault = ""  # the loop knew better after all
        return to_wire(answer)


def _shown(attempt: Attempt) -> dict[str, Any]:
    """What a loop is told of the policy, with the robot's names of cameras."""
    metadata = attempt.served.metadata
    shown = {name: metadata[name] for name in SHOWN if name in metadata}
    shown |= {"views": [*attempt.sight.cameras] or [*attempt.served.views]}
    if attempt.served.execute:
        shown["execute"] = attempt.served.execute
    return shown | {
        "server": "jaxcam.trial",
        "policy": attempt.rollout.letter,
        "rollout": attempt.rollout.number,
        "controls": ["episode_start", "episode_end"],
    }
