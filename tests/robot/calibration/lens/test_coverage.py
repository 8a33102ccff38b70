"""Which views of a board are missing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from seen_boards import BOARD, SIZE, board_poses, optics, seen

from jaxcam.robot.calibration.boards import BoardSeen
from jaxcam.robot.calibration.lens.coverage import (
    covered,
    missing_places,
    missing_tilts,
    most_different,
    tilts,
)
from jaxcam.robot.calibration.projection import pose_of

RNG = np.random.default_rng(0)


def at(u, v, n=40):
    pixels = RNG.uniform(-10, 10, (n, 2)) + np.array([u, v])
    return BoardSeen(f"{u} {v}", np.arange(n), pixels)


def test_parts_without_corners_are_named():
    places = [(u, v) for u in (60, 200, 320, 440, 580) for v in (60, 180, 300, 420)]
    everywhere = [at(u, v) for u, v in places]
    assert missing_places(everywhere, SIZE) == []
    assert covered(everywhere, SIZE).min() >= 4
    without = [at(u, v) for u, v in places if not (u == 60 and v == 60)]
    assert missing_places(without, SIZE) == ["the upper left corner"]
    right = [at(u, v) for u, v in places if u < 580]
    assert missing_places(right, SIZE) == [
        "the upper right corner", "the lower right corner", "the right edge",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("turn", "nearer"),
    [
        ([0, 0.5, 0], "right"),
        ([0, -0.5, 0], "left"),
        ([0.5, 0, 0], "upper"),
        ([-0.5, 0, 0], "lower"),
    ],
)
def test_tilts_are_named_by_the_edge_that_is_nearer(turn, nearer):
    """Checked on the board's own corners."""
    rotation = Rotation.from_rotvec(turn).as_matrix()
    pose = pose_of(rotation, np.array([0.0, 0, 0.5]))[None]
    edges = {
        "right": [1.0, 0, 0],
        "left": [-1.0, 0, 0],
        "upper": [0, -1.0, 0],
        "lower": [0, 1.0, 0],
    }
    depth = {name: (rotation @ np.array(edge))[2] for name, edge in edges.items()}
    assert min(depth, key=depth.get) == nearer
    assert f"{nearer} edge nearer" not in missing_tilts(pose)
    assert len(missing_tilts(pose)) == 3
    assert np.linalg.norm(tilts(pose)[0]) == pytest.approx(0.5)


def test_of_many_views_those_that_differ_are_taken():
    rng = np.random.default_rng(1)
    poses = board_poses(rng, 5)
    views = seen(optics(), np.repeat(poses, 4, 0), rng)
    chosen = most_different(views, BOARD.points, 5)
    assert sorted(i // 4 for i in chosen) == [0, 1, 2, 3, 4]
    assert most_different(views, BOARD.points, 50) == list(range(20))
