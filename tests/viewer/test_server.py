"""Pages on the loopback."""

import http.client
import socket
import threading

import pytest

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.viewer.server import KEPT, PageDesk, serve


class Made:
    """Counts the pages that it makes; of episode 9 there is none."""

    def __init__(self):
        self.numbers = []

    def __call__(self, number):
        if number == 9:
            raise DatasetError("<damaged>")
        self.numbers.append(number)
        return f"page {number}"


@pytest.fixture
def served():
    """A server in a thread: what it makes pages with, and how to ask it."""
    made, stopped, addresses = Made(), threading.Event(), []
    desk = PageDesk(made, {**dict.fromkeys(range(8), "an episode"), 9: "damaged"}, 3)
    ready = threading.Event()

    def tell(address):
        addresses.append(address)
        ready.set()

    thread = threading.Thread(target=serve, args=(desk, 0, tell, stopped.is_set))
    thread.start()
    assert ready.wait(10)
    port = int(addresses[0].rpartition(":")[2])

    def ask(path, host=f"127.0.0.1:{port}"):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        connection.request("GET", path, headers={"Host": host})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()

    yield made, ask, port
    stopped.set()
    thread.join(10)
    assert not thread.is_alive()


def test_each_episode_has_a_page_and_the_first_is_at_the_root(served):
    made, ask, _ = served
    assert ask("/") == (200, "page 3")
    assert ask("/5") == (200, "page 5")
    assert ask("/5?x=1") == (200, "page 5")
    assert made.numbers == [3, 5]


def test_a_few_pages_are_kept(served):
    made, ask, _ = served
    for number in range(KEPT + 1):
        ask(f"/{number}")
    ask("/0")
    assert made.numbers == [*range(KEPT + 1), 0]


@pytest.mark.parametrize("path", ["/8", "/x", "/-1", "/../etc", "/1/2", "/%C2%B2", "/" + "9" * 30])
def test_what_is_not_there_is_not_found(served, path):
    made, ask, _ = served
    status, text = ask(path)
    assert status == 404
    assert "<" not in text
    assert made.numbers == []


def test_what_cannot_be_shown_is_said(served):
    _, ask, _ = served
    assert ask("/9") == (500, "&lt;damaged&gt;")


def test_other_pages_cannot_ask_through_a_name_of_theirs(served):
    made, ask, port = served
    assert ask("/", host=f"evil.example:{port}")[0] == 403
    assert made.numbers == []


def test_a_browser_that_connects_and_asks_nothing_keeps_nobody(served):
    _, ask, port = served
    with socket.create_connection(("127.0.0.1", port)):
        assert ask("/1") == (200, "page 1")


def test_a_port_that_is_taken_is_an_error():
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(ConfigError, match="is taken"),
    ):
        serve(PageDesk(Made(), {0: ""}, 0), taken.getsockname()[1], print, lambda: True)
