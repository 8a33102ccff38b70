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
from jaxcam.errors import ConfigError, PortError
from jaxcam.robot.trials.turns import Ran, Turn

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
        self._turn: Turn | None = None
        self._changed = threading.Condition()
        self._first: float | None = None
        self._fault, self._answers = "", 0
        try:
            self._server = serve(
                self._serve, "127.0.0.1", port, compression=None, max_size=MOST_BYTES
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

    def run(self, turn: Turn, is_over: Callable[[], bool]) -> Ran:
        """Let loops ask for one rollout, see `Runner`; its time begins with the first question."""
        with self._changed:
            self._turn, self._first, self._fault, self._answers = turn, None, "", 0
            self._changed.notify_all()
        try:
            while not is_over() and not self._has_run(turn.seconds):
                time.sleep(_STEP)
        finally:
            with self._changed:
                self._turn = None
        taken = time.monotonic() - self._first if self._first is not None else 0.0
        fault = self._fault or ("" if self._answers else "no loop asked for actions")
        return Ran(taken, fault, f"{self._answers} answers")

    def close(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._thread.join(5)

    def _has_run(self, seconds: float) -> bool:
        return self._first is not None and time.monotonic() - self._first > seconds

    def _serve(self, connection: ServerConnection) -> None:
        """One connection of a loop: it waits for a rollout, and lasts for it."""
        with self._changed:
            while self._turn is None:
                self._changed.wait(_STEP)
                if connection.state is not State.OPEN:
                    return
            turn = self._turn
        with contextlib.suppress(ConnectionClosed):
            try:
                with turn.served.connect() as client:
                    client.reset()
                    connection.send(to_wire(_shown(turn)))
                    for message in connection:
                        connection.send(self._answer(turn, client, message))
            except (PortError, ConfigError) as error:
                self._fault = turn.blinded(error)
                connection.send(self._fault)

    def _answer(self, turn: Turn, client: Client, message: str | bytes) -> str | bytes:
        if turn is not self._turn:
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
            answer = turn.answer(client, content)
        except PortError as error:
            self._fault = turn.blinded(error)
            return self._fault
        self._answers += 1
        self._fault = ""  # the loop knew better after all
        return to_wire(answer)


def _shown(turn: Turn) -> dict[str, Any]:
    """What a loop is told of the policy, with the robot's names of cameras."""
    metadata = turn.served.metadata
    shown = {name: metadata[name] for name in SHOWN if name in metadata}
    shown |= {"views": [*turn.sight.cameras] or [*turn.served.views]}
    if turn.served.execute:
        shown["execute"] = turn.served.execute
    return shown | {
        "server": "jaxcam.trial",
        "policy": turn.rollout.letter,
        "rollout": turn.rollout.number,
        "controls": ["episode_start", "episode_end"],
    }
