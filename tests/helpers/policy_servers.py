"""Small policy servers on the loopback, written after openpi's description of its protocol."""

import contextlib
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import Any

import msgpack
import numpy as np
from websockets.sync.server import ServerConnection, serve

from jaxcam.client import from_wire, to_wire


@contextlib.contextmanager
def socket_server(handler: Callable[[ServerConnection], None], **how: Any) -> Iterator[str]:
    """A server that treats each connection with the handler; gives its address."""
    with serve(handler, "127.0.0.1", 0, compression=None, **how) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join(5)


def packed(value):
    """Arrays as openpi's servers write them; written apart from `jaxcam.client`."""
    array = np.asarray(value)
    return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str,
            b"shape": array.shape}  # fmt: skip


def unpacked(entry):
    """The inverse of `packed`."""
    if b"__ndarray__" not in entry:
        return entry
    return np.ndarray(entry[b"shape"], entry[b"dtype"], entry[b"data"])


@contextlib.contextmanager
def policy_server(infer, metadata=None, answer="actions"):
    """A server as openpi's: an error's text is sent, and the connection closed.

    Args:
        infer: Gives the actions for an observation.
        metadata: What the server says of itself.
        answer: Its name for the actions.
    """

    def handler(connection):
        connection.send(msgpack.packb(metadata or {}, default=packed))
        for message in connection:
            observation = msgpack.unpackb(message, object_hook=unpacked, strict_map_key=False)
            try:
                actions = infer(observation)
            except Exception:
                connection.send(traceback.format_exc())
                connection.close(1011, "Internal server error.")
                return
            if actions is HANG_UP:
                return
            timing = {"infer_ms": 1.0}
            content = {answer: actions, "server_timing": timing}
            connection.send(msgpack.packb(content, default=packed))

    with socket_server(handler) as address:
        yield address


HANG_UP = object()
"""Given instead of actions, it ends the connection."""


def answering(metadata, act):
    """A handler that says what it is and answers each observation with a chunk, or with words."""

    def handle(connection):
        connection.send(to_wire(metadata))
        for message in connection:
            observation = from_wire(message)
            if "__ctrl__" in observation:
                connection.send(to_wire({"__ack__": observation["__ctrl__"]}))
                continue
            try:
                connection.send(to_wire({"actions": act(observation)}))
            except ValueError as error:
                connection.send(str(error))

    return handle
