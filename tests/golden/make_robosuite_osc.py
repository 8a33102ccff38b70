"""Record robosuite's own controllers, so that ours can be held against them.

robosuite's environments need an older MuJoCo and an older NumPy than jaxcam, so this script runs
in an environment of its own and only its output, ``robosuite_osc.npz``, is used by the tests::

    python3.11 -m venv robosuite-env
    robosuite-env/bin/pip install robosuite==1.5.2 mujoco==3.9.0
    robosuite-env/bin/python tests/golden/make_robosuite_osc.py

The environment is Lift with a Panda and a PandaGripper: 20 Hz control, 2 ms physics steps,
``lite_physics`` on, no cameras. All motion is free: the cube rests on a far corner of the table,
and the script stops if a contact other than cube on table appears. Same seeds, same file.


One control step
================

``int(0.05 / 0.002) = 25`` substeps; the controller runs in every one of them::

    for i in range(25):
        mj_step1(model, data)               # poses, mass matrix and bias of the current state
        if i == 0:
            set the arm's goal; advance the gripper state
        data.ctrl[arm] = clip(torque(data), ctrlrange)     # 80 Nm joints 1-5, 12 Nm joints 6-7
        data.ctrl[fingers] = finger targets
        mj_step2(model, data)               # Euler

After the step ``data.site_xpos`` still belongs to the last ``mj_step1``: it is one substep old, and
so is robosuite's observation of the end-effector. The poses recorded here are recomputed from the
final ``qpos``.

OSC_POSE, absolute, world frame (``osc_*``)
-------------------------------------------
A command is position (3), rotation vector (3) and gripper (1). Position and rotation are those of
the site ``gripper0_right_grip_site`` in the world; they are neither clipped, nor scaled, nor
interpolated. With p, R the site's pose, Rg the goal's rotation, J = [Jp; Jr] the site's Jacobian
on the seven arm columns, q and qd the arm's state, and M the arm's 7x7 block of the full mass
matrix (armature included)::

    e_p  = p_goal - p
    e_R  = (R[:,0] x Rg[:,0] + R[:,1] x Rg[:,1] + R[:,2] x Rg[:,2]) / 2     # sin(angle) * axis
    F    = 150 e_p - 2 sqrt(150) Jp qd
    T    = 150 e_R - 2 sqrt(150) Jr qd
    L    = pinv(J M^-1 J^T)
    Lp   = pinv(Jp M^-1 Jp^T)
    Lr   = pinv(Jr M^-1 Jr^T)
    N    = I - (M^-1 J^T L) J
    tau  = J^T [Lp F; Lr T] + qfrc_bias + N^T M (10 (q_ref - q) - 2 sqrt(10) qd)

pinv drops singular values below 1e-15 of the largest, so away from exact singularities it is the
inverse. ``q_ref`` is the arm's position when the controller was built, which is at the reset,
after the initial joint noise: the controller keeps a reference to an array that nobody writes to
again, so it is a copy in effect. It is recorded (``osc_reference_qpos``) and equals the first
seven entries of the initial ``qpos``. Velocities of the robot's base are subtracted in robosuite;
here they are zero.

The controller caches pose, Jacobians, M, q and qd once per substep. The one exception is the first
substep after a reset, which uses the values cached when the controller was built: same arm state,
fingers at zero, which changes M by less than can be seen.

JOINT_POSITION, absolute (``joint_*``)
--------------------------------------
A command is seven joint positions and the gripper; gains are robosuite's default for this
controller (kp 50, damping ratio 1). ``tau = M (50 (q_goal - q) - 2 sqrt(50) qd) + qfrc_bias``,
again neither clipped nor scaled nor interpolated.

Gripper
-------
A state g in R^2, zero at reset, advances once per control step; positive commands close, negative
ones open, zero holds::

    g    = clip(g + [-1, 1] * 0.2 * sign(command), -1, 1)      # ten steps from open to closed
    ctrl = bias + weight * g       # bias, weight: middle and half width of ctrlrange
         = [0.02 + 0.02 g[0], -0.02 + 0.02 g[1]]

Position actuators, kp 1000, force limited to 20 N.

Model values that robosuite sets in Python rather than in XML
-------------------------------------------------------------
Arm: armature 5 / (i + 1) for joint i = 0..6, friction loss 0.1, damping 0.1 (joints 1-5) and 0.01
(joints 6-7). Initial qpos [0, pi/16, 0, -5 pi/6, 0, pi - 0.2, pi/4] plus normal noise of 0.02 rad
on the arm, fingers at +-0.020833. Base at (-0.56, 0, 0.912), table top at z = 0.8.

Arrays (S sequences, T = 100 control steps)
===========================================
``{osc,joint}_command`` (S, T, 7 or 8) exactly as given; ``_initial_qpos`` (S, 16) and
``_initial_qvel`` (S, 15) before the first command; ``_reference_qpos`` (S, 7); after each control
step ``_qpos``, ``_qvel``, ``_site_pos``, ``_site_quat`` (wxyz), and ``_torque`` (S, T, 7), the
clipped arm torques of the last substep. ``joint_names``, ``actuator_names`` and ``site_name`` say
which is which; ``versions`` what it was made with. Quantities after a step are float32.

Targets move by at most 2 cm a step and tilt by at most 0.5 rad from the grasp from above. In OSC
sequence 1 the arm folds until joint 6 is near pi, loses its target by 20 cm, saturates joints 6
and 7, and recovers: it is the one that tells an approximation from the real thing.

Replayed with robosuite 1.5.1's models under MuJoCo 3.17 and the formulas above in float64 or
float32, all sequences agree to 1e-4 mm and 1e-4 degrees.
"""

import argparse
import pathlib
from typing import Any

import mujoco
import numpy as np
import robosuite
from robosuite.controllers import load_composite_controller_config
from robosuite.utils.binding_utils import MjSim
from scipy.spatial.transform import Rotation

STEPS = 100
SEEDS = (11, 12, 13, 14)
SITE = "gripper0_right_grip_site"
LEG = 20  # control steps between two way-points
TABLE_Z = 0.8
BOX_LOW, BOX_HIGH = np.array([-0.14, -0.20, 0.90]), np.array([0.10, 0.20, 1.12])
CUBE_XY = (0.33, -0.33)
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # grasp from above
CONTROLLERS: dict[str, dict[str, Any]] = {
    "osc": {
        "type": "OSC_POSE",
        "input_type": "absolute",
        "input_ref_frame": "world",
        "kp": 150,
        "damping_ratio": 1,
        "uncouple_pos_ori": True,
    },
    "joint": {
        "type": "JOINT_POSITION",
        "input_type": "absolute",
        "kp": 50,
        "damping_ratio": 1,
        # The robot's default part is an OSC one: these replace what has another length there.
        "input_max": 1,
        "input_min": -1,
        "output_max": 0.05,
        "output_min": -0.05,
        "qpos_limits": None,
    },
}


def make_env(controller: str, seed: int) -> Any:
    """Lift without any rendering, reset, with the cube moved out of the way."""
    config: Any = load_composite_controller_config(robot="Panda")
    config["body_parts"]["right"].update(CONTROLLERS[controller])
    env = robosuite.make(
        "Lift",
        robots="Panda",
        controller_configs=config,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=20,
        horizon=10 * STEPS,
        seed=seed,
    )
    env.reset()
    half = env.sim.model.geom_size[env.sim.model.geom_name2id("cube_g0")][2]
    env.sim.data.set_joint_qpos("cube_joint0", np.array([*CUBE_XY, TABLE_Z + half, 1, 0, 0, 0]))
    env.sim.forward()
    return env


def glide(rng: np.random.Generator, start: np.ndarray, low: Any, high: Any, leg: float) -> Any:
    """A smooth walk from `start` over random way-points in a box, minimum jerk between them.

    Legs longer than `leg` are shortened; the fastest step is 1.875 * leg / LEG.
    """
    s = np.arange(1, LEG + 1)[:, None] / LEG
    blend = s**3 * (10 - 15 * s + 6 * s**2)
    points, here = [], np.asarray(start, float)
    for _ in range(STEPS // LEG):
        step = rng.uniform(low, high) - here
        step *= min(1.0, leg / np.linalg.norm(step))
        points.append(here + blend * step)
        here = here + step
    return np.concatenate(points)


def gripper_commands(rng: np.random.Generator) -> np.ndarray:
    """Open (-1) or close (+1), toggled at random every 8 to 25 steps."""
    toggles = np.cumsum(rng.integers(8, 26, size=STEPS))
    count = np.searchsorted(toggles, np.arange(STEPS), side="right")
    return np.where((count + rng.integers(2)) % 2 == 0, -1.0, 1.0)


def commands(controller: str, env: Any, seed: int) -> np.ndarray:
    """Commands of one sequence, already rounded to float32 (they are stored as such)."""
    rng = np.random.default_rng(seed)
    if controller == "osc":
        start = env.sim.data.site_xpos[env.sim.model.site_name2id(SITE)]
        position = glide(rng, start, BOX_LOW, BOX_HIGH, leg=0.02 * LEG / 1.875)
        tilt = glide(rng, np.zeros(3), -0.29 * np.ones(3), 0.29 * np.ones(3), leg=0.5)
        rotvec = (Rotation.from_rotvec(tilt) * Rotation.from_matrix(DOWN)).as_rotvec()
        arm = np.concatenate([position, rotvec], axis=-1)
    else:
        home = env.sim.data.qpos[:7]
        arm = glide(rng, home, home - 0.25, home + 0.25, leg=0.5)
    command = np.concatenate([arm, gripper_commands(rng)[:, None]], axis=-1)
    return command.astype(np.float32)


def require_free_motion(env: Any) -> None:
    """Stop if anything but the cube and the table touch, or a joint is at its limit."""
    model, data = env.sim.model._model, env.sim.data._data
    allowed = {"cube_g0", "table_collision"}
    for contact in data.contact[: data.ncon]:
        pair = {model.geom(int(g)).name for g in (contact.geom1, contact.geom2)}
        if pair != allowed:
            raise RuntimeError(f"contact between {sorted(pair)}: the motion is not free")
    low, high = model.jnt_range[:7].T
    if ((data.qpos[:7] < low) | (data.qpos[:7] > high)).any():
        raise RuntimeError("an arm joint is at its limit: the motion is not free")


def record(controller: str, seed: int) -> tuple[dict[str, np.ndarray], Any]:
    """Play one sequence; everything the file keeps of it, without the name's prefix."""
    env = make_env(controller, seed)
    model, data = env.sim.model._model, env.sim.data._data
    exact: Any = MjSim(model)  # for final poses; the environment's are a substep old
    site = env.sim.model.site_name2id(SITE)
    command = commands(controller, env, seed)
    part = env.robots[0].part_controllers["right"]
    out: dict[str, Any] = {
        "command": command,
        "initial_qpos": data.qpos.copy(),
        "initial_qvel": data.qvel.copy(),
        "reference_qpos": part.initial_joint.copy(),
    }
    rows: dict[str, list[np.ndarray]] = {
        name: [] for name in ("qpos", "qvel", "site_pos", "site_quat", "torque")
    }
    for action in command.astype(np.float64):
        env.step(action)
        require_free_motion(env)
        exact.data.qpos[:] = data.qpos
        exact.forward()
        rotation = Rotation.from_matrix(exact.data.site_xmat[site].reshape(3, 3))
        rows["qpos"].append(data.qpos.copy())
        rows["qvel"].append(data.qvel.copy())
        rows["site_pos"].append(exact.data.site_xpos[site].copy())
        rows["site_quat"].append(rotation.as_quat()[[3, 0, 1, 2]])
        rows["torque"].append(data.ctrl[:7].copy())
    out.update({name: np.array(values, np.float32) for name, values in rows.items()})
    return out, model


def main() -> None:
    """Record all sequences of both controllers and write the file."""
    parser = argparse.ArgumentParser(description="Record robosuite's controllers on Lift.")
    parser.add_argument(
        "--out", type=pathlib.Path, default=pathlib.Path(__file__).with_name("robosuite_osc.npz")
    )
    args = parser.parse_args()
    arrays: dict[str, Any] = {}
    model: Any = None
    for controller in CONTROLLERS:
        records = []
        for seed in SEEDS:
            sequence, model = record(controller, seed)
            records.append(sequence)
        for name in records[0]:
            arrays[f"{controller}_{name}"] = np.stack([sequence[name] for sequence in records])
    arrays["joint_names"] = np.array([model.joint(i).name for i in range(model.njnt)])
    arrays["actuator_names"] = np.array([model.actuator(i).name for i in range(model.nu)])
    arrays["site_name"] = np.array(SITE)
    arrays["versions"] = np.array(
        [f"robosuite {robosuite.__version__}", f"mujoco {mujoco.__version__}"]
    )
    np.savez_compressed(args.out, **arrays)
    print(f"{args.out}: {args.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
