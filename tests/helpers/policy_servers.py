"""Small policy servers on the loopback, written after openpi's description of its protocol."""

import contextlib
import threading
from collections.abc import Callable, Iterator

from websockets.sync.server import ServerConnection, serve


@contextlib.contextmanager
def socket_server(handler: Callable[[ServerConnection], None]) -> Iterator[str]:
    """A server that treats each connection with the handler; gives its address."""
    with serve(handler, "127.0.0.1", 0, compression=None) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join(5)
