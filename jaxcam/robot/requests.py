"""A request as the arrays that a policy is shown, or what is wrong with it.

Names of entries are LeRobot's (`observation.images.front`), with dots or, as openpi spells them,
with slashes. Every complaint says which entry, what was expected and what was got.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxcam.client import IMAGES, PROMPT, STATE
from jaxcam.data.recorded.fitting import fit
from jaxcam.data.recorded.parts import unknown
from jaxcam.errors import CameraError, PortError, closest
from jaxcam.models import PolicySpec
from jaxcam.rays import Camera
from jaxcam.rays.lens import PACKED
from jaxcam.robot.rig import FixedCamera, Rig
from jaxcam.runs.interface import Interface

LARGEST_SIDE = 4096
"""Of a picture (pixels)."""
MOST_CALLS = 2**31 - 1
MOST_NAMED = 10
"""Prompts that a complaint lists."""

Shown = Mapping[str, np.ndarray]
"""What a policy is shown of one moment: `image` uint8 [V, H, W, 3], `K` [V, 3, 3],
`base_from_camera` [V, 4, 4], `proprio` [P], and perhaps `distortion` [V, 9] and the number of what
is asked, `instruction`."""


@dataclass(frozen=True)
class Request:
    """What one request says."""

    moments: tuple[Shown, ...] = field(repr=False)
    """The moment now, or all that the policy sees at once, oldest first."""
    call: int | None
    """Number of the request in its episode, if it says so: what chance depends on."""
    row: int | None
    """Its row of the batch, if it says so: the last digits, and chance, depend on it."""


class RequestReader:
    """Reads requests for one policy.

    Args:
        interface: Names of what the policy is shown.
        spec: Sizes of that.
        width: Rows of a batch.
        needs_cameras: Whether the policy is told where its cameras are.
        rig: Cameras that stand.
        prompts: What it can be asked for; empty where it does not read.
    """

    def __init__(
        self,
        interface: Interface,
        spec: PolicySpec,
        *,
        width: int = 1,
        needs_cameras: bool = True,
        rig: Rig | None = None,
        prompts: Sequence[str] = (),
    ) -> None:
        self._views, self._spec, self._width = interface.views, spec, width
        self._needs_cameras, self._prompts = needs_cameras, [p.strip() for p in prompts]
        self._rig = rig or Rig({})
        self._state_names = interface.state_names
        names = [IMAGES + view for view in self._views] + [STATE, PROMPT, "call", "row"]
        names += [f"camera.{v}.{what}" for v in self._views for what in _CAMERA]
        self._known = {_dotted(name): name for name in names}
        self._expected = names

    def read(self, message: Any) -> Request:
        """The request in a message.

        Args:
            message: As `jaxcam.client.from_wire` gives it.

        Raises:
            PortError: An entry is missing or unknown, or has another type, shape or size.
            CameraError: A camera is impossible.
        """
        given = self._named(message)
        views = self._views_in(given)
        pictures = {view: self._pictures(IMAGES + view, given[IMAGES + view]) for view in views}
        state = self._numbers(STATE, given.get(STATE), (self._spec.proprio_dim,))
        shown = {IMAGES + view: p for view, p in pictures.items()} | {STATE: state}
        counts = {name: len(values) for name, values in shown.items()}
        if len(set(counts.values())) > 1:
            listed = ", ".join(f"{name} has {count}" for name, count in counts.items())
            raise PortError(
                f"Pictures and state: expected one moment, or {self._spec.obs_steps} of each; "
                f"{listed}."
            )
        cameras = {view: self._camera(view, given, pictures[view].shape[1:3]) for view in views}
        size = self._spec.height, self._spec.width
        moments = []
        for t in range(len(state)):
            each = [_seen(pictures[view][t], cameras[view].at(t), size) for view in views]
            moment = {name: np.stack([one[name] for one in each]) for name in each[0]}
            if not (self._needs_cameras and moment["distortion"].any()):
                del moment["distortion"]
            moments.append({**moment, "proprio": state[t]})
        asked = self._asked(given.get("prompt"))
        if len(self._prompts) > 1:
            moments = [{**moment, "instruction": asked} for moment in moments]
        call = _number("call", given.get("call"), MOST_CALLS)
        return Request(tuple(moments), call, _number("row", given.get("row"), self._width - 1))

    def _named(self, message: Any) -> dict[str, Any]:
        """The entries by their names with dots."""
        if not isinstance(message, dict):
            raise PortError(f"Expected entries by their names, got {type(message).__name__}.")
        given: dict[str, Any] = {}
        for key, value in message.items():
            name = self._known.get(_dotted(key)) if isinstance(key, str) else None
            if name is None:
                raise PortError(
                    f"Unknown entry {key!r:.80}{closest(str(key)[:80], self._expected)}."
                )
            if name in given:
                raise PortError(f"Entry {name} is there twice: with dots and with slashes.")
            given[name] = value
        return given

    def _views_in(self, given: Mapping[str, Any]) -> tuple[str, ...]:
        """The views of which there are pictures, in the policy's order."""
        views = tuple(view for view in self._views if IMAGES + view in given)
        names = [IMAGES + view for view in self._views]
        if len(views) != self._spec.views:
            which = "these" if len(names) == self._spec.views else f"{self._spec.views} of these"
            raise PortError(
                f"Pictures: expected {which}: {', '.join(names)}; got "
                f"{', '.join(IMAGES + view for view in views) or 'none'}."
            )
        for view in self._views:
            for what in _CAMERA:
                if view not in views and (name := f"camera.{view}.{what}") in given:
                    raise PortError(f"Entry {name}, but no {IMAGES}{view}: leave it out.")
        if STATE not in given:
            names = ", ".join(self._state_names)
            raise PortError(
                f"Entry {STATE} is missing: expected float32 [{len(self._state_names)}]: {names}."
            )
        return views

    def _pictures(self, name: str, value: Any) -> np.ndarray:
        """Pictures uint8 [1 or S, H, W, 3]."""
        steps = self._spec.obs_steps
        expected = "uint8 [rows, columns, 3]"
        if steps > 1:
            expected += f" or [{steps}, rows, columns, 3]"
        array = _array(name, value, expected)
        fits = array.dtype == np.uint8 and array.ndim in (3, 4) and array.shape[-1] == 3
        if not fits or (array.ndim == 4 and len(array) != steps) or not array.size:
            raise PortError(f"{name}: expected {expected}, got {_described(array)}.")
        if max(array.shape[-3:-1]) > LARGEST_SIDE:
            raise PortError(
                f"{name}: expected pictures of up to {LARGEST_SIDE} pixels a side, got "
                f"{_described(array)}. Send them smaller; K is for what is sent."
            )
        return array if array.ndim == 4 else array[None]

    def _numbers(self, name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
        """Finite numbers, float32 [1 or S, *shape]."""
        steps = self._spec.obs_steps
        expected = f"float32 {list(shape)}" + (f" or {[steps, *shape]}" if steps > 1 else "")
        array = _array(name, value, expected)
        is_stack = array.ndim == len(shape) + 1 and len(array) == steps
        if array.dtype.kind not in "fiu" or array.shape[int(is_stack) :] != shape:
            raise PortError(f"{name}: expected {expected}, got {_described(array)}.")
        with np.errstate(over="ignore"):
            array = array.astype(np.float32)
        if not np.isfinite(array).all():
            raise PortError(f"{name}: expected finite numbers, got {_some(array)}.")
        return array if is_stack else array[None]

    def _camera(self, view: str, given: Mapping[str, Any], size: tuple[int, int]) -> "_Camera":
        """Where the camera of a view is, and how it sees, by the request or by the rig."""
        standing = self._rig.cameras.get(view, FixedCamera())
        own = {
            what: self._numbers(name, given[name], shape)
            for what, shape in _CAMERA.items()
            if (name := f"camera.{view}.{what}") in given
        }
        K, pose = own.get("intrinsics"), own.get("base_from_camera")
        lens = own.get("distortion")
        if K is None and lens is not None:
            raise PortError(
                f"camera.{view}.distortion, but no camera.{view}.intrinsics: a lens and its K come "
                "together."
            )
        if K is None and standing.optics:
            K = standing.optics.at(*size, f"view '{view}'")[None]
            lens = standing.optics.distortion[None]
        if pose is None and standing.base_from_camera is not None:
            pose = standing.base_from_camera[None]
        lacks = [n for n, x in (("intrinsics", K), ("base_from_camera", pose)) if x is None]
        if lacks and self._needs_cameras:
            entries = " and ".join(f"camera.{view}.{what}" for what in lacks)
            raise PortError(
                f"Camera of view '{view}': expected {entries}, since the policy is told where its "
                "cameras are. Send them, or start the server with --cameras."
            )
        nobody = unknown(*size)
        camera = _Camera(
            nobody.K[None] if K is None else K,
            nobody.base_from_camera[None] if pose is None else pose,
            np.zeros((1, PACKED)) if lens is None else lens,
        )
        for t in range(max(map(len, (camera.K, camera.pose, camera.lens)))):
            _check(view, size, *(x.tobytes() for x in map(np.float64, camera.at(t))))
        return camera

    def _asked(self, prompt: Any) -> np.ndarray:
        """The number of what the policy is asked for."""
        if prompt is not None and not isinstance(prompt, str):
            raise PortError(f"prompt: expected text, got {type(prompt).__name__}.")
        known = self._prompts
        if not known or (prompt is None and len(known) == 1):
            return np.array(0, np.int32)
        if prompt is None or prompt.strip() not in known:
            said = "none" if prompt is None else f"{prompt!r:.200}"
            expected = ", ".join(f"{name!r:.200}" for name in known[:MOST_NAMED])
            more = f" and {len(known) - MOST_NAMED} more" if len(known) > MOST_NAMED else ""
            raise PortError(
                f"prompt: expected {'one of ' if len(known) > 1 else ''}{expected}{more}, which is "
                f"all that the policy has learned; got {said}."
            )
        return np.array(known.index(prompt.strip()), np.int32)


_CAMERA = {"intrinsics": (3, 3), "base_from_camera": (4, 4), "distortion": (PACKED,)}
"""What a request may say of a camera, and its shape."""


@dataclass(frozen=True)
class _Camera:
    """A view's camera, each of one moment that holds for all or of S."""

    K: np.ndarray
    pose: np.ndarray
    lens: np.ndarray

    def at(self, t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K, pose and lens of a moment."""
        K, pose, lens = (x[min(t, len(x) - 1)] for x in (self.K, self.pose, self.lens))
        return K, pose, lens


@functools.lru_cache(1024)
def _check(view: str, size: tuple[int, int], K: bytes, pose: bytes, lens: bytes) -> None:
    """Refuses a camera that cannot be; one that was good before is not looked at again."""
    arrays = (np.frombuffer(data, np.float64) for data in (K, pose, lens))
    K_, pose_, lens_ = arrays
    camera = Camera(K_.reshape(3, 3), pose_.reshape(4, 4), *size, lens_)
    try:
        camera.validate(f"camera of view '{view}'")
    except CameraError as error:
        words = str(error).replace("world_from_camera", "base_from_camera")
        raise CameraError(words) from error


def _seen(
    picture: np.ndarray,
    camera: tuple[np.ndarray, np.ndarray, np.ndarray],
    size: tuple[int, int],
) -> dict[str, np.ndarray]:
    """A picture brought to the policy's size, and its camera."""
    K, pose, lens = camera
    fitted = fit((picture.shape[0], picture.shape[1]), size)
    return {
        "image": fitted.picture(picture),
        "K": fitted.intrinsics(K).astype(np.float32),
        "base_from_camera": pose.astype(np.float32),
        "distortion": lens.astype(np.float32),
    }


def _dotted(name: str) -> str:
    return name.replace("/", ".")


def _array(name: str, value: Any, expected: str) -> np.ndarray:
    if not isinstance(value, np.ndarray):
        raise PortError(f"{name}: expected {expected}, got {type(value).__name__}.")
    return value


def _described(array: np.ndarray) -> str:
    return f"{array.dtype} {list(array.shape)}"


def _some(array: np.ndarray) -> str:
    return np.array2string(array, precision=4, threshold=20, separator=", ").replace("\n", "")


def _number(name: str, value: Any, most: int) -> int | None:
    """A whole number from 0, if there is one."""
    if value is None:
        return None
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or not 0 <= value <= most:
        raise PortError(f"{name}: expected a whole number from 0 to {most}, got {value!r:.80}.")
    return int(value)
