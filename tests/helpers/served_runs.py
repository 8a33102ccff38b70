"""Folders of runs whose policies were never trained, and servers of them on the loopback."""

import asyncio
import contextlib
import threading
from dataclasses import replace

import jax
from policy_inputs import start

from jaxcam.config.fields import to_json
from jaxcam.config.serve import ServeConfig
from jaxcam.config.train import TrainConfig
from jaxcam.models import PolicySpec, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.robot.server import Desk, Limits, Server
from jaxcam.robot.serving import Service, address_of, listen
from jaxcam.runs.identity import resolve
from jaxcam.training.checkpoint import Checkpoints
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state, make_optimizer

TINY = {
    "preset": "laptop", "steps": 6, "save_every": 1, "resolution": 16,
    "model": ("width=16", "hidden=16", "chunk=6", "encoder_width=8", "keypoints=4"),
}  # fmt: skip


def untrained_run(folder, *, proprio=11, actions=7, **settings):
    """The folder of a run whose only checkpoint is of step 0."""
    config = resolve(TrainConfig(**{**TINY, **settings, "run_dir": str(folder)}), accelerator=False)
    network = policy_settings(config, "Do it.")
    spec = PolicySpec(
        actions, proprio, config.views, *_size(config), network.chunk, network.obs_steps
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


def _size(config):
    rows = config.resolution
    return (rows, rows) if isinstance(rows, int) else tuple(map(int, rows.split("x")))


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
