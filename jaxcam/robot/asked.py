"""A run's policy as a server asks it: always in batches of one size, whatever arrives together.

XLA's results can differ in their last digits between batches of different sizes, and even between
rows of one; they do not depend on what is in the other rows. So there is one size, a
client's requests are always in its own row, and a chunk is the same bit for bit as that of
`policy.act` on a batch of that size with the observation in that row.

Policies with chance draw it for a whole batch by the run's seed and the number of the call, as
rollouts do (`jaxcam.evaluation.evaluator.Acting`): requests of different calls are not computed
together then.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.evaluation.evaluator import Candidate
from jaxcam.models import PolicySpec
from jaxcam.robot.requests import Shown
from jaxcam.training.checkpoint import load_policy_inputs, rebuild_policy


@dataclass(frozen=True)
class Question:
    """What a policy is asked: an observation, and whose turn it is."""

    obs: Shown = field(repr=False)
    """As a policy takes it, without the batch axis."""
    call: int = 0
    """Number of the call in its episode."""
    row: int = 0
    """Row of the batch."""


class AskedPolicy:
    """A run's policy, compiled for batches of one size.

    Args:
        candidate: The policy and its parameters.
        seed: Of the run's chance.
        width: Rows of a batch.
    """

    def __init__(self, candidate: Candidate, seed: int, width: int = 1) -> None:
        self.candidate, self.width = candidate, width
        self._params = jax.device_put(candidate.params)
        self._root = jax.random.key(seed)
        self._programs: dict[bool, Any] = {}
        self.draws = True
        """Whether it has chance; known once it is compiled."""
        self.warm()

    def warm(self, *, lens: bool = False) -> None:
        """Compiles it, and computes once.

        Args:
            lens: For cameras with lenses instead of pinholes.
        """
        obs = blank(self.candidate.policy.spec, lens=lens)
        if len(self.candidate.policy.prompts) > 1:
            obs["instruction"] = np.zeros((), np.int32)
        self.chunks([Question(obs)])

    def together(self, asked: Sequence[Question]) -> list[int]:
        """Which of what was asked can be computed together with the first, that one included.

        Args:
            asked: In order of arrival.
        """
        first, chosen, rows = asked[0], [], set[int]()
        for i, one in enumerate(asked):
            if ("distortion" in one.obs) != ("distortion" in first.obs):
                continue
            if one.row in rows or (self.draws and one.call != first.call):
                continue
            rows.add(one.row)
            chosen.append(i)
        return chosen

    def chunks(self, asked: Sequence[Question]) -> list[np.ndarray]:
        """Chunks float32 [T, A] for what can be computed together.

        Args:
            asked: Each in a row of its own.
        """
        first = asked[0]
        rows = [first.obs] * self.width
        for one in asked:
            rows[one.row] = one.obs
        obs = {name: np.stack([row[name] for row in rows]) for name in first.obs}
        key = jax.random.fold_in(self._root, first.call) if self.draws else self._root
        program = self._program(obs, key)
        chunks = np.asarray(program(self._params, obs, key))
        return [chunks[one.row] for one in asked]

    def _program(self, obs: dict[str, np.ndarray], key: jax.Array) -> Any:
        has_lens = "distortion" in obs
        if has_lens not in self._programs:
            traced = jax.jit(self.candidate.policy.act).trace(self._params, obs, key)
            program = traced.jaxpr.jaxpr
            used = {id(x) for eqn in program.eqns for x in eqn.invars}
            self.draws = id(program.invars[-1]) in used
            self._programs[has_lens] = traced.lower().compile()
        return self._programs[has_lens]


def blank(spec: PolicySpec, *, lens: bool = False) -> dict[str, np.ndarray]:
    """An observation of nothing, without the batch axis.

    Args:
        spec: Sizes.
        lens: With lenses, which are pinholes.
    """
    side = float(max(spec.height, spec.width))
    K = np.array([[side, 0, spec.width / 2], [0, side, spec.height / 2], [0, 0, 1]], np.float32)
    obs = {
        "image": np.zeros((spec.views, spec.height, spec.width, 3), np.uint8),
        "K": np.broadcast_to(K, (spec.views, 3, 3)),
        "base_from_camera": np.broadcast_to(np.eye(4, dtype=np.float32), (spec.views, 4, 4)),
        "proprio": np.zeros(spec.proprio_dim, np.float32),
    }
    if lens:
        obs["distortion"] = np.zeros((spec.views, 9), np.float32)
    return observation_of([obs] * spec.obs_steps)


def observation_of(moments: Sequence[Shown]) -> dict[str, np.ndarray]:
    """Moments, oldest first, as a policy takes them: one alone has no axis of its own."""
    if len(moments) == 1:
        return dict(moments[0])
    names = {name for moment in moments for name in moment}
    pinhole = np.zeros((len(moments[0]["K"]), 9), np.float32)
    return {
        name: np.stack([moment.get(name, pinhole) for moment in moments]) for name in sorted(names)
    }


def load_run(folder: Path, step: int | None = None) -> tuple[TrainConfig, Candidate]:
    """The settings that a run was trained with, and its policy.

    Args:
        folder: Of the run.
        step: Checkpoint; None is the newest whole one.

    Raises:
        CheckpointError: There is none, or it is damaged.
        ConfigError: The folder's settings are not those of its checkpoints, or its policy wants to
            be told what requests do not say.
    """
    inputs = load_policy_inputs(folder, step)
    config = inputs.config
    unusual = [f"{k} {getattr(config, k)}" for k in ("ray_frame", "rays_from")
               if config.given(k)]  # fmt: skip
    if unusual and config.conditioning != "none":
        raise ConfigError(
            f"{folder} was trained with {' and '.join(unusual)}. Requests tell of cameras in the "
            "base, with their own intrinsics, and neither where that frame is nor what is usual: "
            "serve a policy of --ray-frame base and --rays-from true."
        )
    policy = rebuild_policy(inputs)
    return inputs.config, Candidate(policy, inputs.params, folder, inputs.step)
