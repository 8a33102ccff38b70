"""The policy server: openpi's protocol on a WebSocket, for several clients.

It trusts nobody: messages are data and bounded, pages in a browser are refused, and whatever a
client sends, it is answered with what is wrong and the server goes on.
"""

import asyncio
import hmac
import http
import logging
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as Handshake
from websockets.http11 import Response

from jaxcam.client import from_wire, to_wire
from jaxcam.console.words import plain_line
from jaxcam.errors import JaxcamError, PortError
from jaxcam.robot.asked import AskedPolicy
from jaxcam.robot.batching import Batcher
from jaxcam.robot.session import Session

SLOW = 10.0
"""Seconds in which a client has to say what it wants, and to take an answer."""
_log = logging.getLogger(__name__)
_QUIET = logging.getLogger("jaxcam.websockets")
_QUIET.setLevel(logging.CRITICAL)  # what is no handshake is its sender's trouble


@dataclass(frozen=True)
class Limits:
    """How much clients may ask for."""

    clients: int = 64
    """At once."""
    largest: int = 32 * 2**20
    """Bytes of a message."""
    per_second: int = 500
    """Requests of each."""


@dataclass(frozen=True)
class Desk:
    """What the server tells and asks.

    Attributes:
        metadata: What it is, told to each client first.
        session: Makes what is known of a client, in a row of the batch.
        tell: Takes a line for people.
    """

    metadata: Mapping[str, Any]
    session: Callable[[int], Session]
    tell: Callable[[str], None] = field(default=lambda line: None)


class Server:
    """A policy that clients ask.

    Args:
        policy: The policy.
        desk: What clients are told, and what is known of them.
        key: What they must know; empty is nothing.
        limits: How much they may ask for.
    """

    def __init__(
        self, policy: AskedPolicy, desk: Desk, key: str = "", limits: Limits | None = None
    ) -> None:
        self._policy, self._desk, self._key = policy, desk, key
        self._limits = limits or Limits()
        self._rows: set[int] = set()
        self._batcher = Batcher(policy, lambda: len(self._rows))

    async def run(self, listening: socket.socket, stop: Callable[[], bool]) -> None:
        """Serves until it is to stop.

        Args:
            listening: Where clients come.
            stop: Whether to stop; it is asked a few times a second.
        """
        answering = asyncio.create_task(self._batcher.run())
        async with serve(
            self._serve,
            sock=listening,
            process_request=self._admit,
            compression=None,
            max_size=self._limits.largest,
            max_queue=2,
            origins=[None],  # browsers say where a page is from: it has no business here
            open_timeout=SLOW,
            close_timeout=1.0,
            logger=_QUIET,
        ):
            while not stop() and not answering.done():
                await asyncio.sleep(0.1)
        answering.cancel()
        await asyncio.gather(answering, return_exceptions=True)

    def _admit(self, connection: ServerConnection, handshake: Handshake) -> Response | None:
        """Answers before a connection is made; None lets it be made."""
        if handshake.path == "/healthz":
            return connection.respond(http.HTTPStatus.OK, "OK\n")
        given = " ".join(handshake.headers.get_all("Authorization"))
        expected = f"Api-Key {self._key}"
        if self._key and not hmac.compare_digest(
            given.encode(errors="surrogateescape"), expected.encode()
        ):
            words = "The key is missing or wrong: expected Authorization: Api-Key and the key.\n"
            return connection.respond(http.HTTPStatus.UNAUTHORIZED, words)
        if len(self._rows) >= self._limits.clients:
            words = f"There is room for {_clients(self._limits.clients)}, and not for more.\n"
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, words)
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        """One client, from its coming to its going."""
        if len(self._rows) >= self._limits.clients:  # who came in the same moment
            await connection.close(1013, "no room for more clients")
            return
        place = next(i for i in range(len(self._rows) + 1) if i not in self._rows)
        self._rows.add(place)
        name = ":".join(map(str, (connection.remote_address or ("?",))[:2]))
        self._desk.tell(f"{name} came; {_clients(len(self._rows))}.")
        talk = _Talk(self._desk.session(place % self._policy.width), self._batcher, self._limits)
        try:
            await _send(connection, to_wire(dict(self._desk.metadata)))
            async for message in connection:
                began = time.perf_counter()
                await _send(connection, await talk.answer(message))
                talk.total_ms = 1e3 * (time.perf_counter() - began)
            why = ""
        except ConnectionClosed as error:
            why = f" ({plain_line(str(error))})"  # some of it is the client's words
        except TimeoutError:
            why = f" (it took no answer within {SLOW:g} s)"
        finally:
            self._rows.discard(place)
        bad = f", {talk.refused} of them refused" if talk.refused else ""
        requests = f"{talk.requests} request{'' if talk.requests == 1 else 's'}{bad}"
        self._desk.tell(f"{name} gone after {requests}{why}; {_clients(len(self._rows))}.")


class _Talk:
    """Messages of one client and their answers."""

    def __init__(self, session: Session, batcher: Batcher, limits: Limits) -> None:
        self._session, self._batcher, self._limits = session, batcher, limits
        self._allowance, self._since = float(limits.per_second), time.monotonic()
        self.requests = self.refused = 0
        self.total_ms: float | None = None
        """That the last answer took in all."""

    async def answer(self, message: str | bytes) -> str | bytes:
        """The answer to a message; text is what is wrong with it."""
        self.requests += 1
        try:
            self._spend()
            return await self._infer(message)
        except JaxcamError as error:
            words = str(error)
        except Exception as error:  # a client's message must not end the server
            _log.exception("A request could not be answered.")
            words = f"The server failed at this request ({type(error).__name__}); it goes on."
        self.refused += 1
        return words

    async def _infer(self, message: str | bytes) -> bytes:
        if isinstance(message, str):
            raise PortError(
                f"Expected a binary message, msgpack of an observation; got text: {message!r:.80}."
            )
        content = from_wire(message)
        if (word := self._session.control(content)) is not None:
            return to_wire({"__ack__": word})
        asked = await asyncio.to_thread(self._session.ask, content)
        answer = await self._batcher.answer(asked)
        timing = {"infer_ms": 1e3 * answer.seconds}
        if self.total_ms is not None:
            timing["prev_total_ms"] = self.total_ms
        return to_wire({"actions": self._session.actions(answer.chunk), "server_timing": timing})

    def _spend(self) -> None:
        """Counts a request against those that a client may make a second."""
        rate, now = self._limits.per_second, time.monotonic()
        self._allowance = min(rate, self._allowance + rate * (now - self._since))
        self._since = now
        if self._allowance < 1:
            raise PortError(f"More than {rate} requests a second: expected fewer. Wait a little.")
        self._allowance -= 1


async def _send(connection: ServerConnection, answer: str | bytes) -> None:
    """Sends an answer to a client that takes it.

    Raises:
        TimeoutError: It does not.
    """
    try:
        async with asyncio.timeout(SLOW):
            await connection.send(answer)
    except TimeoutError:
        connection.transport.abort()
        raise


def _clients(count: int) -> str:
    return f"{count} client{'' if count == 1 else 's'}"
