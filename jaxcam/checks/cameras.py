"""Whether a dataset's cameras can have seen its demonstrations."""

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.data.cameras import EXPECTED, camera_faults, require_rigid
from jaxcam.data.demos import Demos
from jaxcam.errors import CameraError


def check_poses(demos: Demos) -> Finding:
    """Whether the cameras of a dataset are rigid poses."""
    try:
        require_rigid(demos)
    except CameraError as error:
        return bad("camera poses", got=str(error), fix="Write those cameras anew.")
    return good("camera poses", got=f"{len(demos.header.world_from_camera)} rigid transforms")


def check_cameras(demos: Demos) -> Finding:
    """Whether cameras, whose poses are rigid, can have seen the demonstrations."""
    faults = camera_faults(demos)
    if not faults.odd.any():
        got = f"{len(faults.rows)} cameras have the grip in their pictures"
        return good("cameras", got=got)
    finding = note if faults.tolerable else bad
    return finding(
        "cameras", got=faults.summary, expected=EXPECTED, where=faults.where, fix=faults.remedy
    )
