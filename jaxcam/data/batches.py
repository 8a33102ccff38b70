"""Training batches as a pure function of (seed, step, shard), and the statistics of normalisation.

No iterator holds state: `Samples.index(seed, step)` names the samples of a step and a shard is a
stretch of them, so a resumed run, another prefetch depth or other machines see the same batches.
"""

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxcam.config.names import RayFrame
from jaxcam.config.sizes import size_name
from jaxcam.config.train import TrainConfig
from jaxcam.data.demos import Demo, Demos
from jaxcam.data.pictures import Pictures
from jaxcam.data.samples import Samples, errors_of, history
from jaxcam.models.action_frame import seen_actions, seen_points
from jaxcam.models.normalization import STD_FLOOR
from jaxcam.models.policy import Batch
from jaxcam.rays import invert
from jaxcam.rays.rotations import rotvec_from_matrix
from jaxcam.sim.actions import encode, is_absolute, is_joint
from jaxcam.sim.ray_frames import frame_from_base, grip_in_base, in_ray_frame
from jaxcam.sim.world import World

PREFETCH = 4
"""Calls' worth of batches made ready ahead by a thread."""
MANY_STEPS = 50_000
"""Control steps of a dataset from which on its statistics are summed in float64. Sums in float32
are off in the fourth digit by a million; below, statistics stay what runs were begun with."""
_IN_FINGERPRINTS = {"eef_abs": "eef_abs_nominal", "eef_abs_world": "eef_abs"}
"""Spaces whose name in fingerprints is another: `eef_abs` is that of version 0.1.0 there."""


@dataclass(frozen=True)
class ActionAxes:
    """What it takes to say actions as a camera sees them."""

    base_from_actions: np.ndarray = field(repr=False)
    """The frame that they are in [4, 4]."""
    absolute: bool
    """Whether they are grip poses, rather than what these move by."""
    views: int
    """Cameras of a sample; the first one is whose frame it is."""


@dataclass(frozen=True)
class Dataset:
    """Demonstrations as the arrays that batches are cut from."""

    pictures: Pictures = field(repr=False)
    K: np.ndarray = field(repr=False)
    """Intrinsics of all cameras, in pixels of the pictures [N, 3, 3]."""
    base_from_camera: np.ndarray = field(repr=False)
    """Their poses in the robot's base frame, OpenCV axes [N, 4, 4]."""
    actions: np.ndarray = field(repr=False)
    """Actions of every demonstration, zeros past its end [D, T, A]."""
    proprio: np.ndarray = field(repr=False)
    """What the robot feels before each action [D, T, P]."""
    windows: list[np.ndarray] = field(repr=False)
    """Cameras that see each demonstration [n], or each of its steps [T, n] where one moves."""
    train: int
    """Number of training demonstrations; the rest are for validation."""
    fingerprint: str
    """Hash of the demonstrations and the pictures."""
    keyframes: np.ndarray | None = field(default=None, repr=False)
    """Where the grip is when its command next changes (base frame, m), per action [D, T, 3]; None
    where nobody says where the grip is."""
    distortion: np.ndarray | None = field(default=None, repr=False)
    """Lenses of all cameras, see `jaxcam.rays.lens.pack` [N, 9]; None where all are pinholes."""
    instruction: np.ndarray | None = field(default=None, repr=False)
    """What is asked in each demonstration, by its number among the prompts [D]; None where it is
    the same in all."""
    axes: ActionAxes | None = None
    """How cameras see the actions, where policies predict them so: statistics are then of that."""
    ray_frames: np.ndarray | None = field(default=None, repr=False)
    """Before each action, the frame that policies are told their cameras in, from the base
    [D, T, 4, 4]; None is the base."""
    errors: np.ndarray | None = field(default=None, repr=False)
    """Which actions err on purpose, bool [D, T]: chunks have them, and what follows them, as
    padding; None if none does."""
    keyframe_errors: np.ndarray | None = field(default=None, repr=False)
    """Where the grip's command next changes by error, so that nobody knows the keyframe, [D, T]."""
    named: bool = False
    """Whether batches say of what they are: `demo` [B], and `camera` [B, V], the row of each view's
    first picture; errors of calibrations go by these."""
    ordered: bool = False
    """Whether the cameras of a sample stand in the order of their window, as cameras do that have
    names, or in any, as the paper's, which differ in nothing but their pose."""

    @property
    def lengths(self) -> np.ndarray:
        """Control steps of each demonstration [D]."""
        return self.pictures.layout.lengths

    @cached_property
    def samples(self) -> Samples:
        """Which of its samples a run takes."""
        return Samples(self.pictures.layout, self.train, self.ordered, self.errors)

    def stats(self) -> dict[str, np.ndarray]:
        """Statistics of the training demonstrations, float32; population std as the authors'."""
        real = np.arange(self.actions.shape[1]) < self.lengths[: self.train, None]
        stats = {}
        for name, of_all in self._targets({"proprio": self.proprio}).items():
            values = of_all[: self.train][real]
            if self.axes and name != "proprio":
                values = self._seen(self.axes, name, of_all)
            kind = np.float64 if len(values) > MANY_STEPS else values.dtype
            stats[f"{name}_mean"] = values.mean(0, dtype=kind)
            stats[f"{name}_std"] = np.maximum(values.std(0, dtype=kind), STD_FLOOR)
            stats[f"{name}_min"], stats[f"{name}_max"] = values.min(0), values.max(0)
        return {k: v.astype(np.float32) for k, v in stats.items()}

    def batch(
        self, demo: np.ndarray, t: np.ndarray, views: np.ndarray, chunk: int, obs_steps: int = 1
    ) -> Batch:
        """The samples of step `t` [B] of `demo` [B], seen by cameras `views` [B, V].

        With more than one observation step S, observations are of the S steps up to `t`, as a
        second axis (the first one repeated before the start), and chunks begin at the oldest.
        """
        steps = t[:, None] + np.arange(chunk) - (obs_steps - 1)
        is_pad = (steps < 0) | (steps >= self.lengths[demo][:, None])
        where = demo[:, None], np.clip(steps, 0, self.actions.shape[1] - 1)
        if self.errors is not None:
            err = self.errors[where]
            # What follows an error that is yet to come nobody can foresee.
            is_pad |= err | np.logical_or.accumulate(err & (steps > t[:, None]), 1)
        times = history(t, obs_steps)
        rows = self.pictures.layout.at(demo[:, None, None], times[..., None], views[:, None])
        cameras = np.stack([self._cameras(*x) for x in zip(demo, times, views, strict=True)])
        observed = {
            "image": self.pictures.rgb[rows],
            "K": self.K[cameras],
            "base_from_camera": self.base_from_camera[cameras],
            "proprio": self.proprio[demo[:, None], times],
        }
        if self.ray_frames is not None:
            of_steps = self.ray_frames[demo[:, None], times][:, :, None]
            observed["base_from_camera"] = in_ray_frame(observed["base_from_camera"], of_steps)
        if self.distortion is not None:
            observed["distortion"] = self.distortion[cameras]
        if obs_steps == 1:
            observed = {name: values[:, 0] for name, values in observed.items()}
        if self.named:
            first = np.zeros(1, int)
            rows = [self._cameras(d, first, v)[0] for d, v in zip(demo, views, strict=True)]
            observed |= {"demo": demo.astype(np.int32), "camera": np.array(rows, np.int32)}
        if self.instruction is not None:
            observed["instruction"] = self.instruction[demo]
        targets = {
            name: np.where(is_pad[..., None], 0, of_all[where])
            for name, of_all in self._targets({}).items()
        }
        if self.keyframe_errors is not None:
            observed["keyframe_is_pad"] = is_pad | self.keyframe_errors[where]
        return {**observed, **targets, "is_pad": is_pad}

    def _cameras(self, demo: int, times: np.ndarray, views: np.ndarray) -> np.ndarray:
        """The cameras [S, V] of views [V] of a demonstration at some times [S]."""
        window = self.windows[demo]
        return (
            window[times][:, views]
            if window.ndim == 2
            else window[views][None].repeat(len(times), 0)
        )

    def _seen(self, axes: ActionAxes, name: str, of_all: np.ndarray) -> np.ndarray:
        """Targets [D, T, A] of the training demonstrations as each camera sees them [N, A]."""
        parts = []
        for demo, length in enumerate(self.lengths[: self.train]):
            window = self.windows[demo]
            # In their order, the last cameras are never the first of a sample.
            first = window[..., : window.shape[-1] - axes.views + 1] if self.ordered else window
            pose = invert(self.base_from_camera[first])
            # A camera that stands sees all steps, [n, 4, 4]; one that moves its own, [T, n, 4, 4].
            values = of_all[demo, None, :length]
            values = values if window.ndim == 1 else values[0][:, None, None]
            if name == "keyframe":
                values = seen_points(values, pose)
            else:
                values = seen_actions(values, pose @ axes.base_from_actions, absolute=axes.absolute)
            parts.append(values.reshape(-1, values.shape[-1]).astype(np.float32))
        return np.concatenate(parts)

    def _targets(self, others: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What a policy predicts of all demonstrations, by name, and others beside it."""
        keyframes = {} if self.keyframes is None else {"keyframe": self.keyframes}
        return {"action": self.actions, **keyframes, **others}

    def validation(self, chunk: int, views: int, obs_steps: int = 1, per_demo: int = 16) -> Batch:
        """A fixed batch: evenly spaced steps of every validation demonstration."""
        return self.batch(*self.samples.validation(views, per_demo), chunk, obs_steps)


def make_dataset(
    demos: Demos,
    pictures: Pictures,
    space: str,
    scene: World,
    ray_frame: RayFrame = "base",
) -> Dataset:
    """Turns demonstrations into arrays, their commands into actions of a space.

    Args:
        demos: The dataset.
        pictures: Of it.
        space: Of the actions.
        scene: Where the demonstrations were given.
        ray_frame: In which frame policies are told their cameras.
    """
    longest = int(pictures.layout.lengths.max())
    actions, keyframes, proprio, ray_frames = [], [], [], []
    errors = errors_of(demos.episodes)
    for demo in demos.episodes:
        moves = demo_actions(demo, space, scene)
        state = scene.proprio(demo.qpos, demo.eef_pos)[:-1]
        pad = ((0, longest - demo.length), (0, 0))
        actions.append(np.pad(moves, pad))
        keyframes.append(np.pad(_keyframes(demo, scene), pad))
        proprio.append(np.pad(state, pad))
        if ray_frame != "base":
            grip = demo.world_from_grip()[:-1]
            local = grip_in_base(scene.world_from_base, grip[:, :3, 3], grip[:, :3, :3])
            moves_on = ((0, longest - demo.length), (0, 0), (0, 0))
            ray_frames.append(np.pad(frame_from_base(ray_frame, scene, *local), moves_on, "edge"))
    cameras = invert(scene.world_from_base) @ demos.header.world_from_camera
    height, width = pictures.rgb.shape[1:3]
    lenses = demos.header.distortion
    return Dataset(
        pictures=pictures,
        K=demos.header.intrinsics(height, width).astype(np.float32),
        base_from_camera=cameras.astype(np.float32),
        actions=np.stack(actions).astype(np.float32),
        keyframes=np.stack(keyframes).astype(np.float32),
        proprio=np.stack(proprio).astype(np.float32),
        distortion=None if lenses is None else lenses.astype(np.float32),
        windows=[d.cameras for d in demos.episodes],
        errors=errors,
        keyframe_errors=None
        if errors is None
        else keyframe_errors(errors, [_next_changes(demo) for demo in demos.episodes]),
        ray_frames=np.stack(ray_frames) if ray_frames else None,
        train=len(demos.train),
        fingerprint=f"{demos.fingerprint}-{size_name(height, width)}px-"
        f"{_IN_FINGERPRINTS.get(space, space)}",
    )


def seen_by_cameras(
    dataset: Dataset, config: TrainConfig, base_from_actions: np.ndarray
) -> Dataset:
    """The dataset with statistics of actions in the frame that a run's policy predicts them in.

    Args:
        dataset: Whose actions are in the run's action space.
        config: The run's settings.
        base_from_actions: The frame that those are in [4, 4].
    """
    if config.action_frame == "base":
        return dataset
    axes = ActionAxes(base_from_actions, is_absolute(config.action_space), config.views)
    return replace(dataset, axes=axes)


def demo_actions(demo: Demo, space: str, scene: World) -> np.ndarray:
    """A demonstration's commands as actions [T, A] of a space.

    Joint targets are the joints reached after each step (authors' code), led by their velocity
    times the controller's lag, so that the arm is where it was when the gripper was commanded.
    """
    gripper = demo.actions[:, -1]
    if is_joint(space):
        qpos, qvel = demo.qpos[:, scene.arm], demo.qvel[:, scene.arm]
        targets = qpos[1:] + scene.joint_lag * qvel[1:]
        return encode(space, targets, gripper, qpos[0], scene.nominal_grip)
    grip = demo.world_from_grip()[0]
    start = np.concatenate([grip[:3, 3], rotvec_from_matrix(grip[:3, :3])])
    return encode(space, demo.actions[:, :-1], gripper, start, scene.nominal_grip)


def _keyframes(demo: Demo, scene: World) -> np.ndarray:
    """Where the grip is when its command next changes, or at the end [T, 3], base frame."""
    world = demo.eef_pos[_next_changes(demo)]
    return (world - scene.world_from_base[:3, 3]) @ scene.world_from_base[:3, :3]


def keyframe_errors(errors: np.ndarray, changes: Sequence[np.ndarray]) -> np.ndarray:
    """Where the gripper's command next changes by error, so that nobody knows the keyframe.

    Args:
        errors: Which actions err on purpose, bool [D, T].
        changes: Of each demonstration the step of that change, or its length, [its T].

    Returns:
        Bool [D, T].
    """
    by_error = np.zeros_like(errors)
    for row, own, step in zip(by_error, errors, changes, strict=True):
        row[: len(step)] = np.append(own[: len(step)], False)[step]
    return by_error


def _next_changes(demo: Demo) -> np.ndarray:
    """The step at which the gripper's command next changes, or the last state's, [T]."""
    gripper = np.sign(demo.actions[:, -1])
    changes = np.append(np.flatnonzero(np.diff(gripper)) + 1, demo.length)
    return changes[np.searchsorted(changes, np.arange(demo.length), side="right")]


def stacked_batches(
    dataset: Dataset,
    seed: int,
    first: int,
    last: int,
    per_call: int,
    batch: int,
    shard: tuple[int, int] = (0, 1),
    **sizes: int,
) -> Generator[tuple[int, Batch], None, None]:
    """Batches of steps `first` to `last`, `per_call` stacked for each compiled call.

    A thread reads ahead; it only makes what `index` names.

    Args:
        dataset: Where samples come from.
        seed: Of the order.
        first: Step to begin with.
        last: Step to stop before.
        per_call: Steps stacked on the first axis.
        batch: Samples a step, of all shards.
        shard: Which of how many equal shards is read.
        **sizes: `views`, `chunk` and, if there are several, `obs_steps`.
    """
    views, chunk, obs_steps = sizes["views"], sizes["chunk"], sizes.get("obs_steps", 1)
    number, shards = shard
    own = slice(number * batch // shards, (number + 1) * batch // shards)

    def make(step: int) -> Batch:
        names = (dataset.samples.index(seed, step + k, batch, views) for k in range(per_call))
        parts = [
            dataset.batch(demo[own], t[own], cameras[own], chunk, obs_steps)
            for demo, t, cameras in names
        ]
        return {key: np.stack([p[key] for p in parts]) for key in parts[0]}

    steps = range(first, last, per_call)
    with ThreadPoolExecutor(1) as pool:
        ahead = {s: pool.submit(make, s) for s in steps[:PREFETCH]}
        for i, step in enumerate(steps):
            ready = ahead.pop(step).result()
            if i + PREFETCH < len(steps):
                ahead[steps[i + PREFETCH]] = pool.submit(make, steps[i + PREFETCH])
            yield step, ready
