"""Whether the numbers of a recorded dataset make sense: finite, of one rate, without jumps."""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxcam.checks.dataset import twins
from jaxcam.checks.findings import bad, good, note
from jaxcam.checks.numbers import SHORT, STILL, Spread, check_errors
from jaxcam.checks.recorded.judged import Judged, called, names
from jaxcam.console.words import some
from jaxcam.data.recorded.parts import Meaning
from jaxcam.data.recorded.recording import Episode, Recording

RATES = (1.0, 240.0)
"""Steps a second that robots are recorded with."""
FASTEST = 4.0
"""Speed (m/s) of a grip that no arm reaches."""
ODD_LENGTH = 4.0
"""How many times the median an episode's length may be, or the median it."""
FULL_TURN = 2 * np.pi
NEAR_TURN = 0.5
"""How much less (rad) than a full turn a jump may be that is one."""
STEADY = 1.0
"""Median step (rad) up to which a number can be an angle."""
JUMP = 5.0
"""Times the 95th percentile of a number's steps, and share of its range, beyond which one jumps."""
JUMP_SHARE = 0.3
OUTLIER = 20.0
"""How many times the spread of the middle 90 % a number may lie outside it."""
LEVELS = 8
"""Values up to which a number is a switch, which may jump."""


def check_numbers(recording: Recording, meaning: Meaning) -> Iterator[Judged]:
    """Checks that look at no picture and no camera."""
    yield from _shapes(recording)
    finite = _finite(recording)
    yield finite
    yield _lengths(recording)
    yield _duplicates(recording)
    if finite.finding.mark == "good":
        yield _rate(recording, meaning)
        yield _constants(recording)
        yield from _jumps(recording)
        yield _outliers(recording)
    if any(episode.errors is not None for episode in recording.episodes):
        yield Judged(check_errors(recording.episodes))


def _arrays(episode: Episode) -> dict[str, np.ndarray]:
    return {"state": episode.state, "action": episode.action}


def _columns(recording: Recording) -> dict[str, Sequence[str]]:
    return {"state": recording.state_names, "action": recording.action_names}


def _shapes(recording: Recording) -> Iterator[Judged]:
    """Bad findings where arrays are not as long as the episode, or not as wide as their names."""
    wrong = [
        i
        for i, episode in enumerate(recording.episodes)
        for what, array in _arrays(episode).items()
        if array.shape != (episode.length, len(_columns(recording)[what]))
    ]
    if wrong:
        yield Judged(
            bad(
                "shapes",
                got=f"{len(wrong)} arrays are of other shapes than steps and names say",
                where=names(recording, wrong),
                fix="Write state and action with one row a step and one name a column.",
            ),
            tuple(wrong),
        )


def _finite(recording: Recording) -> Judged:
    wrong, places = [], []
    for i, episode in enumerate(recording.episodes):
        for what, array in _arrays(episode).items():
            rows = np.flatnonzero(~np.isfinite(array).all(-1))
            if len(rows):
                wrong.append(i)
                places.append(f"{what} of {called(episode)} from step {rows[0]} on")
    if not wrong:
        return Judged(good("numbers", got="all are finite"))
    return Judged(
        bad(
            "numbers",
            got=f"{len(places)} arrays have NaN or infinity",
            expected="finite numbers",
            where=some(places),
            fix="Leave those episodes out, or cut them before it.",
        ),
        tuple(wrong),
    )


def _lengths(recording: Recording) -> Judged:
    lengths = np.array([e.length for e in recording.episodes])
    middle = np.median(lengths)
    got = f"{lengths.min()} to {lengths.max()} steps, half below {middle:.0f}"
    odd = (lengths < SHORT) | (lengths * ODD_LENGTH < middle) | (lengths > ODD_LENGTH * middle)
    if not odd.any():
        return Judged(good("lengths", got=got))
    episodes = np.flatnonzero(odd).tolist()
    fix = "Look whether they were cut short, or ran on after their end."
    expected = f"at least {SHORT}, and all within {ODD_LENGTH:g} times the median"
    where = names(recording, episodes)
    return Judged(note("lengths", got=got, expected=expected, where=where, fix=fix), (*episodes,))


def _duplicates(recording: Recording) -> Judged:
    same = [*twins(recording.episodes, lambda e: e.state.tobytes() + e.action.tobytes())]
    if not same:
        return Judged(good("duplicates", got=f"all {len(recording.episodes)} episodes differ"))
    pairs = [f"{recording.episodes[i].name} = {recording.episodes[k].name}" for i, k in same]
    return Judged(
        bad(
            "duplicates",
            got=f"{len(same)} are copies of earlier ones",
            expected="none",
            where=some(pairs),
            fix="Leave the copies out: one may be held out, and the other trained on.",
        ),
        tuple(k for _, k in same),
    )


def _rate(recording: Recording, meaning: Meaning) -> Judged:
    rate = recording.rate
    got = f"{rate:g} steps a second"
    if not RATES[0] <= rate <= RATES[1]:
        expected = f"{RATES[0]:g} to {RATES[1]:g}"
        fix = "Write the rate of the states, in steps a second."
        return Judged(bad("rate", got=got, expected=expected, fix=fix))
    if meaning.grip is None:
        return Judged(good("rate", got=got))
    fastest = np.array(
        [_fastest(e.state[:, list(meaning.grip)]) * rate for e in recording.episodes]
    )
    if (fastest <= FASTEST).all():
        got += f"; the grip moves at up to {fastest.max():.2g} m/s"
        return Judged(good("rate", got=got))
    episodes = np.flatnonzero(fastest > FASTEST).tolist()
    return Judged(
        note(
            "rate",
            got=f"{got}, so the grip moves at up to {fastest.max():.3g} m/s",
            expected=f"at most {FASTEST:g} m/s",
            where=names(recording, episodes),
            fix="The rate or the unit is another, steps are missing, or these are not the grip's "
            "position in metres.",
        ),
        tuple(episodes),
    )


def _fastest(places: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(places, axis=0), axis=-1).max(initial=0.0))


def _constants(recording: Recording) -> Judged:
    constant = []
    for what, columns in _columns(recording).items():
        values = np.concatenate([_arrays(e)[what] for e in recording.episodes])
        still = np.ptp(values, axis=0) <= STILL
        constant += [f"{what} {name}" for name, s in zip(columns, still, strict=True) if s]
    if not constant:
        return Judged(good("constant numbers", got="none"))
    fix = "Statistics have a floor, so nothing blows up; but a policy learns nothing of these."
    return Judged(note("constant numbers", got=some(constant), expected="none", fix=fix))


def _jumps(recording: Recording) -> Iterator[Judged]:
    """Jumps by a turn in both arrays, and others in the state, which a robot cannot make."""
    turns: dict[str, list[int]] = {}
    leaps: dict[str, list[int]] = {}
    for what, columns in _columns(recording).items():
        for column, name in enumerate(columns):
            each = [_arrays(e)[what][:, column] for e in recording.episodes]
            if wrapping := _wrapping(each):
                turns[f"{what} {name}"] = wrapping
            elif what == "state" and (jumping := _jumping(each)):
                leaps[f"{what} {name}"] = jumping
    if not turns and not leaps:
        yield Judged(good("jumps", got="none"))
    if turns:
        episodes = sorted({i for each in turns.values() for i in each})
        yield Judged(
            note(
                "jumps",
                got=f"by a full turn (2π): {some([*turns])}",
                expected="angles without jumps",
                where=names(recording, episodes),
                fix="Unwrap angles (numpy.unwrap) or keep them away from ±π: a policy that "
                "averages both sides turns the wrong way.",
            ),
            tuple(episodes),
        )
    if leaps:
        episodes = sorted({i for each in leaps.values() for i in each})
        yield Judged(
            note(
                "jumps",
                got=f"far beyond a usual step: {some([*leaps])}",
                expected="what a robot can do in a step",
                where=names(recording, episodes),
                fix="Steps are missing there, or a sensor failed.",
            ),
            tuple(episodes),
        )


def _wrapping(each: Sequence[np.ndarray]) -> list[int]:
    """Episodes in which one number, if it is an angle, jumps by a turn."""
    steps = [abs(np.diff(x)) for x in each]
    if np.ptp(np.concatenate(each)) > FULL_TURN + NEAR_TURN:
        return []
    if np.median(np.concatenate(steps) if any(map(len, steps)) else [np.inf]) > STEADY:
        return []
    return [i for i, s in enumerate(steps) if (s > FULL_TURN - NEAR_TURN).any()]


def _jumping(each: Sequence[np.ndarray]) -> list[int]:
    """Episodes in which one number jumps."""
    values = np.concatenate(each)
    if len(np.unique(values)) <= LEVELS or len(values) == len(each):
        return []
    steps = [abs(np.diff(x)) for x in each]
    least = max(JUMP * np.percentile(np.concatenate(steps), 95), JUMP_SHARE * np.ptp(values))
    return [i for i, s in enumerate(steps) if (s > least).any()]


def _outliers(recording: Recording) -> Judged:
    odd: dict[str, list[int]] = {}
    for what, columns in _columns(recording).items():
        values = np.concatenate([_arrays(e)[what] for e in recording.episodes]).astype(float)
        low, high = np.percentile(values, [5, 95], axis=0)
        spread = np.where(high - low > STILL, high - low, np.inf)
        for i, episode in enumerate(recording.episodes):
            array = _arrays(episode)[what]
            far = (np.maximum(low - array, array - high) > OUTLIER * spread).any(0)
            for column in np.flatnonzero(far).tolist():
                odd.setdefault(f"{what} {columns[column]}", []).append(i)
    if not odd:
        return Judged(good("outliers", got="none"))
    episodes = sorted({i for each in odd.values() for i in each})
    return Judged(
        note(
            "outliers",
            got=f"far outside all others: {some([*odd])}",
            expected=f"within {OUTLIER:g} times the spread of the middle 90 %",
            where=names(recording, episodes),
            fix="A few numbers stretch the statistics for all: mend them, or leave those out.",
        ),
        tuple(episodes),
    )


def statistics_of_recording(recording: Recording) -> list[Spread]:
    """Least, middle and largest value of each number."""
    rows = [("steps", np.array([e.length for e in recording.episodes]))]
    for what, columns in _columns(recording).items():
        values = np.concatenate([_arrays(e)[what] for e in recording.episodes])
        rows += [(f"{what}, {name}", x) for name, x in zip(columns, values.T, strict=True)]
    return [(name, f"{x.min():.4g}", f"{np.median(x):.4g}", f"{x.max():.4g}") for name, x in rows]
