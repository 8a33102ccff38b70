"""Devices and processes: where arrays lie, and what processes tell each other.

Batches are laid over a mesh of one axis, `data`; parameters are copied to all of it. One device is
a mesh of one, so there is one path. Several processes, on one host or many, each read their shard
of a batch, and only the first of them writes files.
"""

import contextlib
import json
import logging
import os
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxcam.console.command import print_error
from jaxcam.errors import ConfigError, JaxcamError

T = TypeVar("T")

AXIS = "data"
"""The mesh's only axis."""

_VARIABLES = {
    "coordinator_address": ("JAX_COORDINATOR_ADDRESS", str),
    "num_processes": ("JAX_NUM_PROCESSES", int),
    "process_id": ("JAX_PROCESS_ID", int),
}
_log = logging.getLogger(__name__)


@contextlib.contextmanager
def joined(distributed: bool) -> Iterator[None]:
    """Joins the processes of a run, before JAX is asked for its devices.

    Args:
        distributed: Whether there are others; if not, nothing is done.

    Raises:
        ConfigError: The others cannot be found.
    """
    if not distributed:
        yield
        return
    # Its handler would keep SIGTERM from `jaxcam.interrupts.interrupts`.
    jax.config.update("jax_enable_preemption_service", False)
    given = {k: kind(os.environ[v]) for k, (v, kind) in _VARIABLES.items() if v in os.environ}
    try:
        jax.distributed.initialize(**given)
    except (ValueError, RuntimeError) as error:
        raise ConfigError(
            f"The other processes cannot be found: {error} Start one process a host with srun or "
            "mpirun, or set JAX_COORDINATOR_ADDRESS (host:port of the first), JAX_NUM_PROCESSES "
            "and JAX_PROCESS_ID for each; or leave out --distributed."
        ) from error
    try:
        yield
    except Exception as error:
        # The others wait for this process inside a computation. Taking leave of them in order
        # would wait for them in turn; gone, it makes them fail too.
        code = 1
        if isinstance(error, JaxcamError):
            code = print_error(error)
        else:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    jax.distributed.shutdown()


def has_accelerator() -> bool:
    """Whether JAX computes on a GPU or TPU."""
    return jax.default_backend() != "cpu"


def is_first() -> bool:
    """Whether this process writes files and talks to people."""
    return jax.process_index() == 0


def shard() -> tuple[int, int]:
    """Which of how many shards this process reads."""
    return jax.process_index(), jax.process_count()


def gathered(value: T) -> list[T]:
    """What each process gives, in their order; every process gets it.

    Args:
        value: Anything JSON can hold.
    """
    if jax.process_count() == 1:
        return [value]
    data = np.frombuffer(json.dumps(value).encode(), np.uint8)
    sizes = multihost_utils.process_allgather(np.int32(len(data)))
    padded = np.zeros(sizes.max(), np.uint8)
    padded[: len(data)] = data
    texts = multihost_utils.process_allgather(padded)
    return [json.loads(row[:n].tobytes()) for row, n in zip(texts, sizes, strict=True)]


def check_same(what: str, value: str) -> None:
    """Refuses processes of which each has something of its own that all should share.

    Args:
        what: For the message.
        value: What this process has.

    Raises:
        ConfigError: They differ.
    """
    values = gathered(value)
    if len(set(values)) > 1:
        listed = ", ".join(f"process {i} has {text}" for i, text in enumerate(values))
        raise ConfigError(f"The processes of this run have different {what}: {listed}.")


def from_first(tree: T) -> T:
    """The first process's arrays, in every process; the others give some of the same shapes."""
    if jax.process_count() == 1:
        return tree
    # Copies, since these may be given away, and must not be memory that NumPy owns.
    return jax.tree.map(jax.numpy.array, multihost_utils.broadcast_one_to_all(tree))


def data_mesh(samples: int, *, everywhere: bool = True) -> Mesh:
    """The devices that share so many samples: as many of each process as divide them evenly.

    Args:
        samples: In a batch, or in the smallest part that is computed at once.
        everywhere: Whether devices of all processes take part, or only this one's.

    Raises:
        ConfigError: The processes cannot share them evenly.
    """
    processes = jax.process_count() if everywhere else 1
    if samples % processes:
        raise ConfigError(
            f"{samples} samples at once cannot be shared by {processes} processes: choose a "
            "multiple of that as --batch (times --accumulate)."
        )
    local = jax.local_device_count()
    each = max(n for n in range(1, local + 1) if samples % (n * processes) == 0)
    if each < local:
        _log.warning(
            "%d samples at once are shared by %d of the %d devices%s; a multiple of %d would keep "
            "all of them busy.", samples, each, local,
            " of each process" if processes > 1 else "", local * processes,
        )  # fmt: skip
    devices = jax.devices() if everywhere else jax.local_devices()
    devices = sorted(devices, key=lambda device: (device.process_index, device.id))
    chosen = [d for i, d in enumerate(devices) if i % local < each]
    return Mesh(np.array(chosen), (AXIS,))


def replicated(mesh: Mesh) -> NamedSharding:
    """The sharding of arrays that every device holds in full."""
    return NamedSharding(mesh, PartitionSpec())


def copied(mesh: Mesh, tree: T, *, donate: bool = False) -> T:
    """Arrays copied to every device of the mesh.

    Args:
        mesh: From `data_mesh`.
        tree: Arrays, the same in all processes.
        donate: Whether their memory may be used again; then do not use them again.
    """
    return jax.device_put(tree, replicated(mesh), donate=donate)


def spread(mesh: Mesh, batch: Mapping[str, Any], axis: int = 0) -> dict[str, jax.Array]:
    """A batch laid over the mesh.

    Args:
        mesh: From `data_mesh`.
        batch: This process's shard: arrays by name.
        axis: Axis of the samples.
    """
    sharding = NamedSharding(mesh, PartitionSpec(*[None] * axis, AXIS))
    return {k: jax.make_array_from_process_local_data(sharding, v) for k, v in batch.items()}


@contextlib.contextmanager
def memory_lacks(what: str, remedy: str) -> Iterator[None]:
    """Tells what to do where the device's memory does not suffice. Nothing is made smaller here.

    Args:
        what: That is computed inside.
        remedy: What is smaller.

    Raises:
        ConfigError: It does not fit.
    """
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        brief = str(error).splitlines()[0][:200]
        raise ConfigError(
            f"{what}: does not fit into the device's memory ({brief}). Use {remedy}"
        ) from error


def own(tree: T) -> T:
    """Arrays that every device has whole, as arrays of this process alone."""
    return jax.tree.map(np.asarray, tree) if jax.process_count() > 1 else tree


def stacked(trees: Sequence[T]) -> T:
    """One tree stays as it is; several become one with a first axis."""
    if len(trees) == 1:
        return trees[0]
    return jax.tree.map(lambda *leaves: jax.numpy.stack(leaves), *trees)


def part(tree: T, number: int, count: int) -> T:
    """One of the `count` trees that `stacked` was given."""
    return tree if count == 1 else jax.tree.map(lambda leaf: leaf[number], tree)
