"""Folders of runs whose policies were never trained, and servers of them on the loopback."""

import asyncio
import contextlib
import threading
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import port_requests
import tiny_training
from policy_inputs import start

from jaxcam.config.fields import to_json
from jaxcam.config.serve import ServeConfig
from jaxcam.config.sizes import rows_and_columns
from jaxcam.config.train import TrainConfig
from jaxcam.evaluation.evaluator import Candidate
from jaxcam.models import PolicySpec, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.robot.asked import AskedPolicy
from jaxcam.robot.rig import Rig
from jaxcam.robot.server import Desk, Limits, Server
from jaxcam.robot.serving import Service, address_of, listen
from jaxcam.runs.identity import resolve
from jaxcam.runs.interface import Interface
from jaxcam.training.checkpoint import Checkpoints
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state, make_optimizer

NAMES = Interface(("front",), ("x", "y", "grip"), ("dx", "dy"), 10.0, "Lift it.")
TINY = {
    "preset": "laptop", "steps": 6, "save_every": 1, "resolution": 16,
    "model": ("width=16", "hidden=16", "chunk=6", "encoder_width=8", "keypoints=4"),
}  # fmt: skip


def untrained_run(folder, *, proprio=11, actions=7, **settings):
    """The folder of a run whose only checkpoint is of step 0."""
    config = resolve(TrainConfig(**{**TINY, **settings, "run_dir": str(folder)}), accelerator=False)
    network = policy_settings(config, ("Do it.",))
    spec = PolicySpec(
        actions,
        proprio,
        config.views,
        *rows_and_columns(config.resolution),
        network.chunk,
        network.obs_steps,
    )
    stats = blank_stats(spec)
    policy = make_policy(network, spec, stats)
    params = start(policy)
    state = init_state(lambda key: params, make_optimizer(config), jax.random.key(0))
    side = make_side(config, settings=network, spec=spec, stats=stats, data="none")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(to_json(config))
    with Checkpoints(folder / "checkpoints") as checkpoints:
        checkpoints.save(replace(state, step=jax.numpy.int32(0)), side)
    return folder


@contextlib.contextmanager
def serving(service, *, key="", limits=None, lines=None):
    """A server of a service; gives its address."""
    lines = [] if lines is None else lines
    stop = threading.Event()
    with listen("127.0.0.1", 0, has_key=bool(key)) as listening:
        desk = Desk(service.metadata(), service.session, lines.append)
        server = Server(service.policy, desk, key, limits or Limits())
        thread = threading.Thread(
            target=asyncio.run, args=(server.run(listening, stop.is_set),), daemon=True
        )
        thread.start()
        try:
            yield address_of(listening)
        finally:
            stop.set()
            thread.join(10)
            assert not thread.is_alive()


def opened(folder, **settings):
    """The service of a run."""
    return Service.open(ServeConfig(str(folder), **settings))


def linear(*, noise=False, obs_steps=1):
    """A linear policy that compiles in no time, with chance or without."""
    plain = tiny_training.policy()

    def act(params, obs, key):
        newest = obs if obs_steps == 1 else {name: obs[name][:, -1] for name in obs}
        chunk = plain.act(params, newest, key)
        return chunk + jax.random.normal(key, chunk.shape) if noise else chunk

    spec = replace(tiny_training.SPEC, obs_steps=obs_steps)
    params = plain.init(jax.random.key(1))
    changed = replace(plain, act=act, spec=spec)
    return Candidate(changed, params, Path("linear"), 0)


def linear_service(*, width=1, noise=False, obs_steps=1):
    """A service of the linear policy."""
    config = resolve(TrainConfig(task="recorded"), accelerator=False)
    asked = AskedPolicy(linear(noise=noise, obs_steps=obs_steps), config.seed, width)
    return Service(config, NAMES, asked, Rig({}))


def linear_request(seed=0, **changes):
    """A good request for the linear policy, whose pictures need no fitting."""
    side = tiny_training.PIXELS
    return port_requests.request(NAMES.views, (side, side), seed=seed, **changes)


def local_chunks(service, requests):
    """What `act` gives for a batch of those requests, on this side of the socket."""
    batch = {
        "image": np.stack([r["observation.images.front"][None] for r in requests]),
        "K": np.stack([r["camera.front.intrinsics"][None] for r in requests]),
        "base_from_camera": np.stack([r["camera.front.base_from_camera"][None] for r in requests]),
        "proprio": np.stack([r["observation.state"] for r in requests]),
    }
    candidate = service.candidate
    return np.asarray(jax.jit(candidate.policy.act)(candidate.params, batch, jax.random.key(0)))
