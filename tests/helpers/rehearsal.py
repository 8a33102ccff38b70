"""The simulated robot's cameras, and policies of it that were never trained."""

import json

import numpy as np
from places import REPO

from jaxcam.data.splits import SPLITS

CAMERAS = REPO / "examples/robot/cameras.json"
METADATA = {
    "views": ["view_0", "view_1"],
    "action_names": list("xyzabcg"),
    "action_space": "eef_delta",
    "rate": 20.0,
    "execute": 4,
    "needs_cameras": True,
    "controls": ["episode_start"],
}


def small_cameras(folder, side=24):
    """The example's file for pictures of fewer pixels."""
    content = json.loads(CAMERAS.read_text())
    for view in content["views"].values():
        scale = side / view["size"][0]
        view["K"] = {name: number * scale for name, number in view["K"].items()}
        view["size"] = [side, side]
    (folder / "cameras.json").write_text(json.dumps(content))


def lifter(task, world, start=0):
    """Lifts the cube of a start: it feels the grip, and knows where the cube was put."""
    qpos = task.start(world, SPLITS["test"].episodes + start).qpos
    where = world.qpos_of("cube")
    cube = (qpos[where : where + 3] - world.world_from_base[:3, 3]) @ world.world_from_base[:3, :3]

    def act(observation):
        grip, opening = observation["observation.state"][7:10], observation["observation.state"][10]
        away = cube + [0, 0, -0.004] - grip
        aside = np.linalg.norm(away[:2])
        closed = opening < 0.06 and aside < 0.02
        if closed:
            move = np.array([0, 0, 0.02])
        elif aside > 0.008:
            move = 0.12 * (away + [0, 0, np.clip(3 * aside, 0, 0.1)])
        else:
            move = 0.12 * away
        close = closed or (aside < 0.01 and away[2] > -0.008)
        move = np.clip(move, -0.02, 0.02) @ world.world_from_base[:3, :3].T
        action = np.array([*move, 0, 0, 0, 1.0 if close else -1.0], np.float32)
        return np.tile(action, (4, 1))

    return act


def rester(observation):
    """Does nothing."""
    return np.zeros((4, 7), np.float32)
