"""What is known of a view's episodes, and of those between them."""

from dataclasses import replace

import numpy as np
from boxed_arm import CAMERA, SIDE, K

from jaxcam.interop.cameras.optics import Optics
from jaxcam.robot.calibration.drift.change import AskedChange
from jaxcam.robot.calibration.drift.change import Tested as Judged
from jaxcam.robot.calibration.drift.looking import ViewDrift, pose_overrides
from jaxcam.robot.calibration.projection import moved

OPTICS = Optics(K, SIDE, SIDE, np.zeros(9))


def found(change, together, support=0.8):
    asked = AskedChange(
        4, CAMERA, np.add(change, together), 1e-6 * np.eye(6), support, np.zeros(3), np.zeros(3)
    )
    return Judged(asked, np.array(change, float), 1.0, False)


def test_a_run_has_its_pose_in_all_episodes_from_its_first_to_its_last():
    """Also where pictures say nothing, or nobody looked; next to it nobody knows."""
    change = np.r_[0.02, 0, 0, 0, 0, 0.02]
    at = {2: False, 4: True, 8: True, 12: False}
    episodes = [
        replace(one, asked=replace(one.asked, episode=number), moved=moves)
        for number, moves in at.items()
        for one in [found(change * moves, np.zeros(6))]
    ]
    silent = [replace(found(np.zeros(6), np.zeros(6), support=0.1).asked, episode=6)]
    left_out = dict.fromkeys((0, 3, 5, 7, 9, 10, 11, 14), CAMERA)
    known = ViewDrift("front", episodes, silent, OPTICS, left_out | {5: moved(CAMERA, change)})
    assert list(known.poses(known.runs[0])) == [4, 6, 7, 8]  # 5 has been corrected before
    drift = ViewDrift("front", episodes, silent, OPTICS, left_out)
    poses = drift.poses(drift.runs[0])
    assert list(poses) == [4, 5, 6, 7, 8]
    for pose in poses.values():
        np.testing.assert_allclose(pose, moved(CAMERA, change), atol=1e-9)
    assert drift.open_ends == [3, 9, 10, 11]
    changes = pose_overrides([drift])
    assert list(changes.episodes) == ["4", "5", "6", "7", "8"]
    assert changes.about["front"]["drift"]["episodes"] == [4, 5, 6, 7, 8]
