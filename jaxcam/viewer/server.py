"""Pages of a viewer on the loopback: each is made when somebody asks for it.

Threads answer, and this thread makes the pages, one after the other: simulators and JAX are asked
from where they were loaded.
"""

import errno
import html
import queue
import re
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

from jaxcam.errors import ConfigError, JaxcamError

HOST = "127.0.0.1"
KEPT = 4
"""Pages that are kept."""
_OURS = ("127.0.0.1", "localhost", "[::1]")
"""Names under which a browser of this machine asks; others are a web page's that tries to."""


@dataclass
class PageDesk:
    """Where threads ask for pages.

    Attributes:
        make: Makes the page of an episode.
        known: Numbers of the episodes that there are; the first is shown where none is asked for.
        made: Pages that are kept.
        wanted: What is asked.
    """

    make: Callable[[int], str]
    known: Mapping[int, str]
    first: int
    made: dict[int, str] = field(default_factory=dict)
    wanted: "queue.Queue[tuple[int, Future[str]]]" = field(default_factory=queue.Queue)

    def page(self, path: str) -> tuple[HTTPStatus, str]:
        """The page of a path, "/" or "/12"; called by threads, waits until it is made."""
        name = path.partition("?")[0].strip("/")
        number = int(name) if name.isascii() and name.isdecimal() and len(name) < 10 else None
        if not name:
            number = self.first
        if number is None or number not in self.known:
            text = f"There is no {html.escape(path[:80])} here: episodes are at /0, /1, …"
            return HTTPStatus.NOT_FOUND, text
        answer: Future[str] = Future()
        self.wanted.put((number, answer))
        try:
            return HTTPStatus.OK, answer.result()
        except JaxcamError as error:
            return HTTPStatus.INTERNAL_SERVER_ERROR, html.escape(str(error))
        except Exception:  # which ends the command
            return HTTPStatus.INTERNAL_SERVER_ERROR, "It failed: the terminal says why."

    def work(self, patience: float) -> None:
        """Makes one page, if one is asked for within so many seconds."""
        try:
            number, answer = self.wanted.get(timeout=patience)
        except queue.Empty:
            return
        try:
            page = self.made.pop(number, None) or self.make(number)
        except Exception as error:
            answer.set_exception(error)
            if not isinstance(error, JaxcamError):
                raise
            return
        self.made[number] = page
        while len(self.made) > KEPT:
            del self.made[next(iter(self.made))]
        answer.set_result(page)


def serve(desk: PageDesk, port: int, tell: Callable[[str], Any], stop: Callable[[], bool]) -> None:
    """Serves pages until it is asked to stop.

    Args:
        desk: Where pages are asked for.
        port: To listen at; 0 takes a free one.
        tell: Is told the address.
        stop: Whether to stop.

    Raises:
        ConfigError: The port is taken.
    """

    class Answering(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            if re.sub(r":[0-9]+$", "", self.headers.get("Host") or "") not in _OURS:
                self.send_error(HTTPStatus.FORBIDDEN)
                return
            if self.path == "/favicon.ico":
                self.send_response(HTTPStatus.NO_CONTENT)
                self.end_headers()
                return
            status, text = desk.page(self.path)
            content = text.encode()
            self.send_response(status)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Tells nobody."""

    try:
        server = ThreadingHTTPServer((HOST, port), Answering)
    except OSError as error:
        if error.errno not in (errno.EADDRINUSE, errno.EACCES):
            raise
        raise ConfigError(
            f"Port {port} of {HOST} is taken or reserved. Choose another --port; 0 takes a free "
            "one."
        ) from error
    server.daemon_threads = True
    with server:
        listener = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        listener.start()
        tell(f"http://{HOST}:{server.server_port}")
        try:
            while not stop():
                desk.work(0.2)
        finally:
            server.shutdown()
