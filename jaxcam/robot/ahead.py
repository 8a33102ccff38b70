"""Chunks executed on a robot while the next one is asked for.

A robot's computer needs this module and `jaxcam.client`; with them NumPy, msgpack and websockets.
At each control step `Ahead.action` gives the action of that step, or None: hold the last target.
A thread asks for the next chunk so early that it is there when it is needed:

    step      0  1  2  3  4  5  6  7  8  9 10
    chunk 1   a0 a1 a2 a3 a4 a5 a6 a7
    asked                       ^ observed at step 6, with three steps to come
    chunk 2                     -- -- b2 b3 b4 …       answered before step 8: b0 and b1 are late

An action is late when another was executed in its step, and late ones are dropped. While nothing
is executed no action becomes late: a robot that waits goes on where it stopped, without a leap.

Where actions are absolute, a new chunk begins with its own target. Where they are differences,
they count from the last target before the chunk's observation; so the first that is executed makes
up for what the late ones would have done, and the actions executed in their place have done. What
the robot is sent is then in both cases the path that the policy meant.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from jaxcam.client import CAMERA, IMAGES, STATE
from jaxcam.errors import PortError

Observe = Callable[[], Mapping[str, Any]]
"""What a robot sees now: names to arrays, without a batch axis."""
Ask = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""An observation to an answer with `actions` [T, A], as `jaxcam.client.Client.infer`."""

_REMEMBERED = 5
"""Answers whose slowest says how early the next one is asked for."""
_FAREWELL = 1.0
_STACKED = (IMAGES, STATE, CAMERA)
"""What names of observations begin with that policies see several of."""


@dataclass
class Lateness:
    """How well chunks were there when they were needed."""

    executed: int = 0
    """Actions."""
    held: int = 0
    """Steps without an action, after the first."""
    late: int = 0
    """Actions that were dropped, since others had been executed in their steps."""
    answers: list[float] = field(default_factory=list)
    """Seconds from each question to its answer."""

    def __str__(self) -> str:
        if not self.answers:
            return "no answer came"
        middle, worst = 1000 * np.median(self.answers), 1000 * max(self.answers)
        return (
            f"{self.executed} actions, {self.held} steps held, {self.late} late actions dropped; "
            f"{len(self.answers)} answers in {middle:.0f} ms (median; {worst:.0f} at most)"
        )


class Ahead:
    """Actions of a policy step by step, asked for ahead. Close it, or use it in a `with` block.

    Args:
        ask: Asks the policy; in a thread of its own, one question at a time.
        observe: What the robot sees; called in the caller's thread.
        execute: Steps of a chunk after which the next one is wanted; the whole chunk when None.
        space: The `action_space` of the policy. `eef_delta`, `eef_delta_componentwise` and
            `joint_delta` are differences; others are absolute. So is the gripper's number, and so
            is all behind the six of a grip.
        steps: Observations that the policy sees at once. They are of consecutive control steps,
            oldest first, and before the start they are the first one.
        wait: Seconds that a step may wait for an answer that is wanted by now; None has no limit,
            so that nothing is held and nothing is late.
        patience: Seconds that the robot may be without actions.
        names: The `action_names` of the policy, which say which numbers of `joint_delta` are the
            gripper's; the last one without.

    Raises:
        PortError: By `action`: the policy is gone, refuses, gives what are no actions, or the
            robot was without them for longer than `patience`.
    """

    def __init__(
        self,
        ask: Ask,
        observe: Observe,
        *,
        execute: int | None = None,
        space: str = "",
        steps: int = 1,
        wait: float | None = 0.005,
        patience: float = 2.0,
        names: Sequence[str] = (),
    ) -> None:
        self._ask, self._observe, self._execute = ask, observe, execute
        self._space, self._wait, self._patience = space, wait, patience
        self._names = tuple(names)
        self._observed: deque[Mapping[str, Any]] = deque(maxlen=max(1, steps))
        self._chunk = np.zeros((0, 0), np.float32)
        self._next = 0
        self._since_asked: list[np.ndarray] = []
        self._steps_since_asked = 0
        self._gone: deque[int] = deque(maxlen=_REMEMBERED)
        self._answer: Future[tuple[Mapping[str, Any], float]] | None = None
        self._without_since: float | None = None
        self.lateness = Lateness()
        """What came of it so far."""

    def action(self) -> np.ndarray | None:
        """The action of this control step [A], or None: hold the last target.

        Raises:
            PortError: See the class.
        """
        if self._observed.maxlen != 1:
            self._observed.append(self._observe())
        if self._answer is not None:
            self._take_in(self._answer)
        if self._answer is None and self._next >= self._wanted_at - self._lead:
            self._take_in(self._begin_to_ask())
        self._steps_since_asked += 1
        if self._next >= len(self._chunk):
            return self._hold()
        self._without_since = None
        action = self._chunk[self._next]
        self._next += 1
        self._since_asked.append(action)
        self.lateness.executed += 1
        return action

    def close(self) -> None:
        """Wait a second for a question that may be on its way, and no longer."""
        if self._answer is not None:
            wait([self._answer], _FAREWELL)
            self._answer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def _wanted_at(self) -> int:
        """Number of the chunk's action before which the next chunk is wanted."""
        return min(self._execute or len(self._chunk), len(self._chunk))

    @property
    def _lead(self) -> int:
        """Steps that an answer is expected to take."""
        return max(self._gone, default=0)

    def _begin_to_ask(self) -> "Future[tuple[Mapping[str, Any], float]]":
        if self._observed.maxlen == 1:
            self._observed.append(self._observe())
        request = _stacked(self._observed)
        answer: Future[tuple[Mapping[str, Any], float]] = Future()
        threading.Thread(target=_answered, args=(answer, self._ask, request), daemon=True).start()
        self._answer, self._since_asked, self._steps_since_asked = answer, [], 0
        return answer

    def _take_in(self, answer: "Future[tuple[Mapping[str, Any], float]]") -> None:
        """Go on with the chunk that was asked for, if it is there."""
        needed = self._next >= self._wanted_at
        try:
            content, seconds = answer.result(self._wait if needed else 0)
        except TimeoutError as error:
            if answer.done():  # the policy's own
                raise PortError(f"The policy did not answer in time: {error}.") from error
            return
        chunk = _checked(content)
        if self._chunk.size and chunk.shape[1] != self._chunk.shape[1]:
            raise PortError(
                f"Actions of {chunk.shape[1]} numbers, and {self._chunk.shape[1]} before."
            )
        past = min(len(self._since_asked), len(chunk))
        if past and "_delta" in self._space and past < len(chunk):
            chunk = chunk.copy()
            moves = _differences(self._space, self._names, chunk.shape[1])
            chunk[past] = _made_up(self._space, chunk[: past + 1], self._since_asked, moves)
        if self.lateness.executed:  # the first answer may have come from a server not yet warm
            self._gone.append(self._steps_since_asked)
        self._chunk, self._next, self._answer = chunk, past, None
        self.lateness.late += past
        self.lateness.answers.append(seconds)

    def _hold(self) -> None:
        if not self.lateness.answers:
            return  # nothing has been executed yet; the client has a time-out of its own
        self.lateness.held += 1
        now = time.monotonic()
        if self._without_since is None:
            self._without_since = now
        if now - self._without_since > self._patience:
            raise PortError(f"The robot was without actions for {self._patience:g} s.")


class Pace:
    """Control steps at a rate.

    Args:
        rate: Steps a second.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1 / rate
        self._due = time.monotonic() + self._period
        self.late = 0
        """Steps that began more than a tenth of a step late."""
        self.worst = 0.0
        """Seconds by which the latest step began late."""

    def wait(self) -> None:
        """Wait until the next step is due; those that have been missed are not made up for."""
        behind = time.monotonic() - self._due
        if behind < 0:
            time.sleep(-behind)
        self.late += behind > 0.1 * self._period
        self.worst = max(self.worst, behind)
        self._due += self._period * (1 + max(0, behind // self._period))

    def __str__(self) -> str:
        return f"{self.late} steps began late, by {1000 * self.worst:.0f} ms at most"


def _answered(
    answer: "Future[tuple[Mapping[str, Any], float]]", ask: Ask, request: Mapping[str, Any]
) -> None:
    """Ask, and put the answer or what went wrong where it is waited for."""
    began = time.monotonic()
    try:
        answer.set_result((ask(request), time.monotonic() - began))
    except BaseException as error:
        answer.set_exception(error)


def _stacked(observed: "deque[Mapping[str, Any]]") -> dict[str, Any]:
    """One observation, or the last ones stacked, oldest first."""
    newest = dict(observed[-1])
    if observed.maxlen == 1:
        return newest
    missing = (observed.maxlen or 1) - len(observed)
    each = [*[observed[0]] * missing, *observed]
    for name in newest:
        if name.replace("/", ".").startswith(_STACKED):
            newest[name] = np.stack([np.asarray(one[name]) for one in each])
    return newest


def _checked(answer: Mapping[str, Any]) -> np.ndarray:
    """The actions of an answer, float32 [T, A].

    Raises:
        PortError: They are none.
    """
    actions = np.asarray(answer.get("actions"))
    if actions.dtype.kind not in "fiu" or actions.ndim != 2 or not actions.size:
        kind = f"{actions.dtype} {list(actions.shape)}"
        raise PortError(f"The policy gave no actions: expected numbers [T, A], got {kind}.")
    if not np.isfinite(actions).all():
        raise PortError("The policy gave actions that are not finite.")
    return actions.astype(np.float32)


def _differences(space: str, names: Sequence[str], size: int) -> list[int]:
    """Which numbers of an action are differences, in a space of those."""
    if space.startswith("eef"):
        return list(range(min(6, size)))
    if len(names) != size:
        return list(range(size - 1))
    return [i for i, name in enumerate(names) if "grip" not in name.lower()]


def _made_up(
    space: str, chunk: np.ndarray, executed: Sequence[np.ndarray], moves: Sequence[int]
) -> np.ndarray:
    """The last difference of a chunk, after others were executed in place of those before it.

    Args:
        space: Of the differences.
        chunk: From its first difference to the one that is executed now [n + 1, A].
        executed: What was executed instead of the first n.
        moves: Which of the A numbers are differences.
    """
    done = np.stack(executed)[: len(chunk) - 1]
    action = chunk[-1].copy()
    moved = chunk.sum(0) - done.sum(0)
    if space == "eef_delta":  # rotations do not add up
        meant, is_at = _turned(chunk[:, 3:6]), _turned(done[:, 3:6])
        moved[3:6] = _rotvec(_product(meant, is_at * [1, -1, -1, -1]))
    action[list(moves)] = moved[list(moves)]
    return action


def _turned(rotvecs: np.ndarray) -> np.ndarray:
    """Quaternion wxyz of rotations done one after the other, about fixed axes."""
    whole = np.array([1.0, 0, 0, 0])
    for vector in np.asarray(rotvecs, np.float64):
        half = np.linalg.norm(vector) / 2
        step = np.array([np.cos(half), *(np.sinc(half / np.pi) / 2 * vector)])
        whole = _product(step, whole)
    return whole


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion of first b, then a."""
    w = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([w, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def _rotvec(quaternion: np.ndarray) -> np.ndarray:
    """Rotation vector (rad) [3] of a quaternion."""
    w, xyz = quaternion[0], quaternion[1:]
    if w < 0:
        w, xyz = -w, -xyz
    sine = np.linalg.norm(xyz)
    return xyz * (2 * np.arctan2(sine, w) / sine if sine > 1e-9 else 2.0)
