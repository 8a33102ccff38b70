"""Asking a policy server: openpi's wire protocol, and a client for robots.

A robot's computer needs this module, NumPy, msgpack and websockets; nothing else of jaxcam is
imported. Messages are msgpack over a WebSocket, arrays as openpi's servers and clients write them
(openpi, `packages/openpi-client`, its message format; the code here is our own), never pickle:

    server -> client   metadata, once, when a client connects
    client -> server   an observation: names to arrays, text, numbers
    server -> client   {"actions": [T, A], "server_timing": {...}}, or text: what was wrong
"""

import ipaddress
import math
import re
import socket
import struct
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, Self, cast
from urllib.parse import urlsplit

import msgpack
import numpy as np
from websockets.exceptions import (
    ConnectionClosed,
    InvalidHandshake,
    InvalidProxy,
    InvalidURI,
)
from websockets.sync.client import ClientConnection, connect

from jaxcam.errors import NoServerError, PortError, RefusedError

IMAGES, STATE, CAMERA, PROMPT = "observation.images.", "observation.state", "camera.", "prompt"
"""What names of an observation's entries are, or begin with; `docs/serving.md` has them all."""
MOST_BYTES = 64 * 2**20
"""Of one message; two pictures of 1080 x 1920 are 12 MiB."""
CLOSING = 1.0
"""Seconds that the end of a connection may take."""
_KINDS = "biufSU"
"""Kinds of NumPy's types that arrays may have: truth values, numbers and text."""
_DTYPE = re.compile(rf"[<>|=]?[{_KINDS}][0-9]{{1,6}}")
"""How NumPy writes those (`dtype.str`)."""
_MOST_PARTS = 100_000
"""Lists, maps and arrays of a message; each costs its reader far more than the byte that it is."""


def to_wire(message: Any) -> bytes:
    """A message as bytes.

    Args:
        message: Dicts, lists, text, numbers, and arrays of numbers.

    Raises:
        PortError: Something in it is none of these.
    """
    try:
        return cast(bytes, msgpack.packb(message, default=_plain))
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise PortError(f"This cannot be sent: {error}.") from error


def from_wire(data: bytes) -> Any:
    """The message in some bytes; what is in them is data and cannot run.

    Raises:
        PortError: They are no such message, or an array in it is not what its header says.
    """
    parts = 0

    def counted(part: Any) -> Any:
        nonlocal parts
        parts += 1
        if parts > _MOST_PARTS:
            raise PortError(f"A message of more than {_MOST_PARTS} lists, maps and arrays.")
        return _array(part) if isinstance(part, dict) else part

    try:
        return msgpack.unpackb(
            data, object_hook=counted, list_hook=counted, ext_hook=_foreign, strict_map_key=False
        )
    except PortError:
        raise
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        words = str(error) or type(error).__name__
        raise PortError(
            f"Expected a message in msgpack, got {len(data)} bytes: {words}."
        ) from error


def _plain(value: Any) -> Any:
    """An array or a number of NumPy's as openpi writes it."""
    if hasattr(value, "__array__") and not isinstance(value, np.ndarray | np.generic):
        value = np.asarray(value)  # PyTorch's and JAX's
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in _KINDS:
        if isinstance(value, np.generic):
            return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
        return {
            b"__ndarray__": True,
            b"data": value.tobytes(),
            b"dtype": value.dtype.str,
            b"shape": value.shape,
        }
    kind = f"an array of {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
    raise TypeError(f"{kind} is neither text nor numbers nor an array of them")


def _foreign(code: int, data: bytes) -> Any:
    raise PortError(f"Part of the message is of a kind of its sender's own ({code}).")


def _array(entry: dict[Any, Any]) -> Any:
    """What `_plain` wrote; other entries stay as they are."""
    if b"__ndarray__" not in entry and b"__npgeneric__" not in entry:
        return entry
    try:
        kind = entry[b"dtype"]
        # Names of structures are not even parsed: NumPy would do it with Python's own parser.
        if not isinstance(kind, str) or not _DTYPE.fullmatch(kind):
            raise PortError(f"An array of {kind!r:.80} is not taken; expected numbers or text.")
        dtype = np.dtype(kind)
        if b"__npgeneric__" in entry:
            return dtype.type(entry[b"data"])
        shape, data = tuple(entry[b"shape"]), entry[b"data"]
        if not all(isinstance(side, int) and side >= 0 for side in shape):
            raise ValueError("its shape is no list of sizes")
        if len(data) != dtype.itemsize * math.prod(shape):
            raise ValueError(f"{len(data)} bytes of data, and {dtype} {list(shape)} by its header")
        return np.frombuffer(data, dtype).reshape(shape)
    except PortError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise PortError(f"An array in the message is damaged: {error}.") from error


def is_key(key: object) -> bool:
    """Whether something can be sent as a key: one word of ASCII letters, digits and signs."""
    return isinstance(key, str) and key.isascii() and key.isprintable() and " " not in key


def check_address(url: str) -> str:
    """Refuses what is no address of a policy server.

    Args:
        url: Such as "ws://localhost:8000".

    Returns:
        The name of the machine.

    Raises:
        NoServerError: It is none.
    """
    try:
        parts = urlsplit(url)
        host = parts.hostname if parts.port != 0 else None
        if parts.scheme in ("ws", "wss") and host and url.isprintable() and " " not in url:
            host.encode("idna")
            return host
        why = ""
    except (ValueError, TypeError, AttributeError) as error:
        why = f" ({error})"
    raise NoServerError(
        f"{url!r:.200} is no address of a policy server{why}. Expected one such as "
        "ws://127.0.0.1:8000."
    )


def _said(error: Exception) -> str:
    """What a server wrote with its refusal; empty if nothing."""
    body = getattr(getattr(error, "response", None), "body", None) or b""
    words = " ".join(body[:1000].decode(errors="replace").split())
    return f" It says: {words[:300]}" if words else ""


def _is_here(host: str) -> bool:
    """Whether a name is this machine's own, to which no proxy leads."""
    try:
        return host == "localhost" or ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return False


def _limit_sending(connected: socket.socket, seconds: float) -> None:
    """Ends what is sent to one who has not taken it for so long, where the system can (Linux)."""
    whole = int(seconds)
    limit = struct.pack("@ll", whole, max(1, int(1e6 * (seconds - whole))))
    with suppress(OSError):
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)


class Client:
    """A connection to a policy server; `with Client("ws://localhost:8000") as policy: …`.

    Lost connections are made again. Not for several threads at once.

    Args:
        url: Such as "ws://localhost:8000".
        key: What the server asks for, if it does.
        timeout: Seconds to wait for an answer.
        patience: Seconds to wait for a server that is not there, or not yet.
        answer: What the server calls its actions.

    Raises:
        NoServerError: There is no such server, or it does not take the key.
    """

    def __init__(
        self,
        url: str,
        *,
        key: str | None = None,
        timeout: float = 30.0,
        patience: float = 10.0,
        answer: str = "actions",
    ) -> None:
        self._host = check_address(url)
        if key and not is_key(key):
            raise NoServerError("A key is one word of ASCII letters, digits and signs.")
        self.url, self._timeout, self._patience, self._answer = url, timeout, patience, answer
        self._headers = {"Authorization": f"Api-Key {key}"} if key else {}
        self._connection: ClientConnection | None = None
        self._open = ExitStack()  # websockets 17 wants each connection to be a context
        self.metadata: Mapping[str, Any] = {}
        """What the server says of itself; `{}` where it says nothing."""
        self.reconnects = 0
        """How often a lost connection was made again. A server that remembers observations has
        forgotten them then."""
        self._connect()

    def infer(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """The server's answer to an observation: `actions` [T, A], and what else it says.

        Args:
            observation: What the server asks for by its `metadata`: names to arrays and text.

        Raises:
            NoServerError: The server is gone and does not come back.
            RefusedError: It refuses the observation; its words are in the message.
            PortError: It does not answer in time, or its answer is none.
        """
        answer = self._ask(to_wire(dict(observation)))
        if self._answer not in answer:
            names = sorted(map(str, answer))
            raise PortError(f"{self.url} answered without {self._answer}: {names}.")
        return answer

    def reset(self) -> None:
        """Tell the server that an episode begins, if it is one that wants to know."""
        controls = self.metadata.get("controls")
        if isinstance(controls, list) and "episode_start" in controls:
            self._ask(to_wire({"__ctrl__": "episode_start"}))

    def close(self) -> None:
        """End the connection; the next question makes it again."""
        self._connection = None
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _ask(self, message: bytes) -> dict[str, Any]:
        """The answer to a message, on a new connection where the old one is gone."""
        if len(message) > MOST_BYTES:
            raise PortError(f"An observation of {len(message)} bytes; at most {MOST_BYTES}.")
        fresh = self._connection is None
        if self._connection is None:
            self._connect()
            self.reconnects += 1
        try:
            answer = self._exchange(message)
        except ConnectionClosed as error:
            self.close()
            if fresh:
                raise PortError(f"{self.url} ended the connection: {error}.") from error
            return self._ask(message)
        if isinstance(answer, str):
            raise RefusedError(f"{self.url} refused: {answer}")
        content = from_wire(answer)
        if not isinstance(content, dict):
            raise PortError(f"{self.url} answered with {type(content).__name__}, expected names.")
        return cast("dict[str, Any]", content)

    def _exchange(self, message: bytes) -> str | bytes:
        assert self._connection is not None
        try:
            self._connection.send(message)
            return self._connection.recv(self._timeout)
        except TimeoutError as error:
            self.close()  # the answer may still come, and would be taken for the next one's
            raise PortError(f"{self.url} did not answer within {self._timeout:g} s.") from error

    def _connect(self) -> None:
        """Connect, waiting for a server that is about to come, and read what it says of itself."""
        until = time.monotonic() + self._patience
        while True:
            try:
                connecting = connect(
                    self.url,
                    compression=None,
                    max_size=MOST_BYTES,
                    additional_headers=self._headers,
                    open_timeout=max(1.0, self._patience),
                    close_timeout=CLOSING,
                    proxy=None if _is_here(self._host) else True,
                )
                connection = cast(ClientConnection, self._open.enter_context(connecting))
                self._connection = connection
                _limit_sending(connection.socket, self._timeout)
                first = connection.recv(self._timeout)
                break
            except (InvalidProxy, ImportError) as error:  # of another's kind than can be used
                raise NoServerError(
                    f"{self.url} cannot be asked through the proxy that the environment names: "
                    f"{error}. Name the server's machine in no_proxy."
                ) from error
            except (InvalidURI, InvalidHandshake, ValueError) as error:
                raise NoServerError(
                    f"{self.url} is no policy server for us: {str(error).rstrip('.')}."
                    f"{_said(error)}"
                ) from error
            except (OSError, ConnectionClosed) as error:  # a time-out is one, too
                self.close()
                if time.monotonic() > until:
                    raise NoServerError(
                        f"No policy server answers at {self.url}: {error or type(error).__name__}. "
                        "Start it, or check the address."
                    ) from error
                time.sleep(0.2)
        try:
            metadata = from_wire(first) if isinstance(first, bytes) else None
        except PortError:
            metadata = None
        if not isinstance(metadata, dict):
            self.close()
            instead = f", but with {first!r:.500}" if isinstance(first, str) else ""
            raise NoServerError(
                f"{self.url} did not begin with what it is, as openpi's servers do{instead}."
            )
        self.metadata = cast("dict[str, Any]", metadata)
