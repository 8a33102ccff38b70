"""Checkpoints that are whole or not there, and are never restored unverified.

Orbax writes them; it does not notice a flipped byte in an array. So every checkpoint carries a
manifest with a SHA-256 of each array, committed together with the arrays, and digests of its files,
and what does not match is not used: training goes on from the newest checkpoint that does.

A checkpoint is a folder of items: `params`, `ema` if the run keeps one, `train` (step, optimizer)
and `manifest`, whose `side` holds what is needed to rebuild the policy and to judge a resume.
"""

import json
import logging
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from jaxcam.config.fields import as_record, check_least, from_json
from jaxcam.config.train import TrainConfig
from jaxcam.console.words import some
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.files.paths import absolute
from jaxcam.models import FAMILIES, Policy, PolicySpec, make_policy
from jaxcam.runs.identity import read_config
from jaxcam.runs.manifests import DamagedError, seal, steps_in
from jaxcam.training.digests import (
    alone,
    brief,
    describe,
    flatten,
    from_plain,
    item_of,
    leaf_name,
    newest_whole,
    read_all,
    read_params,
    to_plain,
    write_digests,
)
from jaxcam.training.side import check_side
from jaxcam.training.state import TrainState

MASKED = "opt/inner_state/"
"""What names of the optimizer's state begin with."""

SPACE_FACTOR = 1.5
"""Free space asked for, as a multiple of a checkpoint's size."""

_log = logging.getLogger(__name__)


class Restored(NamedTuple):
    """A training state as it was, and what was saved beside it."""

    state: TrainState
    side: dict[str, Any]


class PolicyInputs(NamedTuple):
    """All that a policy is rebuilt from."""

    config: TrainConfig
    settings: dict[str, Any]
    """The policy's own settings, as keyword arguments of its config class."""
    spec: dict[str, Any]
    """Sizes, as keyword arguments of `PolicySpec`."""
    stats: dict[str, np.ndarray]
    params: Any
    """Parameters to evaluate: the moving average if the run keeps one."""
    step: int


class Checkpoints:
    """The checkpoints of one run, open for writing. The run folder's lock keeps others out.

    Args:
        directory: Folder of the checkpoints; made if missing. Half-written ones in it are removed.
        keep: How many of the newest at the run's regular steps are kept. One that a signal caused
            in between is kept until the next, so that all seeds keep the same steps.
    """

    def __init__(self, directory: str | Path, *, keep: int = 10) -> None:
        self._directory = absolute(directory)
        self._directory.mkdir(parents=True, exist_ok=True)
        _remove_unfinished(self._directory)
        self._keep = keep
        options = ocp.CheckpointManagerOptions(
            # A failed asynchronous save is reported by the next one, which may never come.
            enable_async_checkpointing=False,
            create=False,
            multiprocessing_options=alone(),
        )
        self._manager = ocp.CheckpointManager(self._directory, options=options)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Release what orbax holds."""
        self._manager.close()

    def steps(self) -> list[int]:
        """Steps that have a checkpoint, oldest first."""
        return sorted(self._manager.all_steps())

    def save(self, state: TrainState, side: Mapping[str, Any]) -> None:
        """Write a checkpoint of `state.step`; it is on disk and whole when this returns.

        Does nothing if the step has one, since a step of a run has only one state.

        Args:
            state: Training state.
            side: From `jaxcam.training.side.make_side`.

        Raises:
            CheckpointError: There is no space, or writing failed. Older checkpoints are untouched.
        """
        leaves = flatten(state)
        step = int(leaves["step"])
        if step in self.steps():
            return
        self._check_space(step, sum(leaf.nbytes for leaf in leaves.values()))
        items: dict[str, Any] = {}
        for name, leaf in leaves.items():
            if leaf.size:  # Orbax refuses empty arrays; the manifest knows them well enough.
                items.setdefault(item_of(name), {})[name] = leaf
        args: dict[str, Any] = {item: ocp.args.PyTreeSave(part) for item, part in items.items()}
        manifest = seal({
            "step": step,
            "side": to_plain(side),
            "leaves": {name: describe(leaf) for name, leaf in leaves.items()},
        })  # fmt: skip
        args["manifest"] = ocp.args.JsonSave(manifest)
        try:
            self._manager.save(step, args=ocp.args.Composite(**args), force=True)
        except Exception as error:  # Orbax passes on what its storage raises, of any type.
            _remove_unfinished(self._directory)
            raise CheckpointError(
                f"Checkpoint {step} could not be written to {self._directory}: "
                f"{brief(error)}. {self._last()}"
            ) from error
        try:
            write_digests(self._directory / str(step))
        except OSError as error:
            _log.warning("Checkpoint %d is whole, its files have no digests: %s.", step, error)
        self._prune(side["config"]["save_every"])

    def restore_latest(
        self, template: TrainState, *, expect: Mapping[str, Any] | None = None
    ) -> Restored | None:
        """The newest training state whose content is what was written.

        Damaged checkpoints are reported and moved to the folder `damaged` beside this one.

        Args:
            template: State of the same structure, arrays or shapes (`jax.eval_shape`).
            expect: Entries of the side that must be as given, see `check_side`.

        Returns:
            State and side, or None if nothing was saved yet.

        Raises:
            CheckpointError: No checkpoint is whole, or it is of another policy or other data.
        """
        if not self.steps():
            return None
        manifest, leaves, damaged = newest_whole(self._directory, read_all)
        side = from_plain(manifest["side"])
        where = f"Checkpoint {manifest['step']} in {self._directory}"
        check_side(where, manifest["side"], expect or {})
        state = _fill(where, template, leaves)
        for step in damaged:
            self._set_aside(step)
        if damaged:
            self._manager.reload()
        return Restored(state, side)

    def _prune(self, spacing: int) -> None:
        """Remove what is neither the newest nor among the newest at regular steps."""
        steps = self.steps()
        kept = {steps[-1], *[step for step in steps if step % spacing == 0][-self._keep :]}
        for step in steps:
            if step not in kept:
                self._manager.delete(step)

    def _check_space(self, step: int, size: int) -> None:
        needed, free = SPACE_FACTOR * size, shutil.disk_usage(self._directory).free
        if free < needed:
            raise CheckpointError(
                f"No space for checkpoint {step} in {self._directory}: {needed / 1e6:.0f} MB "
                f"needed, {free / 1e6:.0f} MB free. {self._last()} Make room and run the same "
                "command again."
            )

    def _last(self) -> str:
        steps = self.steps()
        return f"The last whole checkpoint is {steps[-1]}." if steps else "There is no other one."

    def _set_aside(self, step: int) -> None:
        damaged = self._directory.parent / "damaged"
        damaged.mkdir(exist_ok=True)
        count = sum(1 for _ in damaged.glob(f"{step}-*"))
        (self._directory / str(step)).rename(damaged / f"{step}-{count}")


def load_policy_inputs(run_dir: str | Path, step: int | None = None) -> PolicyInputs:
    """Read what a policy is rebuilt from, out of a run folder and nothing else.

    Args:
        run_dir: Folder of the run. It is not changed.
        step: Checkpoint; None is the newest one that is whole.

    Raises:
        CheckpointError: There is no such checkpoint, it is damaged, or it is of another version.
        ConfigError: The folder has a config.json that is not that of its checkpoints.
    """
    folder = absolute(run_dir)
    directory = folder / "checkpoints"
    known = steps_in(directory)
    if not known:
        raise CheckpointError(f"No checkpoint in {directory}. Train first, or check the path.")
    if (folder / "config.json").exists():
        read_config(folder)
    if step is None:
        manifest, leaves, _ = newest_whole(directory, read_params)
    elif step in known:
        try:
            manifest, leaves = read_params(directory / str(step))
        except DamagedError as error:
            raise CheckpointError(f"Checkpoint {step} in {directory}: {error}.") from error
    else:
        raise CheckpointError(
            f"No checkpoint of step {step} in {directory}. Known: {', '.join(map(str, known))}."
        )
    where = f"Checkpoint {manifest['step']} in {directory}"
    check_side(where, manifest["side"], {})
    side = from_plain(manifest["side"])
    return PolicyInputs(
        config=from_json(TrainConfig, json.dumps(side["config"])),
        settings=_with_tuples(side["settings"]),
        spec=_with_tuples(side["spec"]),
        stats=side["stats"],
        params=_nest(leaves),
        step=manifest["step"],
    )


def records_of(inputs: PolicyInputs) -> tuple[Any, PolicySpec]:
    """The settings and the sizes of a checkpoint's policy.

    Raises:
        CheckpointError: They are not those of such a policy.
    """
    kind = FAMILIES[inputs.config.policy].config
    try:
        settings = as_record(kind, inputs.settings, "policy's settings")
        spec = as_record(PolicySpec, inputs.spec, "policy's sizes")
        check_least(spec, 1, "action_dim proprio_dim views height width chunk obs_steps")
    except ConfigError as error:
        raise CheckpointError(f"Checkpoint {inputs.step} is of another version: {error}") from error
    return settings, spec


def rebuild_policy(inputs: PolicyInputs) -> Policy:
    """The policy of a checkpoint, as it was trained.

    Raises:
        CheckpointError: Its settings, sizes or parameters are not those of such a policy.
        ConfigError: Its statistics are not.
    """
    policy = make_policy(*records_of(inputs), inputs.stats)
    if wrong := _misfits(jax.eval_shape(policy.init, jax.random.key(0)), inputs.params):
        raise CheckpointError(f"Checkpoint {inputs.step} is of another policy: {some(wrong)}.")
    return policy


def _misfits(expected: Any, got: Any) -> list[str]:
    """In what two trees of arrays, or of their shapes, differ."""
    wanted, there = (
        {leaf_name(path): f"{leaf.dtype} {tuple(leaf.shape)}" for path, leaf in leaves}
        for leaves in map(jax.tree_util.tree_leaves_with_path, (expected, got))
    )
    return [
        f"{name} is {there.get(name, 'missing')}, expected {wanted.get(name, 'nothing')}"
        for name in sorted(wanted.keys() | there.keys())
        if wanted.get(name) != there.get(name)
    ]


def checkpoint_steps(run_dir: str | Path) -> list[int]:
    """Steps of a run folder that have a checkpoint, oldest first."""
    return steps_in(absolute(run_dir) / "checkpoints")


def _remove_unfinished(directory: Path) -> None:
    for path in directory.glob("*.orbax-checkpoint-tmp*"):
        shutil.rmtree(path, ignore_errors=True)


def _nest(leaves: Mapping[str, np.ndarray]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, leaf in leaves.items():
        _, *parents, last = name.split("/")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[last] = jnp.array(leaf)
    return tree


def _fill(where: str, template: TrainState, leaves: Mapping[str, np.ndarray]) -> TrainState:
    """The template's structure with the checkpoint's arrays."""
    if not any(name.startswith(MASKED) for name in leaves):
        # Runs older than the mask that frozen parameters need lack its level of names.
        leaves = {re.sub("^opt/", MASKED, name): leaf for name, leaf in leaves.items()}
    paths, structure = jax.tree_util.tree_flatten_with_path(template)
    names = [leaf_name(path) for path, _ in paths]
    if wrong := _misfits(template, leaves):
        raise CheckpointError(f"{where} is of another policy or optimizer: {some(wrong)}.")
    # Copies: an update donates its state, and must not be given memory that NumPy owns.
    return jax.tree.unflatten(structure, [jnp.array(leaves[name]) for name in names])


def _with_tuples(value: Any) -> Any:
    """Settings as their dataclasses have them: JSON has no tuples, settings have no lists."""
    if isinstance(value, dict):
        return {k: _with_tuples(v) for k, v in value.items()}
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value
