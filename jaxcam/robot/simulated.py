"""A robot that is a simulation of Lift, to rehearse trials and to try loops.

It knows of policies what a robot does: the actions it is given. The cameras of a calibrations
file film it, at the size that their K is for. It films without a lens.
"""

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np

from jaxcam.client import IMAGES, STATE
from jaxcam.config.names import ActionSpace, Rotations, SceneName
from jaxcam.data.splits import SPLITS
from jaxcam.errors import ConfigError, closest
from jaxcam.robot.driver import Setup
from jaxcam.sim import make_engine, make_task, simulator_of
from jaxcam.sim.actions import action_dim, controller_of, decode, measured, space_of
from jaxcam.sim.painter import Painter
from jaxcam.sim.types import Command, State, View

RATE = 20.0
"""Control steps a second of the simulation."""
_NUDGED = 0.012
"""Height (m) that the cube was raised by where the rollout is half a success."""


class SimulatedLift:
    """The arm and the cube of Lift. A `jaxcam.robot.driver.Robot`.

    A start's number is that of a held-out initial state.

    Args:
        action_space: Of the policies.
        rotations: What the rotation vectors of `eef_abs` are counted from.
        scene: `fixed` or `randomized`.
        speed: How much faster than real time it runs; 0 is as fast as it can, and time then stands
            still while a policy thinks.
    """

    def __init__(
        self,
        action_space: str = "eef_delta",
        rotations: Rotations = "nominal",
        scene: SceneName = "randomized",
        speed: float = 1.0,
    ) -> None:
        if action_space not in get_args(ActionSpace):
            hint = closest(str(action_space), get_args(ActionSpace))
            raise ConfigError(f"robot_settings: unknown action_space {action_space!r}{hint}")
        if rotations not in get_args(Rotations):
            hint = closest(str(rotations), get_args(Rotations))
            raise ConfigError(f"robot_settings: unknown rotations {rotations!r}{hint}")
        if not isinstance(speed, int | float) or not 0 <= speed <= 100:
            raise ConfigError(f"robot_settings: speed must be 0 to 100, got {speed!r}.")
        self.rate, self.speed = RATE, speed
        self.action_space, self.rotations = action_space, rotations
        self._task = make_task("lift")
        self._world = self._task.scene(scene)
        self._space = space_of(action_space, rotations)
        self._engine = make_engine(
            "native", self._world, controller_of(self._space), self._task.varied
        )
        self._painter: Painter | None = None
        self._cameras: Mapping[str, tuple[np.ndarray, tuple[int, int], np.ndarray]] = {}
        self._state: State | None = None
        self._lowest, self._raised, self._success = 0.0, 0.0, False

    def prepare(self, setup: Setup) -> None:
        """Put arm and cube at a start, and the cameras where the sheet has them.

        Args:
            setup: The start.

        Raises:
            ConfigError: The cameras are not calibrated, have a lens, or are for pictures of several
                sizes.
        """
        if not setup.cameras:
            raise ConfigError("The simulated robot films by calibrations: give cameras a file.")
        if setup.lenses:
            names = ", ".join(setup.lenses)
            raise ConfigError(f"The simulated robot films without a lens, and {names} have one.")
        sizes = {size for _, size, _ in setup.cameras.values()}
        if len(sizes) > 1:
            listed = ", ".join(f"{columns}x{rows}" for rows, columns in sorted(sizes))
            raise ConfigError(
                f"The simulated robot films at one size, and K is for {listed}. Give K of one size."
            )
        seed = SPLITS["test"].episodes + setup.start
        start = self._task.start(self._world, seed)
        self._start = type(start)(*(np.asarray(x)[None] for x in start))
        self._state = state = self._engine.reset(self._start)
        self._target = measured(self._space, self._state, self._world.arm)
        self._gripper = np.asarray(self._state.closed)
        self._cameras, self._success = setup.cameras, False
        self._lowest, self._raised = self._cube_height(), 0.0
        if self._painter is None:  # what is compiled at first use would take seconds of a rollout
            self._pictures(state)
            self._engine.step(state, Command(self._target, self._gripper))
            self._state = self._engine.reset(self._start)

    def observe(self) -> Mapping[str, Any]:
        """Pictures of all cameras, and what the arm feels."""
        state = self._running()
        pictures = zip(self._cameras, self._pictures(state), strict=True)
        observation: dict[str, Any] = {f"{IMAGES}{name}": x for name, x in pictures}
        felt = self._world.proprio(state.qpos, state.grip_position)
        return observation | {STATE: felt[0]}

    def act(self, action: np.ndarray) -> None:
        """Execute an action for one control step."""
        size = action_dim(self._space)
        if np.shape(action) != (size,):
            raise ConfigError(
                f"An action of shape {list(np.shape(action))}; {self._space} has {size} numbers. "
                "Likely cause: another action_space in robot_settings than the policies'."
            )
        targets, gripper = decode(
            self._space, np.asarray(action)[None, None], self._target, self._world.nominal_grip
        )
        self._target, self._gripper = targets[:, 0], gripper[:, 0]
        self.hold()

    def hold(self) -> None:
        """Go on to the last target for one control step."""
        state = self._engine.step(self._running(), Command(self._target, self._gripper))
        self._state = state
        is_done = self._task.success_in(self._world)(state, self._start)
        self._success |= bool(np.asarray(is_done)[0])
        height = self._cube_height()
        self._lowest = min(self._lowest, height)  # it is put down at first
        self._raised = max(self._raised, height - self._lowest)

    def stop(self) -> None:
        """Nothing moves while nobody steps it."""

    def outcome(self) -> str | None:
        """How the rollout went so far: half a success is a cube that was raised and not lifted."""
        if self._success:
            return "success"
        return "half" if self._raised > _NUDGED else "failure"

    def _running(self) -> State:
        if self._state is None:
            raise ConfigError("The robot was not prepared: call prepare first.")
        return self._state

    def _cube_height(self) -> float:
        return float(self._running().qpos[0, self._world.qpos_of("cube") + 2])

    def _pictures(self, state: State) -> np.ndarray:
        """What all cameras see, in their order, uint8 [V, H, W, 3]."""
        K, sizes, base_from_camera = (
            np.stack(x) for x in zip(*self._cameras.values(), strict=True)
        )
        count, size = len(K), tuple(map(int, sizes[0]))
        painter = self._painter
        if painter is None or (painter.height, painter.width) != size:
            painter = self._painter = simulator_of(self._world).painter(
                self._world, *size, varied=self._task.varied, batch=count
            )
        view = View(
            qpos=np.repeat(state.qpos, count, 0),
            geom_size=np.repeat(self._start.geom_size, count, 0),
            fixtures=np.repeat(self._start.fixtures, count, 0),
            K=K,
            world_from_camera=self._world.world_from_base @ base_from_camera,
        )
        return painter.rgb(view)
