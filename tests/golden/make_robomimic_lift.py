"""Record Lift episodes of robosuite's own environment, as robomimic's files hold them.

robosuite's environments need older packages than jaxcam, so this script runs in environments of
its own, once for each layout, and only its output, ``robomimic_lift_<version>.npz``, is used by the
tests::

    python3.11 -m venv robosuite15
    robosuite15/bin/pip install robosuite==1.5.2 mujoco==3.9.0
    robosuite15/bin/python tests/golden/make_robomimic_lift.py
    python3.11 -m venv robosuite14
    robosuite14/bin/pip install robosuite==1.4.1 mujoco==2.3.7 'numpy<2'
    robosuite14/bin/python tests/golden/make_robomimic_lift.py

Every array is what robomimic's converted datasets have under ``data``: the attribute ``env_args``
(``env_version`` and the controller as the version of robosuite writes it), and for each episode the
attribute ``model_file`` and the datasets ``states`` (flattened time, qpos, qvel before each action)
and ``actions`` (OSC_POSE deltas in [-1, 1] and the gripper). As in robomimic's human data the
recording ends after ten steps of success. A scripted hand turns to the cube, goes down, closes and
lifts; while it only moves, its rotation is exactly zero, which robosuite 1.4 takes for "keep the
orientation asked for last". Same version, same file.
"""

import argparse
import json
import pathlib
from typing import Any

import numpy as np
import robosuite

SEEDS = (3, 4)
STEPS = 120
HELD = 10


def controller() -> Any:
    """OSC_POSE with the version's defaults."""
    if robosuite.__version__ < "1.5":
        return robosuite.load_controller_config(default_controller="OSC_POSE")
    return robosuite.load_composite_controller_config(robot="Panda")


def env_args() -> dict[str, Any]:
    """What robomimic keeps of an environment: enough to make it again."""
    return {
        "env_name": "Lift",
        "env_version": robosuite.__version__,
        "type": 1,
        "env_kwargs": {
            "robots": ["Panda"],
            "controller_configs": controller(),
            "control_freq": 20,
            "has_renderer": False,
            "has_offscreen_renderer": False,
            "use_camera_obs": False,
            "use_object_obs": True,
            "reward_shaping": False,
            "ignore_done": True,
        },
    }


def wrapped(angle: float) -> float:
    """The equal turn of a square, within 45 degrees."""
    return (angle + np.pi / 4) % (np.pi / 2) - np.pi / 4


def act(env: Any, t: int, phase: list[int]) -> np.ndarray:
    """A delta action of the scripted hand; `phase` counts the steps since the fingers closed."""
    data = env.sim.data
    site = env.robots[0].gripper["right"] if robosuite.__version__ >= "1.5" else (
        env.robots[0].gripper
    )  # fmt: skip
    grip = data.site_xpos[env.sim.model.site_name2id(site.important_sites["grip_site"])]
    rotation = data.site_xmat[
        env.sim.model.site_name2id(site.important_sites["grip_site"])
    ].reshape(3, 3)
    cube = data.body_xpos[env.cube_body_id]
    turn = data.body_xmat[env.cube_body_id].reshape(3, 3)
    yaw = wrapped(np.arctan2(turn[1, 0], turn[0, 0]) - np.arctan2(rotation[1, 1], rotation[0, 1]))
    action = np.zeros(7)
    if t < 12:
        action[5] = np.clip(yaw / 0.5, -0.4, 0.4)
    aside = np.linalg.norm((grip - cube)[:2])
    goal = cube + np.array([0, 0, np.clip(3 * (aside - 0.012), 0.0, 0.1)])
    if phase[0] or np.linalg.norm(goal - grip) < 0.01:
        phase[0] += 1
        action[6] = 1
        if phase[0] > 10:
            action[2] = 0.6
    else:
        action[:3] = np.clip((goal - grip) / 0.05 * 1.5, -0.8, 0.8)
        action[6] = -1
    return action


def record(seed: int) -> tuple[str, np.ndarray, np.ndarray]:
    """One episode: its model, the states before each action, and the actions."""
    np.random.seed(seed)  # robosuite 1.4 draws from the global generator
    settings = {k: v for k, v in env_args()["env_kwargs"].items() if k != "reward_shaping"}
    if robosuite.__version__ >= "1.5":
        settings["seed"] = seed
    env = robosuite.make("Lift", **settings)
    env.reset()
    # Meshes are named with the path of this installation: a file from elsewhere has another.
    model = env.sim.model.get_xml().replace(
        str(pathlib.Path(robosuite.__file__).parent), "/elsewhere"
    )
    states, actions, held, phase = [], [], 0, [0]
    for t in range(STEPS):
        states.append(env.sim.get_state().flatten())
        actions.append(act(env, t, phase))
        env.step(actions[-1])
        held = held + 1 if env._check_success() else 0
        if held == HELD:
            break
    else:
        raise RuntimeError(f"episode {seed} did not succeed")
    return model, np.array(states), np.array(actions)


def main() -> None:
    """Record all episodes and write the file."""
    parser = argparse.ArgumentParser(description="Record Lift as robomimic's files hold it.")
    version = ".".join(robosuite.__version__.split(".")[:2])
    name = f"robomimic_lift_{version}.npz"
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path(__file__).with_name(name))
    args = parser.parse_args()
    arrays: dict[str, Any] = {"env_args": json.dumps(env_args())}
    for i, seed in enumerate(SEEDS):
        model, states, actions = record(seed)
        arrays |= {f"model_{i}": model, f"states_{i}": states, f"actions_{i}": actions}
        print(f"episode {i}: {len(actions)} steps, state of {states.shape[1]} numbers")
    np.savez_compressed(args.out, **arrays)
    print(f"{args.out}: {args.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
