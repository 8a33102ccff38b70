"""All that the doctor finds on a recorded dataset."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from jaxcam.checks.findings import Finding, good, note
from jaxcam.checks.overlays import chosen
from jaxcam.checks.page import Report
from jaxcam.checks.recorded.cameras import check_calibrations, check_sights
from jaxcam.checks.recorded.drifts import check_drift, unanswered
from jaxcam.checks.recorded.judged import Judged, ranking, suspicion
from jaxcam.checks.recorded.looks import Looks
from jaxcam.checks.recorded.motion import films_of
from jaxcam.checks.recorded.numbers import check_numbers, statistics_of_recording
from jaxcam.checks.recorded.overlays import draw_looks
from jaxcam.checks.recorded.pictures import check_pictures
from jaxcam.checks.recorded.places import Evidence, check_places
from jaxcam.checks.recorded.stills import check_stills
from jaxcam.console.progress import progress
from jaxcam.console.words import some
from jaxcam.data.recorded.parts import meaning_of
from jaxcam.data.recorded.recording import Recording
from jaxcam.reports.style import BLUE, FAINT, side_by_side, styled

LOOKED = 24
"""Episodes whose pictures are decoded, evenly spread; more where a change is looked for."""
CAPTION = (
    "What cameras see, with the axes of the base and of a frame at the grip (x red, y green, z "
    "blue) and the way of the grip (yellow) drawn where calibrations have them."
)


def check_recorded(
    recording: Recording,
    grip: str = "",
    count: int = 8,
    console: Console | None = None,
    robot: str = "",
) -> Report:
    """Examines a recorded dataset.

    Args:
        recording: The dataset.
        grip: Where its state has the grip's position, such as "observation.state[0:3]"; by names
            when empty.
        count: Episodes that are drawn over, of each view; 0 looks at no picture.
        console: For progress; silent when None.
        robot: The arm, `panda` or a file, by whose motion cameras are held against their poses
            where nothing else tells; not looked at when empty.

    Raises:
        ConfigError: `grip` names no three columns of the state, or the arm cannot be read.
    """
    meaning = meaning_of(recording, grip)
    judged = [Judged(_about(recording)), *check_numbers(recording, meaning)]
    judged += check_calibrations(recording)
    wrong = {j.finding.what for j in judged if j.finding.mark == "bad"}
    columns = meaning.grip if not wrong & {"numbers", "shapes", "camera poses"} else None
    if columns is None:
        judged.append(_no_grip(known=meaning.grip is not None))
    elif not count:
        judged += check_sights(recording, columns, unusable=_explained(judged))
    overlays = None
    if count:
        looks = Looks(recording)
        episodes = chosen(len(recording.episodes), LOOKED).tolist()
        _look(looks, episodes, console)
        if columns is not None:
            wrong_K = _explained(judged)
            evidence = Evidence.of(recording, films_of(looks, episodes, columns, wrong_K))
            judged += check_sights(recording, columns, evidence.of_reading, wrong_K)
            judged += check_places(evidence.without(_explained(judged)))
        judged += check_pictures(looks, columns, states="shapes" not in wrong)
        judged += (stills := list(check_stills(looks, episodes)))
        if robot:
            judged += check_drift(recording, unanswered(recording, stills), episodes, robot)
        if "camera poses" not in wrong:
            overlays = draw_looks(looks, episodes, columns, max(1, count // 2))
    total = suspicion(judged, len(recording.episodes))
    worst = ranking(recording, total)
    return Report(
        title=recording.path.name,
        subtitle=f"Recorded dataset of {len(recording.episodes)} episodes.",
        findings=[j.finding for j in (*judged, *([worst] if worst else []))],
        numbers=statistics_of_recording(recording),
        figures={"How suspicious each episode is, and how long.": _by_episode(recording, total)},
        overlays=overlays,
        caption=CAPTION,
    )


def _explained(judged: Sequence[Judged]) -> set[tuple[int, str]]:
    """Episodes and views whose calibration is known to be wrong."""
    return {(e, j.view) for j in judged if j.explained for e in j.episodes}


def _about(recording: Recording) -> Finding:
    asked = {e.instruction for e in recording.episodes if e.instruction}
    got = (
        f"{len(recording.episodes)} episodes, {sum(e.length for e in recording.episodes)} steps; "
        f"views {some(recording.views)}; {len(recording.state_names)} numbers of state, "
        f"{len(recording.action_names)} of action; {len(asked)} instructions"
    )
    return good("dataset", got=got)


def _no_grip(*, known: bool) -> Judged:
    if known:
        return Judged(note("cameras", got="not held against the grip: see what must be mended"))
    return Judged(
        note(
            "cameras",
            got="not held against the grip: no names say where the state has its position",
            fix="Give --grip observation.state[0:3] with the columns of x, y, z (base frame, m).",
        )
    )


def _look(looks: Looks, episodes: Sequence[int], console: Console | None) -> None:
    films = [(e, v) for e in episodes for v in looks.recording.episodes[e].sights]
    with progress(console, "looking", len(films)) as advance:
        for episode, view in films:
            looks.at(episode, view)
            advance()


@styled
def _by_episode(recording: Recording, total: np.ndarray) -> Figure:
    figure, (odd, long) = side_by_side((8.2, 3.2), columns=2)
    rows = np.arange(len(total))
    odd.bar(rows, total, color=BLUE, width=0.9)
    odd.set(xlabel="episode", ylabel="weight of findings", title="Suspicion")
    odd.set_ylim(0, max(1.0, float(total.max(initial=0)) * 1.1))
    long.bar(rows, [e.length for e in recording.episodes], color=BLUE, edgecolor=FAINT, width=1)
    long.set(xlabel="episode", ylabel="steps", title="Lengths")
    return figure
