"""Whether a policy would be evaluated on what is like its dataset, and on nothing that is in it."""

import numpy as np
from scipy.spatial import KDTree

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.config.conditions import Conditions
from jaxcam.console.words import some
from jaxcam.data.demos import Demos
from jaxcam.data.header import Header, optics_ranges
from jaxcam.data.splits import SPLITS
from jaxcam.rays import sample_poses, spherical

HELD_OUT = 1000
"""Cameras of the evaluation that a dataset's are compared with."""
SAME = 1e-3
"""Difference (m, and of axes) below which two cameras are one."""
ROUNDED_FOVY = 1e-3
"""Angle (degrees) by which a field of view may leave the range that it was drawn from."""
SLACK = 0.01
"""Distance (m) and angle (rad) by which a camera may leave the task's ranges."""


def check_held_out(demos: Demos) -> Finding:
    """Whether a policy would be evaluated on cameras or episodes that it was trained on."""
    header, what = demos.header, "held-out pairs"
    trained = np.asarray(header.world_from_camera)
    tree = KDTree(_flat(trained))
    ranges = demos.task.cameras
    shared = {}
    for split, (_, seed) in SPLITS.items():
        apart, _ = tree.query(_flat(sample_poses(ranges, HELD_OUT, seed)))
        shared[split] = np.count_nonzero(np.asarray(apart) < SAME)
    first, last = min(s for s, _ in SPLITS.values()), max(s for s, _ in SPLITS.values())
    seeds = [d.seed for d in demos.episodes]
    taken = [seed for seed in seeds if first <= seed < 2 * last - first]
    if not any(shared.values()) and not taken:
        return good(what, got="no camera and no episode of the evaluation is in the dataset")
    cameras = ", ".join(f"{count} of {split}" for split, count in shared.items())
    return bad(
        what,
        got=f"cameras of the evaluation that are in the dataset: {cameras}; "
        f"episode seeds of the evaluation: {some(taken) or 'none'}",
        expected="none",
        fix="Success on what was trained on says nothing: draw other cameras or episodes.",
    )


def check_field_of_view(demos: Demos) -> Finding:
    """Whether the field of view is that of the cameras a policy will be evaluated with."""
    task = demos.task
    got, expected = demos.header.fovy_deg, task.fovy_deg
    if demos.header.K is not None:
        return _own_fields_of_view(demos.header)
    if np.isclose(got, expected, atol=1e-3):
        return good("field of view", got=f"{got:g}° up and down, as the task's cameras")
    hint = " It looks like radians." if np.isclose(np.rad2deg(got), expected, rtol=0.01) else ""
    return bad(
        "field of view",
        got=f"{got:g}°",
        expected=f"{expected:g}°, of the cameras that policies are evaluated with",
        where="fovy_deg",
        fix=f"Intrinsics follow from it: store the cameras' own.{hint}",
    )


def _own_fields_of_view(header: Header) -> Finding:
    """Whether the fields of view of cameras that have their own are such as they were drawn from.

    Policies are evaluated with cameras that are drawn from these ranges, too.
    """
    fovy = np.rad2deg(header.camera(slice(None), 1).fovy)
    got = f"{fovy.min():.4g}° to {fovy.max():.4g}° up and down, each camera its own"
    said = header.ranges
    if not header.optics:
        return note(
            "field of view",
            got=got,
            expected="ranges in the header that the evaluation draws from",
            where="optics",
            fix=f"Policies are evaluated with the task's {header.fovy_deg:g}°, unless --fovy of "
            "jaxcam.evaluate says otherwise.",
        )
    drawn = optics_ranges(Conditions(**said), header.fovy_deg)
    low, high = drawn.fovy_deg if drawn else (header.fovy_deg, header.fovy_deg)
    outside = np.flatnonzero((fovy < low - ROUNDED_FOVY) | (fovy > high + ROUNDED_FOVY))
    words = ", ".join(f"{name} {text}" for name, text in said.items())
    if not len(outside):
        of = f", as the evaluation draws ({words})" if words else ", as the task's cameras"
        return good("field of view", got=got + of)
    return bad(
        "field of view",
        got=got,
        expected=f"{low:g}° to {high:g}°, from which the evaluation draws, as the header says",
        where=f"cameras/K of cameras {some(outside.tolist())}",
        fix="cameras/K is of square pictures of height 1, and the header's optics are what it was "
        "drawn from: store the cameras' own, or collect again.",
    )


def check_ranges(demos: Demos) -> Finding:
    """Whether cameras are drawn from where those of the evaluation are."""
    ranges, what = demos.task.cameras, "camera ranges"
    poses, centre = np.asarray(demos.header.world_from_camera), np.array(ranges.centre)
    azimuth, elevation, distance = spherical(poses, centre)
    near = [_within(azimuth + turn, pair) for pair in ranges.azimuth for turn in (0, 2 * np.pi)]
    # The point of the optical axis that is nearest to the middle of what the cameras look at.
    box = centre[:, None] + np.array(ranges.look_at)
    towards, forward = box.mean(1) - poses[:, :3, 3], poses[:, :3, 2]
    along = np.sum(towards * forward, -1, keepdims=True)
    aside = np.linalg.norm(towards - along * forward, axis=-1)
    alike = (
        np.any(near, 0)
        & _within(elevation, ranges.elevation)
        & _within(distance, ranges.distance)
        & (aside <= np.linalg.norm(np.ptp(box, 1)) / 2 + SLACK)
    )
    got = f"{alike.sum()} of {len(poses)} are such as the evaluation draws"
    if alike.all():
        return good(what, got=got)
    where = some(np.flatnonzero(~alike).tolist())
    return note(
        what,
        got=got,
        expected="all",
        where=where,
        fix="Policies are evaluated from elsewhere than they learned, unless that is meant.",
    )


def camera_numbers(demos: Demos) -> dict[str, np.ndarray]:
    """Distances, azimuths and elevations of the cameras about the middle of the task, by name.

    Their fields of view, too, where they have their own.
    """
    centre = np.array(demos.task.cameras.centre)
    azimuth, elevation, distance = spherical(demos.header.world_from_camera, centre)
    numbers = {
        "camera distance (m)": distance,
        "camera azimuth (°)": np.rad2deg(azimuth),
        "camera elevation (°)": np.rad2deg(elevation),
    }
    if demos.header.K is not None:
        numbers["field of view (°)"] = np.rad2deg(demos.header.camera(slice(None), 1).fovy)
    return numbers


def _within(values: np.ndarray, pair: tuple[float, float]) -> np.ndarray:
    return (values >= pair[0] - SLACK) & (values <= pair[1] + SLACK)


def _flat(poses: np.ndarray) -> np.ndarray:
    return np.asarray(poses, np.float64)[:, :3].reshape(-1, 12)
