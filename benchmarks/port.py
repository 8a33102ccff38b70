"""The policy server: what a request costs beside the policy's own time.

    python benchmarks/port.py [--requests 300] [--rounds 3] [--json]

The server is another process, with a policy that takes no time; what it tells of that is taken from
each request's round trip. So the number is all of the port: packing, the socket, reading, checking
and fitting the pictures, waiting for the batch, and the way back. `ratio` is the median of the best
round by what it may be.
"""

import argparse
import asyncio
import json
import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxcam.client import Client
from jaxcam.config.train import TrainConfig
from jaxcam.evaluation.evaluator import Candidate
from jaxcam.models import Policy, PolicySpec
from jaxcam.robot.asked import AskedPolicy
from jaxcam.robot.rig import Rig
from jaxcam.robot.server import Desk, Limits, Server
from jaxcam.robot.serving import Service, address_of, listen
from jaxcam.runs.identity import resolve
from jaxcam.runs.interface import Interface

STATE, CHUNK = 8, 16


class Case(NamedTuple):
    """What is sent, and how many milliseconds it may cost, if anybody says."""

    name: str
    views: int
    size: tuple[int, int]
    fitted: int
    limit: float | None


CASES = (
    Case("84x84", 1, (84, 84), 84, 3.0),
    Case("2 x 256x256", 2, (256, 256), 256, 15.0),
    Case("2 x 480x640, fitted to 256x256", 2, (480, 640), 256, None),
)


def instant(views: int, side: int, width: int = 1) -> Service:
    """A service of a policy that answers with the state, and with a pixel of the first picture."""
    spec = PolicySpec(STATE + 1, STATE, views, side, side, CHUNK)

    def act(params: Any, obs: Any, key: Any) -> Any:
        pixel = obs["image"][:, 0, 0, 0, :1].astype(jnp.float32)
        action = jnp.concatenate([obs["proprio"], pixel], -1)
        return jnp.repeat(action[:, None], CHUNK, 1) + 0 * params["w"]

    policy: Any = Policy(None, None, act, None, spec, CHUNK)  # pyright: ignore
    candidate = Candidate(policy, {"w": jnp.zeros(1)}, Path("instant"), 0)
    config = resolve(TrainConfig(task="recorded"), accelerator=False)
    names = Interface(
        tuple(f"view_{v}" for v in range(views)),
        tuple(f"state_{i}" for i in range(STATE)),
        tuple(f"action_{i}" for i in range(STATE + 1)),
    )
    return Service(config, names, AskedPolicy(candidate, 0, width), Rig({}))


def _serve(pipe: Any, views: int, side: int, width: int) -> None:
    service = instant(views, side, width)
    with listen("127.0.0.1", 0, has_key=False) as listening:
        server = Server(
            service.policy,
            Desk(service.metadata(), service.session),
            limits=Limits(per_second=100_000),
        )
        pipe.send(address_of(listening))
        asyncio.run(server.run(listening, pipe.poll))


@contextmanager
def server_process(views: int, side: int, width: int = 1) -> Iterator[tuple[str, int]]:
    """A server in a process of its own: its address, and the process's number."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, views, side, width), daemon=True)
    process.start()
    there.close()
    try:
        yield here.recv(), process.pid or 0
    finally:
        here.close()
        process.join(10)
        process.kill()


def make_request(views: int, size: tuple[int, int], seed: int) -> dict[str, np.ndarray]:
    """Noise seen by cameras above the table."""
    rng, (height, width) = np.random.default_rng(seed), size
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], np.float32)
    pose = np.diag([1.0, -1, -1, 1]).astype(np.float32)
    pose[2, 3] = 1 + seed / 1000
    request = {"observation.state": rng.normal(size=STATE).astype(np.float32)}
    for v in range(views):
        request[f"observation.images.view_{v}"] = rng.integers(0, 256, (*size, 3), np.uint8)
        request[f"camera.view_{v}.intrinsics"] = K
        request[f"camera.view_{v}.base_from_camera"] = pose
    return request


def measure(case: Case, requests: int) -> list[float]:
    """Milliseconds of each request beside the policy's own."""
    messages = [make_request(case.views, case.size, seed) for seed in range(8)]
    spent = []
    with server_process(case.views, case.fitted) as (url, _), Client(url, patience=120) as client:
        for i in range(requests + 20):
            began = time.perf_counter()
            answer = client.infer(messages[i % len(messages)])
            took = 1e3 * (time.perf_counter() - began)
            spent.append(took - answer["server_timing"]["infer_ms"])
    return spent[20:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--requests", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = []
    for case in CASES:
        rounds = [measure(case, options.requests) for _ in range(options.rounds)]
        best = min(rounds, key=np.median)
        middle, late = np.percentile(best, (50, 95))
        result = {"case": case.name, "median_ms": round(middle, 2), "p95_ms": round(late, 2)}
        words = f"{case.name:32} median {middle:6.2f} ms, 95th {late:6.2f} ms"
        if case.limit:
            result |= {"limit_ms": case.limit, "ratio": round(middle / case.limit, 2)}
            words += f", limit {case.limit:g} ms, ratio {middle / case.limit:.2f}"
        results.append(result)
        if not options.json:
            print(words, flush=True)
    if options.json:
        print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
