"""Rollouts of a policy on held-out pairs: the simulator of a task, and a row for each rollout."""

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np
from jax.sharding import Mesh
from jax.tree_util import Partial

from jaxcam.config.conditions import Conditions, of_task
from jaxcam.config.names import RayFrame, RaysFrom, Rotations, SceneName
from jaxcam.config.sizes import rows_and_columns
from jaxcam.data.pairs import Pairs, make_pairs
from jaxcam.devices import copied, data_mesh, spread
from jaxcam.evaluation.conditions import ConditionedPairs
from jaxcam.files.paths import absolute
from jaxcam.models import Policy
from jaxcam.models.policy import CAMERA_INPUTS
from jaxcam.rays import Camera, spherical
from jaxcam.results.rows import Row, Status
from jaxcam.runs.rollouts import weights_digest
from jaxcam.sim import engine_name, make_engine, make_painter, make_task
from jaxcam.sim.actions import controller_of, space_of
from jaxcam.sim.observing import Instant, cameras_of, observe
from jaxcam.sim.rollout import Agent, Episodes, Rollouts, rollout
from jaxcam.sim.types import View
from jaxcam.training.digests import describe, flatten

VIDEO_PIXELS = 160
VIDEO_STRIDE = 2
"""Control steps per picture of a video."""


class Setting(Protocol):
    """What an evaluation has to know of whom it evaluates; a run's `TrainConfig` says it."""

    @property
    def task(self) -> str:
        """Name of the task."""
        ...

    @property
    def scene(self) -> SceneName:
        """Which of its scenes."""
        ...

    @property
    def policy(self) -> str:
        """Kind of policy, or the name of a foreign one."""
        ...

    @property
    def conditioning(self) -> str:
        """How the policy is given its camera."""
        ...

    @property
    def seed(self) -> int | None:
        """Of the training; None where nobody says."""
        ...

    @property
    def views(self) -> int:
        """Cameras that the policy sees at once."""
        ...

    @property
    def resolution(self) -> int | str:
        """Size of the pictures, see `jaxcam.config.sizes`."""
        ...

    @property
    def action_space(self) -> str:
        """What the policy's actions mean."""
        ...

    @property
    def rotations(self) -> Rotations:
        """What the rotation vectors of eef_abs are counted from."""
        ...

    @property
    def rays_from(self) -> RaysFrom:
        """Which intrinsics the policy is told."""
        ...

    @property
    def ray_frame(self) -> RayFrame:
        """In which frame the policy is told its cameras."""
        ...

    @property
    def engine(self) -> str:
        """What simulates, where the evaluation is not told."""
        ...

    @property
    def ensemble(self) -> float:
        """Rate of temporal ensembling, where the evaluation is not told."""
        ...


class Evaluated(Protocol):
    """Who is evaluated: the policy of a checkpoint, or a foreign one."""

    @property
    def folder(self) -> Path:
        """Where its rows go: of the run."""
        ...

    @property
    def step(self) -> int:
        """Updates of the checkpoint; 0 of a foreign policy."""
        ...

    @property
    def weights_sha(self) -> str:
        """Digest of what acts, which ties rows to it."""
        ...

    def acting(self, evaluator: "Evaluator") -> AbstractContextManager[Agent]:
        """The policy as the rollouts of one batch ask it."""
        ...


@dataclass(frozen=True)
class Candidate:
    """A checkpoint whose policy is evaluated.

    Attributes:
        policy: The policy.
        params: Its parameters.
        folder: Of the run.
        step: Updates of the checkpoint.
    """

    policy: Policy
    params: Any
    folder: Path
    step: int

    @property
    def weights_sha(self) -> str:
        """Digest of the parameters, which ties rows to them."""
        return self._digest

    @functools.cached_property
    def _digest(self) -> str:
        return weights_digest({name: describe(x) for name, x in flatten(self.params).items()})

    @contextlib.contextmanager
    def acting(self, evaluator: "Evaluator") -> Iterator[Agent]:
        """The policy as the rollouts of one batch ask it."""
        spec, rate = self.policy.spec, evaluator.ensemble
        ahead = spec.chunk - spec.obs_steps + 1  # steps that a chunk reaches into the future
        yield Agent(
            self._call(evaluator),
            evaluator.space,
            execute=ahead if rate else self.policy.execute,
            obs_steps=spec.obs_steps,
            ensembling=rate,
            ray_frame=evaluator.config.ray_frame,
        )

    def _call(self, evaluator: "Evaluator") -> Partial:
        """The policy as rollouts call it."""
        mesh, params = None, self.params
        if not evaluator.engine_name.startswith("mjx"):  # those are one program, on one device
            mesh = data_mesh(evaluator.width, everywhere=False)
            params = copied(mesh, params)
        root = jax.random.key(evaluator.config.seed or 0)
        return Partial(Acting(self.policy.act, mesh), params, root)


class Evaluator:
    """Runs pairs of one task, scene and action space; the compiled parts are made once.

    Args:
        config: Of the runs, or the foreign policy, that are evaluated.
        width: Rollouts simulated at once. Policies see batches of exactly this many, since the
            width can change a result's last digits; it is kept in each row.
        engine: That simulates them; `config.engine` when None.
        ensemble: Rate of temporal ensembling, 0 is off; `config.ensemble` when None.
        conditions: Under which the pairs are run.
        trained_on: Cameras that training saw [C, 4, 4], which the pairs of `train` need.
    """

    def __init__(
        self,
        config: Setting,
        width: int = 50,
        engine: str | None = None,
        ensemble: float | None = None,
        conditions: Conditions | None = None,
        trained_on: np.ndarray | None = None,
    ) -> None:
        self.config, self.width, self.trained_on = config, width, trained_on
        self.ensemble = config.ensemble if ensemble is None else ensemble
        self.task = make_task(config.task)
        self.task.require()
        self.conditions = of_task(conditions or Conditions(), self.task.fovy_deg)
        self.scene = self.task.scene(config.scene)
        self.engine_name = engine_name(engine or config.engine, self.scene)
        varied = self.task.varied
        controller = controller_of(config.action_space)
        self.engine = make_engine(self.engine_name, self.scene, controller, varied)
        self.size = rows_and_columns(config.resolution)
        self.renderer = make_painter(
            self.scene,
            *self.size,
            varied=varied,
            engine=self.engine_name,
            lenses=bool(self.conditions.lens),
        )
        known = None if trained_on is None else len(trained_on)
        self._seen = ConditionedPairs(
            self.task, self.scene, self.conditions, config.rays_from, known
        ).seen

    def run(
        self,
        candidate: Evaluated,
        split: str,
        pairs: Sequence[int],
        tick: Callable[[], None] = lambda: None,
    ) -> tuple[list[Row], Rollouts]:
        """Runs at most `width` pairs at once.

        Args:
            candidate: Who acts.
            split: Which pairs: `test`, `validation` or `train`.
            pairs: Their numbers.
            tick: Called after every control step.

        Returns:
            One row per pair, and the rollouts.
        """
        # Always worlds for `width`: neither policy nor compiled physics sees another size.
        filled = [*pairs, *[pairs[-1]] * (self.width - len(pairs))]
        chosen = self.pairs(split, filled)
        sight = self._seen(chosen, split, filled, self.size)
        episodes = Episodes(
            chosen.start,
            K=sight.K,
            world_from_camera=chosen.cameras,
            alive=np.arange(self.width) < len(pairs),
            lens=sight.lens,
            claimed=sight.claimed,
        )
        with candidate.acting(self) as agent:
            done = rollout(agent, self.task, self.engine, self.renderer, episodes, tick)
        rows = self._rows(candidate, split, pairs, chosen, done, agent.causes)
        if sight.fovy_deg is not None:
            angles = map(float, sight.fovy_deg)
            rows = [replace(row, fovy_deg=fovy) for row, fovy in zip(rows, angles, strict=False)]
        return rows, done

    def _rows(
        self,
        candidate: Evaluated,
        split: str,
        pairs: Sequence[int],
        chosen: Pairs,
        done: Rollouts,
        causes: Mapping[int, str],
    ) -> list[Row]:
        """A row for each of the pairs; the batch may be longer."""
        config, cameras, digests = self.config, chosen.cameras, chosen.digests()
        azimuth, elevation, distance = (
            np.asarray(x) for x in spherical(cameras[:, 0], np.array(self.task.cameras.centre))
        )
        return [
            Row(
                task=config.task,
                scene=config.scene,
                run=absolute(candidate.folder).name,
                policy=config.policy,
                conditioning=config.conditioning,
                seed=config.seed,
                step=candidate.step,
                split=split,
                pair=pair,
                pair_sha=digests[i],
                weights_sha=candidate.weights_sha,
                success=success,
                status=status,
                steps=int(done.steps[i]),
                azimuth_deg=float(np.rad2deg(azimuth[i])),
                elevation_deg=float(np.rad2deg(elevation[i])),
                distance=float(distance[i]),
                camera=cameras[i].tolist(),
                renderer=self.renderer.look(),
                engine=self.engine_name,
                ensemble=self.ensemble,
                width=self.width,
                episode_seed=chosen.seeds[i],
                cause=causes.get(i) if status == "policy" else None,
                **self.conditions.said,
            )
            for i, pair in enumerate(pairs)
            for status, success in [_outcome(done, i)]
        ]

    @property
    def space(self) -> str:
        """Of the actions, see `jaxcam.sim.actions`."""
        return space_of(self.config.action_space, self.config.rotations)

    def clips(self, done: Rollouts, split: str, pairs: Sequence[int]) -> list[np.ndarray]:
        """Videos of rollouts as their first camera saw them, uint8 [T, H, W, 3] each."""
        chosen = self.pairs(split, pairs)
        start, sight = chosen.start, self._seen(chosen, split, pairs, (VIDEO_PIXELS, VIDEO_PIXELS))
        lenses = sight.lens is not None
        renderer = make_painter(self.scene, VIDEO_PIXELS, varied=self.task.varied, lenses=lenses)
        clips = []
        for i in range(len(pairs)):
            qpos = done.qpos[: done.steps[i] + 1 : VIDEO_STRIDE, i]
            several = (len(qpos), 1, 1)
            view = View(
                qpos=qpos,
                geom_size=np.tile(start.geom_size[i], several),
                fixtures=np.tile(start.fixtures[i], several),
                K=np.tile(sight.K[i, 0], several),
                world_from_camera=np.tile(chosen.cameras[i, 0], several),
                lens=None if sight.lens is None else np.tile(sight.lens[i, 0], several[:2]),
            )
            clips.append(renderer.rgb(view))
        return clips

    def sight(self, split: str, pair: int) -> tuple[np.ndarray, np.ndarray]:
        """What a policy is shown at a pair's start: picture uint8 [H, W, 3] and ray-map [H, W, 6].

        The rays are those of the first camera as the policy is told it: in its ray frame, and with
        the errors and the usual intrinsics where it is told these.
        """
        chosen = self.pairs(split, [pair])
        optics = self._seen(chosen, split, [pair], self.size)
        cameras = cameras_of(self.scene, optics.K, chosen.cameras, optics.lens, optics.claimed)
        engine = make_engine(None, self.scene, "osc_pose", self.task.varied)
        sensed = Instant.of(engine.reset(chosen.start), np.zeros(1))
        obs = observe(
            self.renderer, sensed, chosen.start, cameras, np.ones(1, bool), self.config.ray_frame
        )
        shown = {name: obs[name][0, 0] for name in CAMERA_INPUTS if name in obs}
        K, pose, lens = shown["K"], shown["base_from_camera"], shown.get("distortion")
        return shown["image"], np.asarray(Camera(K, pose, *self.size, lens).plucker())

    def pairs(self, split: str, numbers: Sequence[int]) -> Pairs:
        """The pairs of these numbers."""
        return make_pairs(self.task, self.scene, self.config.views, split, numbers, self.trained_on)


@dataclass(frozen=True)
class Acting:
    """A policy's `act` with chance of its own for every call."""

    act: Callable[..., jax.Array]
    mesh: Mesh | None = None
    """Devices that share the batch, if it comes from the host."""

    def __call__(
        self, params: Any, root: jax.Array, obs: Any, number: jax.Array, active: Any
    ) -> jax.Array:
        """Chunks [B, T, A] for a batch of observations; `number` is the call's, in its episode.

        All episodes are in the batch, whichever are active: it is of one size.
        """
        if self.mesh:
            obs = spread(self.mesh, obs)
        return jax.jit(self.act)(params, obs, jax.random.fold_in(root, number))


def _outcome(done: Rollouts, i: int) -> tuple[Status, bool | None]:
    """How a rollout ended, and its outcome; none where the simulator failed under a good policy."""
    if done.acted[i] and not done.ok[i]:
        return "simulator", None
    return ("ok" if done.acted[i] else "policy"), bool(done.success[i])
