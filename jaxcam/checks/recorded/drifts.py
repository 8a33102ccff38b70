"""Whether cameras stood where they are said to have stood, by the arm's motion.

Where what never moves in the pictures tells (`stills`), that is the sharper witness. Where table
and room are others in each episode, or each episode has a pose of its own, the arm is left.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxcam.checks.findings import bad, good, note
from jaxcam.checks.recorded.judged import Judged, called, names
from jaxcam.config.calibrate_arm import DriftConfig
from jaxcam.data.recorded.recording import Recording
from jaxcam.robot.calibration.arm.form import arm_for
from jaxcam.robot.calibration.arm.joints import joint_numbers
from jaxcam.robot.calibration.drift.looking import ViewDrift, drift_of, episodes_standing

WHAT = "standing still"


def unanswered(recording: Recording, judged: Sequence[Judged]) -> list[str]:
    """Views of which it is not known whether they stood still.

    Args:
        recording: The dataset.
        judged: What was found by what never moves.
    """
    known = {
        j.finding.where.removeprefix("view ").split(",")[0]
        for j in judged
        if j.finding.what == WHAT and j.finding.mark != "note"
    }
    return [view for view in recording.views if view not in known]


def check_drift(
    recording: Recording, views: Sequence[str], episodes: Sequence[int], robot: str
) -> Iterator[Judged]:
    """Whether some views stood where they are said to have stood.

    Args:
        recording: The dataset.
        views: Their names.
        episodes: Those that are looked at, ascending.
        robot: `panda`, or an MJCF or URDF file.

    Raises:
        ConfigError: The robot cannot be read, or the state does not say its joints.
    """
    columns = joint_numbers(recording, "", "")
    arm = arm_for(robot, columns)
    for view in views:
        some = [e for e in episodes_standing(recording, view) if e in set(episodes)]
        if some:
            most = DriftConfig.most
            yield from _judge(recording, drift_of(recording, view, some, arm, columns, most))


def _judge(recording: Recording, drift: ViewDrift) -> Iterator[Judged]:
    where = f"view {drift.view}"
    for run in drift.runs:
        place, turn = run[0].sizes
        odd = [one.asked.episode for one in run]
        first = called(recording.episodes[odd[0]])
        position = ", ".join(f"{x:.3f}" for x in run[0].pose[:3, 3])
        yield Judged(
            bad(
                WHAT,
                got=f"by the arm, it stood {1000 * place:.0f} mm and {np.rad2deg(turn):.1f}° from "
                f"its pose, at {position} (m), in {names(recording, odd)}",
                expected="the arm's contours where its pose has them",
                where=f"{where}, from {first} on",
                fix="python -m jaxcam.calibrate drift --write puts the poses of those episodes "
                "into the file of calibrations.",
            ),
            tuple(odd),
            drift.view,
        )
    if not drift.episodes:
        got = "not known by the arm, either: too little of its contour lies on edges"
        yield Judged(note(WHAT, got=got, where=where))
    elif drift.alone:
        got = "not known: one episode alone says something, and there is none to hold it against"
        yield Judged(note(WHAT, got=got, where=where))
    elif drift.unsure:
        place, turn = drift.spread
        got = f"not known: an episode tells it to {1000 * place:.0f} mm, {np.rad2deg(turn):.1f}°"
        yield Judged(note(WHAT, got=got, where=where))
    elif not drift.runs:
        got = f"by the arm, in {len(drift.episodes)} episodes"
        yield Judged(good(WHAT, got=got, where=where))
    if drift.pose_off:
        place, turn = drift.together
        yield Judged(
            bad(
                "its pose",
                got=f"by the arm, {1000 * place:.0f} mm and {np.rad2deg(turn):.1f}° off in all "
                f"{len(drift.episodes)} episodes",
                expected="the arm's contours where its pose has them, but for faults of the joints",
                where=where,
                fix="python -m jaxcam.calibrate arm finds the pose anew.",
            ),
            tuple(one.asked.episode for one in drift.episodes),
            drift.view,
        )
