"""Our controllers and slim model against trajectories recorded from robosuite's own environment."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest

from jaxcam.rays.rotations import matrix_from_quaternion, matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import controllers
from jaxcam.sim.mujoco.native import TORQUES, NativeEngine
from jaxcam.sim.mujoco.scene import build_scene
from jaxcam.sim.tasks.lift import Lift
from jaxcam.sim.types import Command, Start

GOLDEN = places.GOLDEN / "robosuite_osc.npz"


@pytest.fixture(scope="module")
def scene():
    return build_scene(Lift().objects(), "fixed")


def replay(scene, controller, name):
    """Plays the recorded commands; returns position (m), angle (rad) and joint errors (rad)."""
    recorded = np.load(GOLDEN)
    command = recorded[f"{name}_command"]
    count, steps = command.shape[:2]
    engine = NativeEngine(scene, controller)
    state = engine.reset(
        Start(recorded[f"{name}_initial_qpos"], np.zeros((count, 0, 3)), np.zeros((count, 2, 7)))
    )
    position, angle, joints = [], [], []
    for t in range(steps):
        state = engine.step(state, Command(command[:, t, :-1], command[:, t, -1]))
        expected = matrix_from_quaternion(recorded[f"{name}_site_quat"][:, t])
        off = expected.swapaxes(-1, -2) @ state.grip_rotation
        position.append(
            np.linalg.norm(state.grip_position - recorded[f"{name}_site_pos"][:, t], axis=-1)
        )
        angle.append(np.linalg.norm(rotvec_from_matrix(off), axis=-1))
        joints.append(abs(state.qpos[:, :9] - recorded[f"{name}_qpos"][:, t, :9]).max(-1))
    assert state.ok.all()
    return np.max(position), np.max(angle), np.max(joints)


@pytest.mark.parametrize(("controller", "name"), [("osc_pose", "osc"), ("joint_position", "joint")])
def test_follows_robosuite_over_100_control_steps(scene, controller, name):
    position, angle, joints = replay(scene, controller, name)
    print(f"{name}: {position * 1e3:.4f} mm, {np.rad2deg(angle):.5f} deg, {joints:.2e} rad")
    assert position < 2e-3
    assert angle < np.deg2rad(0.5)
    assert joints < 5e-3


def random_arm(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(7, 7))
    rotation = np.linalg.qr(rng.normal(size=(2, 3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))[:, None, None]
    arm = controllers.ArmState(
        q=rng.normal(size=7),
        qd=rng.normal(size=7),
        position=rng.normal(size=3),
        rotation=rotation[0],
        jacobian=rng.normal(size=(6, 7)),
        mass=root @ root.T + 3 * np.eye(7),
        bias=rng.normal(size=7),
    )
    return arm, rng.normal(size=3), rotation[1], rng.normal(size=7)


def test_one_source_gives_the_same_torques_under_numpy_numba_and_jax():
    arm, position, rotation, rest = random_arm(0)
    goals = {"osc_pose": (position, rotation, rest), "joint_position": (rest,)}
    for name, goal in goals.items():
        torque = controllers.torque(name, arm, *goal)
        with jax.enable_x64(True):
            as_jax = jax.tree.map(jnp.asarray, (arm, *goal))
            traced = jax.jit(functools.partial(controllers.torque, name))(*as_jax)
            np.testing.assert_allclose(traced, torque, rtol=1e-9)
        motion = np.roll(arm.jacobian.T, 3, axis=1)[None]  # about the grip site itself
        sensed = controllers.Sensed(
            q=arm.q[None],
            qd=arm.qd[None],
            position=arm.position[None],
            rotation=arm.rotation[None],
            motion=motion,
            origin=arm.position[None],
            mass=arm.mass.reshape(1, -1),
            bias=arm.bias[None],
        )
        out, mass_at = np.empty((1, 7)), np.arange(49).reshape(7, 7)
        goal = tuple(x[None] for x in goal)
        for reach in (1e9, np.median(abs(torque))):
            limits = np.tile([[-reach], [reach]], 7)
            TORQUES[name](sensed, mass_at, np.array([0], np.int32), goal, limits, out)
            np.testing.assert_allclose(out[0], np.clip(torque, -reach, reach), rtol=1e-9)


def test_rotation_error_is_the_axis_times_the_sine_of_the_angle():
    turn = np.array([0.1, -0.7, 0.4])
    current, angle = matrix_from_rotvec(np.array([1.0, 2.0, -0.5])), np.linalg.norm(turn)
    error = controllers.rotation_error(current, matrix_from_rotvec(turn) @ current)
    np.testing.assert_allclose(error, turn / angle * np.sin(angle), atol=1e-12)


def test_null_space_torque_does_not_accelerate_the_grip_site():
    arm, position, rotation, rest = random_arm(1)
    with_rest = controllers.osc_pose(arm, position, rotation, rest)
    without = controllers.osc_pose(arm, position, rotation, rest + 1.0)
    acceleration = arm.jacobian @ np.linalg.solve(arm.mass, with_rest - without)
    assert abs(with_rest - without).max() > 1
    np.testing.assert_allclose(acceleration, 0, atol=1e-8)


def test_gripper_takes_ten_control_steps_from_open_to_closed():
    closed = np.array([-1.0])
    for _ in range(9):
        closed = controllers.gripper_command(closed, np.array([0.3]))
    assert closed < 0.99
    closed = controllers.gripper_command(closed, np.array([0.3]))
    np.testing.assert_allclose(closed, 1.0)
    np.testing.assert_allclose(controllers.finger_targets(closed), [[0, 0]], atol=1e-12)
    np.testing.assert_allclose(controllers.finger_targets(np.array(-1.0)), [0.04, -0.04])
