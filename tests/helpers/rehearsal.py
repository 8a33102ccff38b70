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
    "execute": 64,
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
    """Lifts the cube of a start in one chunk: it knows where the cube was put."""
    qpos = task.start(world, SPLITS["test"].episodes + start).qpos
    where = world.qpos_of("cube")
    cube = (qpos[where : where + 3] - world.world_from_base[:3, 3]) @ world.world_from_base[:3, :3]

    def act(observation):
        grip = observation["observation.state"][7:10]
        above, at, up = (cube + np.array([0, 0, height]) for height in (0.08, -0.004, 0.09))
        way, closes = [grip], []
        for end, steps, close in ((above, 22, -1), (at, 14, -1), (at, 8, 1), (up, 20, 1)):
            begin = way[-1]
            way += [begin + (end - begin) * i / steps for i in range(1, steps + 1)]
            closes += [close] * steps
        moves = np.diff(way, axis=0) @ world.world_from_base[:3, :3].T
        return np.concatenate([moves, np.zeros_like(moves), np.c_[closes]], 1).astype(np.float32)

    return act


def rester(observation):
    """Does nothing."""
    return np.zeros((64, 7), np.float32)
