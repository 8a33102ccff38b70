"""Small policy servers on the loopback, written after openpi's description of its protocol."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

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
