"""Where cameras are put: pose sampling, the paper's camera schedule, and pose noise."""
# JAX's own annotations are partial.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType, ModuleType

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import CameraError, ConfigError
from jaxcam.rays._arrays import (
    Array,
    array_namespace,
    as_float,
    check_size,
    is_concrete,
    matmul,
    rigid,
)
from jaxcam.rays._checks import LARGEST, check_pose
from jaxcam.rays.rotations import matrix_from_rotvec

Interval = tuple[float, float]


@dataclass(frozen=True)
class PoseRanges:
    """A region of cameras around a scene, uniform in each coordinate.

    A camera sits at `centre + distance * (cos e cos a, cos e sin a, sin e)` and looks, without
    roll, at a point of the look-at box. Angles in radians, lengths in metres.

    Attributes:
        azimuth: Intervals of the angle a about z, measured from x.
        elevation: Interval of the angle e above the horizon.
        distance: Interval of the distance to `centre`.
        look_at: Box of the point looked at, three intervals relative to `centre`.
        centre: What the cameras surround.
        pick_interval: How several azimuth intervals of one length are drawn: an integer picks one
            (true), or one number runs through all of them (false). Same distribution; both exist
            because released pose sets were drawn either way.

    Raises:
        ConfigError: If there is no such region.
    """

    azimuth: tuple[Interval, ...]
    elevation: Interval
    distance: Interval
    look_at: tuple[Interval, Interval, Interval]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pick_interval: bool = False

    def __post_init__(self) -> None:
        intervals = [*self.azimuth, self.elevation, self.distance, *self.look_at]
        numbers = np.array([*np.ravel(intervals), *self.centre], np.float64)
        if not (np.abs(numbers) <= LARGEST).all():
            raise ConfigError(
                f"pose ranges: expected finite numbers up to {LARGEST:g}, got {self}."
            )
        for low, high in intervals:
            if not low <= high:
                raise ConfigError(f"pose ranges: interval ({low:g}, {high:g}) is empty.")
        if not self.azimuth:
            raise ConfigError("pose ranges: at least one azimuth interval is needed.")
        if any(a[1] > b[0] for a, b in pairwise(self.azimuth)):
            raise ConfigError("pose ranges: azimuth intervals must be sorted and not overlap.")
        if self.distance[0] <= 0:
            raise ConfigError(f"pose ranges: distance must be positive, got {self.distance[0]:g}.")
        if max(map(abs, self.elevation)) > np.pi / 2:
            raise ConfigError("pose ranges: elevation must lie in ±pi/2 radians (not degrees).")


def _degrees(*pairs: Interval) -> tuple[Interval, ...]:
    return tuple((float(np.deg2rad(low)), float(np.deg2rad(high))) for low, high in pairs)


_UP = _degrees((30, 60))[0]
_HALF = _degrees((-90, 90))
_CUBE = ((-0.15, 0.15), (-0.15, 0.15), (-0.15, 0.15))
_TABLE = (0.0, 0.0, 0.8)
_PUSH = ((-0.2, 0.0), (-0.1, 0.1), (-0.2, 0.0))
_LIFT = ((-0.2, 0.0), (-0.1, 0.1), (-0.1, 0.1))
_POINT = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
_SEPARATED_TRAIN = _degrees((-120, -90), (-60, -30), (0, 30), (60, 90))
_SEPARATED_TEST = _degrees((-90, -60), (-30, 0), (30, 60), (90, 120))
_ROLL = _degrees((0, 80), (100, 180))

POSE_RANGES = MappingProxyType(
    {
        "robosuite": PoseRanges(_HALF, _UP, (0.7, 1.2), _CUBE, _TABLE),
        "robosuite_separated_train": PoseRanges(
            _SEPARATED_TRAIN, _UP, (0.7, 1.2), _CUBE, _TABLE, pick_interval=True
        ),
        "robosuite_separated_test": PoseRanges(
            _SEPARATED_TEST, _UP, (0.7, 1.2), _CUBE, _TABLE, pick_interval=True
        ),
        "maniskill_push": PoseRanges(_HALF, _UP, (0.45, 0.7), _PUSH),
        "maniskill_lift_upright": PoseRanges(_HALF, _UP, (0.45, 0.7), _LIFT),
        "maniskill_roll_ball": PoseRanges(_ROLL, _UP, (0.6, 0.7), _POINT, (-0.1, 0.5, 0.0)),
    }
)
"""The paper's regions by name. The authors' robosuite sets are seed 1 (1000 training poses) and
seed 23 (100 test poses) of "robosuite", and seed 42 (500 each) of the separated ones."""


def look_at(position: Array, target: Array, up: Array = (0.0, 0.0, 1.0)) -> Array:
    """Pose of a camera at one point that looks at another, without roll.

    Args:
        position: Camera centre, `[..., 3]`.
        target: Point in the middle of the image, `[..., 3]`.
        up: Direction that points up in the image.

    Returns:
        `world_from_camera` `[..., 4, 4]` in OpenCV axes.

    Raises:
        CameraError: If the view is undefined, or a number is larger than a camera's may be.
    """
    for what, values in (("position", position), ("target", target), ("up", up)):
        check_size(f"look_at: {what}", values, LARGEST)
    xp = array_namespace(position, target)
    position, target = as_float(position, xp), as_float(target, xp)
    forward = target - position
    forward = forward / xp.linalg.norm(forward, axis=-1, keepdims=True)
    right = xp.cross(forward, xp.asarray(up, forward.dtype))
    length = xp.linalg.norm(right, axis=-1, keepdims=True)
    if is_concrete(length) and not (np.asarray(length) > 1e-6).all():
        raise CameraError(
            "look_at: the viewing direction is undefined or parallel to `up`. Likely cause: a "
            "camera straight above its target (give another `up`), or at the target."
        )
    right = right / length
    down = xp.cross(forward, right)
    return rigid(xp.stack([right, down, forward], axis=-1), position)


def sample_poses(ranges: PoseRanges, count: int, seed: int) -> np.ndarray:
    """Draw camera poses; the same seed gives the same poses on every machine.

    Draws from NumPy's legacy generator in the order of the authors' code, so that
    `sample_poses(POSE_RANGES["robosuite"], 1000, seed=1)` are their released training poses and
    `seed=23` their 100 test poses. Theirs are stored in OpenGL axes: `opengl_from_opencv` of these.

    Args:
        ranges: Where cameras may be.
        count: How many.
        seed: Of the generator.

    Returns:
        `world_from_camera` `[count, 4, 4]` in OpenCV axes, float64.
    """
    rng = np.random.RandomState(seed)
    rest = (ranges.elevation, ranges.distance, *ranges.look_at)
    draws = [
        [_draw_azimuth(rng, ranges), *(rng.uniform(*interval) for interval in rest)]
        for _ in range(count)
    ]
    azimuth, elevation, distance, *offset = np.array(draws).reshape(count, 6).T
    direction = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    )
    centre = np.array(ranges.centre)
    return look_at(centre + distance[:, None] * direction, centre + np.stack(offset, axis=-1))


def _draw_azimuth(rng: np.random.RandomState, ranges: PoseRanges) -> float:
    intervals = ranges.azimuth
    if ranges.pick_interval:
        return rng.uniform(*intervals[rng.randint(len(intervals))])
    start = intervals[0][0]
    azimuth = rng.uniform(start, start + sum(high - low for low, high in intervals))
    for (_, end), (begin, _) in pairwise(intervals):
        if azimuth >= end:
            azimuth += begin - end
    return azimuth


def spherical(world_from_camera: Array, centre: Array) -> tuple[Array, Array, Array]:
    """Azimuth, elevation (radians) and distance of cameras about a centre.

    The inverse of the sampler as far as the position goes; where the camera looks does not matter.

    Args:
        world_from_camera: `[..., 4, 4]`.
        centre: `[3]`, for example `ranges.centre`.

    Returns:
        Three arrays `[...]`: azimuth in (-pi, pi], elevation in ±pi/2, distance. Where an angle or
        distance has no derivative (on the axis, at the centre) it is zero.

    Raises:
        CameraError: If a number is larger than a camera's may be.
    """
    check_size("spherical: world_from_camera", world_from_camera, LARGEST)
    check_size("spherical: centre", centre, LARGEST)
    xp = array_namespace(world_from_camera, centre)
    pose = as_float(world_from_camera, xp)
    x, y, z = xp.moveaxis(pose[..., :3, 3] - xp.asarray(centre, pose.dtype), -1, 0)
    flat = _polar(xp.hypot, x, y, xp)
    return (
        _polar(xp.arctan2, y, x, xp),
        _polar(xp.arctan2, z, flat, xp),
        _polar(xp.hypot, flat, z, xp),
    )


def _polar(function: Callable[[Array, Array], Array], a: Array, b: Array, xp: ModuleType) -> Array:
    """A function of the plane, whose derivative is zero at the origin instead of undefined."""
    if xp is np:
        return function(a, b)
    # In float32 the squares of less than this vanish, and derivatives divide by them.
    near = jnp.maximum(jnp.abs(a), jnp.abs(b)) < 1e-15
    still = function(jax.lax.stop_gradient(a), jax.lax.stop_gradient(b))
    return jnp.where(near, still, function(jnp.where(near, 1, a), jnp.where(near, 1, b)))


def stair(demos: int, n: int, m: int) -> np.ndarray:
    """The paper's camera schedule: demonstration i may use cameras m·i … m·i + n - 1.

    m = 0 shares n cameras among all demonstrations, m = n gives each its own.

    Args:
        demos: Number of demonstrations.
        n: Cameras of one demonstration.
        m: How far the window moves from one demonstration to the next.

    Returns:
        Camera indices, int64 `[demos, n]`; `stair_cameras` says how many cameras that takes.
    """
    _check_stair(demos, n, m)
    return m * np.arange(demos)[:, None] + np.arange(n)


def stair_cameras(demos: int, n: int, m: int) -> int:
    """Number of cameras `stair(demos, n, m)` needs: 202 for 200 demonstrations, n = 3, m = 1."""
    _check_stair(demos, n, m)
    return m * (demos - 1) + n


def _check_stair(demos: int, n: int, m: int) -> None:
    if not (demos >= 1 and n >= 1 and n >= m >= 0):
        raise ConfigError(
            f"camera schedule: expected demos >= 1 and n >= m >= 0 with n >= 1, got demos {demos}, "
            f"n {n}, m {m}."
        )


def perturb(
    world_from_camera: Array, key: jax.Array, rotation: Array = 0.0, translation: Array = 0.0
) -> jax.Array:
    """Pose noise of an exact size in a random direction, as a calibration error of known size.

    Args:
        world_from_camera: `[..., 4, 4]`.
        key: Random key.
        rotation: Angle in radians by which each camera turns about a random axis through its
            centre, a number or `[...]`.
        translation: Distance in metres by which each centre moves, likewise.

    Returns:
        Perturbed poses, float32 `[..., 4, 4]`.

    Raises:
        CameraError: If a pose is impossible, or a number too large.
    """
    if is_concrete(world_from_camera):
        check_pose("pose", np.asarray(world_from_camera))
    check_size("perturb: rotation", rotation, LARGEST)
    check_size("perturb: translation", translation, LARGEST)
    pose = jnp.asarray(world_from_camera, jnp.float32)
    axis_key, direction_key = jax.random.split(key)
    axis = _unit(axis_key, pose.shape[:-2])
    direction = _unit(direction_key, pose.shape[:-2])
    angle = jnp.asarray(rotation, jnp.float32)[..., None]
    turned = matmul(pose[..., :3, :3], matrix_from_rotvec(angle * axis))
    moved = pose[..., :3, 3] + jnp.asarray(translation, jnp.float32)[..., None] * direction
    return rigid(turned, moved)


def _unit(key: jax.Array, batch: tuple[int, ...]) -> jax.Array:
    v = jax.random.normal(key, (*batch, 3), jnp.float32)
    return v / jnp.linalg.norm(v, axis=-1, keepdims=True)
