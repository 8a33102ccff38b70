"""A soak of the policy server: does it forget nothing, leak nothing, and answer all rightly?

    python benchmarks/port_soak.py [--minutes 10] [--per-second 50]

Clients come and go and ask at a steady rate in all; each answer is held against what it must be,
bit for bit. At the same time others hang in the middle of a handshake or of a message, take no
answers, leave without a word, and send rubbish: text, garbage, huge messages, wrong shapes, NaN,
impossible cameras. What the server's process has in memory after the first tenth of the time (at
least 20 s) must not have grown by 5 % at the end. Exit code 1 where it has, or an answer was wrong.
"""

import argparse
import contextlib
import json
import os
import random
import socket
import sys
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from port import CHUNK, make_request, server_process
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from jaxcam.client import Client, to_wire
from jaxcam.errors import PortError

GOOD = 5
"""Clients that ask."""
SIDE = 84
ALLOWED = 1.05
HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


@dataclass
class Tally:
    """What happened, of all threads."""

    counts: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)
    stop: threading.Event = field(default_factory=threading.Event)

    def add(self, what: str) -> None:
        """Counts something."""
        with self.lock:
            self.counts[what] += 1


def resident(process: int) -> int:
    """Bytes of memory that a process has."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def right(request: dict[str, Any], actions: np.ndarray) -> bool:
    """Whether an answer is what that request must get."""
    pixel = np.float32(request["observation.images.view_0"][0, 0, 0])
    action = np.append(request["observation.state"], pixel)
    return actions.shape == (CHUNK, len(action)) and (actions == action).all()


def ask(url: str, tally: Tally, seed: int, pause: float) -> None:
    """A client that asks, leaves after a while, and comes again."""
    draw, number = random.Random(seed), seed
    due = time.monotonic()
    while not tally.stop.is_set():
        try:
            with Client(url, patience=5) as client:
                tally.add("came")
                for _ in range(draw.randrange(20, 200)):
                    due = max(due + pause, time.monotonic() - 1)
                    if tally.stop.wait(max(0, due - time.monotonic())):
                        return
                    number += GOOD
                    request = make_request(1, (SIDE, SIDE), number)
                    answer = client.infer(request)
                    tally.add("right" if right(request, answer["actions"]) else "WRONG")
                if draw.random() < 0.3:
                    client.reset()
        except PortError as error:
            tally.add(f"FAILED: {error}")


def rubbish(draw: random.Random) -> str | bytes:
    """Something that is no request."""
    good = make_request(1, (SIDE, SIDE), draw.randrange(1000))
    bad = [
        {"observation.state": np.full(8, np.nan, np.float32)},
        {"observation.state": np.zeros((9, 9))},
        {"camera.view_0.base_from_camera": np.full((4, 4), draw.random())},
        {"camera.view_0.intrinsics": np.zeros((3, 3))},
        {"observation.images.view_0": np.zeros((9000, 3, 3), np.uint8)},
        {f"unknown {draw.random()}": 1},
        {"prompt": ["a"] * 1000},
    ]
    return draw.choice([
        "text",
        draw.randbytes(draw.randrange(2000)),
        to_wire(good)[: draw.randrange(20_000)],
        to_wire({"__ctrl__": "dance"}),
        to_wire(good | draw.choice(bad)),
        b"\x91" * 5000,
    ])  # fmt: skip


def annoy(url: str, tally: Tally, seed: int) -> None:
    """One who never asks anything good."""
    draw, port = random.Random(seed), int(url.rpartition(":")[2])
    while not tally.stop.wait(draw.uniform(0.05, 0.4)):
        what = draw.choice(["rubbish", "huge", "hangs", "half", "deaf", "leaves", "no handshake"])
        tally.add(what)
        with contextlib.suppress(OSError, WebSocketException):
            if what == "rubbish":
                with connect(url, compression=None, max_size=None) as connection:
                    connection.recv(5)
                    for _ in range(5):
                        connection.send(rubbish(draw))
                        if not isinstance(connection.recv(5), str):
                            tally.add("WRONG")
            elif what == "huge":
                with connect(url, compression=None) as connection:
                    connection.send(bytes(33 * 2**20))
            else:
                with socket.create_connection(("127.0.0.1", port), timeout=5) as raw:
                    _misbehave(raw, what, draw)


def _misbehave(raw: socket.socket, what: str, draw: random.Random) -> None:
    if what == "no handshake":
        raw.sendall(draw.randbytes(300))
        return
    if what == "half":  # of a handshake
        raw.sendall(HANDSHAKE[: draw.randrange(len(HANDSHAKE) - 4)])
    else:
        raw.sendall(HANDSHAKE)
    if what == "hangs":  # in the middle of a message
        raw.sendall(b"\x82\xff" + (1_000_000).to_bytes(8, "big") + draw.randbytes(50_000))
    time.sleep(draw.uniform(0, 5))
    if what == "leaves":
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--per-second", type=float, default=50)
    options = parser.parse_args()
    tally, seconds = Tally(), 60 * options.minutes
    with server_process(1, SIDE, width=2) as (url, process):
        threads = [
            threading.Thread(target=ask, args=(url, tally, i, GOOD / options.per_second))
            for i in range(GOOD)
        ] + [threading.Thread(target=annoy, args=(url, tally, i)) for i in range(3)]
        for thread in threads:
            thread.start()
        warm = max(20.0, seconds / 10)
        tally.stop.wait(warm)
        first, began, answered = resident(process), time.monotonic(), tally.counts["right"]
        tally.stop.wait(max(1.0, seconds - warm))
        rate = (tally.counts["right"] - answered) / (time.monotonic() - began)
        last = resident(process)
        tally.stop.set()
        for thread in threads:
            thread.join(30)
    wrong = sum(n for what, n in tally.counts.items() if what.startswith(("WRONG", "FAILED")))
    result = {
        "seconds": seconds, "requests_per_second": round(rate, 1), "wrong": wrong,
        "resident_mb": [round(x / 1e6, 1) for x in (first, last)],
        "growth": round(last / first, 4), **dict(sorted(tally.counts.items())),
    }  # fmt: skip
    print(json.dumps(result, indent=1))
    sys.exit(1 if wrong or last > ALLOWED * first else 0)


if __name__ == "__main__":
    main()
