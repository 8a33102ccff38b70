"""Whether calibrations of a recorded dataset can be: K, lens and pose, and the grip in view."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxcam.checks.findings import Finding, bad, good, note
from jaxcam.checks.overlays import chosen
from jaxcam.checks.recorded.judged import Judged, names
from jaxcam.checks.recorded.motion import FITS
from jaxcam.console.words import some
from jaxcam.data.cameras import (
    EXPECTED,
    POINTS,
    CameraFaults,
    Reading,
    Sights,
    faults,
    readings_that_fit,
)
from jaxcam.data.recorded.recording import Calibration, Recording
from jaxcam.errors import CameraError
from jaxcam.rays import check_pose
from jaxcam.rays.lens import valid

OFF_CENTRE = 0.15
"""How far from the middle, in pictures, a principal point may be."""
FIELD_DEG = (15.0, 150.0)
"""Fields of view that cameras have, across the picture."""
SQUARE = 0.1
"""How far fx / fy may be from 1."""
SCALED = 0.15
"""How far K may be from the picture's size, if by one ratio along both sides."""
ALIKE = 0.05
"""How far those two ratios may differ to be one."""
LIT = 0.98
"""Share of pixels that should have a ray."""
DARK = 0.5
"""Share of pixels with a ray below which the coefficients cannot be meant."""
UNEXPLAINED = (
    "No usual mix-up of conventions explains it: look at the pictures. Poses are of another base "
    "or camera, or K is of another picture."
)
"""What to do where no reading of the poses fits."""
MOSTLY = 0.5
"""Share of the steps at which a carried camera may be odd: it does not always see the grip."""

Fits = Callable[[Reading, Sequence[str]], float | None]


@dataclass(frozen=True)
class Stand:
    """A calibration, and the episodes in which a view had it."""

    view: str
    calibration: Calibration
    height: int
    width: int
    episodes: list[int] = field(default_factory=list)

    @property
    def moves(self) -> bool:
        """Whether it holds picture by picture."""
        return self.calibration.base_from_camera.ndim == 3


def stands_of(recording: Recording) -> list[Stand]:
    """The different calibrations of a dataset, by view."""
    stands: dict[tuple[object, ...], Stand] = {}
    for i, episode in enumerate(recording.episodes):
        for view, sight in episode.sights.items():
            if sight.calibration:
                key = view, sight.height, sight.width, same_key(sight.calibration)
                stand = Stand(view, sight.calibration, sight.height, sight.width)
                stands.setdefault(key, stand).episodes.append(i)
    return list(stands.values())


def same_key(calibration: Calibration | None) -> bytes:
    """What two calibrations share if they are the same; none is the same as none."""
    if calibration is None:
        return b""
    parts = calibration.K, calibration.base_from_camera, calibration.distortion
    return b"".join(np.asarray(part, np.float64).tobytes() for part in parts)


def check_calibrations(recording: Recording) -> Iterator[Judged]:
    """Whether there are calibrations, and each of them can be."""
    stands = stands_of(recording)
    known = {stand.view for stand in stands}
    lacking = [
        (i, view)
        for i, episode in enumerate(recording.episodes)
        for view, sight in episode.sights.items()
        if not sight.calibration
    ]
    if lacking:
        yield Judged(
            note(
                "calibrations",
                got=f"nobody says where cameras stood in {len(lacking)} films",
                expected="K and base_from_camera of each",
                where=f"views {some(sorted({view for _, view in lacking}))}",
                fix="Give --cameras FILE (docs/calibrated-datasets.md); without, policies are "
                "trained with --conditioning none.",
            ),
            tuple(i for i, view in lacking if view in known),
        )
    elif stands:
        sources = sorted({s.calibration.source for s in stands if s.calibration.source})
        got = f"{len(stands)} of {len(known)} views"
        yield Judged(good("calibrations", got=got, where=some(sources)))
    if stands:
        yield from _poses(recording, stands)
        yield from _each(recording, stands, "K", _intrinsics)
        yield from _each(recording, stands, "lenses", _lens)


def _poses(recording: Recording, stands: Sequence[Stand]) -> Iterator[Judged]:
    wrong = False
    for stand in stands:
        try:
            check_pose(f"view {stand.view}", stand.calibration.base_from_camera)
        except CameraError as error:
            wrong = True
            where = names(recording, stand.episodes)
            fix = "Write those poses anew."
            finding = bad("camera poses", got=str(error), where=where, fix=fix)
            yield Judged(finding, tuple(stand.episodes))
    if not wrong:
        count = sum(len(np.atleast_3d(s.calibration.base_from_camera)) if s.moves else 1
                    for s in stands)  # fmt: skip
        yield Judged(good("camera poses", got=f"{count} rigid transforms"))


def _each(
    recording: Recording,
    stands: Sequence[Stand],
    what: str,
    check: Callable[[Stand], Finding | None],
) -> Iterator[Judged]:
    """One finding for each view whose calibrations a check finds odd, or that none is."""
    odd: dict[tuple[str, Finding], list[int]] = {}
    for stand in stands:
        if finding := check(stand):
            odd.setdefault((stand.view, finding), []).extend(stand.episodes)
    for (view, finding), episodes in odd.items():
        where = f"view {view}, {names(recording, episodes)}"
        named = replace(finding, where=where)
        yield Judged(named, tuple(episodes), view, explained=finding.mark == "bad")
    if not odd:
        yield Judged(good(what, got=f"nothing is odd about {len(stands)} calibrations"))


def _intrinsics(stand: Stand) -> Finding | None:
    """What is odd about K, if anything is; of a moving camera, at its first step."""
    K = np.asarray(stand.calibration.K, float).reshape(-1, 3, 3)[0]
    height, width = stand.height, stand.width
    f = abs(K[0, 0]), K[1, 1]
    if not (np.isfinite(K).all() and min(f) > 0):
        fix = "Calibrate that camera anew."
        return bad("K", got=f"K = {K.tolist()}", expected="finite, focal lengths > 0", fix=fix)
    ratios = 2 * K[0, 2] / width, 2 * K[1, 2] / height
    ratio = float(np.mean(ratios))
    off = max(abs(r / 2 - 0.5) for r in ratios)
    scaled = min(ratios) > 0 and max(ratios) - min(ratios) <= ALIKE * ratio
    if off > OFF_CENTRE or (scaled and abs(ratio - 1) > SCALED):
        got = f"principal point ({K[0, 2]:.4g}, {K[1, 2]:.4g}) of a picture of {width} x {height}"
        expected = "near its middle"
        if scaled:
            size = f"{round(width * ratio)} x {round(height * ratio)}"
            fix = (
                f"Likely cause: K is for pictures of {size}, {ratio:.3g} times these. Divide its "
                f"first two rows by {ratio:.3g}, or write the size that it is for beside it."
            )
            return bad("K", got=got, expected=expected, fix=fix)
        fix = "K is of another shape of picture, or pictures were cropped and K was not."
        return note("K", got=got, expected=expected, fix=fix)
    field_deg = float(np.rad2deg(2 * np.arctan(width / 2 / f[0])))
    fisheye = bool(stand.calibration.distortion[..., -1].any())
    if not fisheye and not FIELD_DEG[0] <= field_deg <= FIELD_DEG[1]:
        got = f"a field of view of {field_deg:.3g}° across"
        expected = f"{FIELD_DEG[0]:g}° to {FIELD_DEG[1]:g}°"
        fix = "Focal lengths are in pixels of the recorded pictures."
        return note("K", got=got, expected=expected, fix=fix)
    if abs(f[0] / f[1] - 1) > SQUARE:
        got = f"fx {f[0]:.4g} and fy {f[1]:.4g}"
        fix = "Right only if pictures were scaled without keeping their shape."
        return note("K", got=got, expected="nearly equal", fix=fix)
    return None


def _lens(stand: Stand) -> Finding | None:
    """What is odd about the lens, if anything is."""
    distortion = np.asarray(stand.calibration.distortion, float)
    if not distortion.any():
        return None
    K = np.asarray(stand.calibration.K, float).reshape(-1, 3, 3)[0]
    try:
        lit = float(np.mean(valid(K, stand.height, stand.width, distortion)))
    except CameraError as error:
        return bad("lenses", got=str(error), fix="Calibrate that camera anew.")
    if lit >= LIT:
        return None
    finding = bad if lit < DARK else note
    return finding(
        "lenses",
        got=f"only {lit:.0%} of the pixels have a ray",
        expected=f"at least {LIT:.0%}",
        fix="Pixels without a ray are told to the policy as zero. Right for a fisheye whose image "
        "is a disc; else coefficients are in another order, or of another model.",
    )


def check_sights(
    recording: Recording,
    grip: Sequence[int],
    fits: Fits | None = None,
    unusable: Collection[tuple[int, str]] = (),
) -> Iterator[Judged]:
    """Whether cameras, whose poses are rigid, can have seen the grip.

    Args:
        recording: The dataset.
        grip: Columns of the state that are the grip's position.
        fits: How well poses fit the pictures of some views if they mean something else, 0 to 1, or
            None where nobody knows; None where no picture was looked at.
        unusable: Episodes and views whose calibration is known to be wrong.
    """
    stands = [s for s in stands_of(recording) if (s.episodes[0], s.view) not in unusable]
    fine, wrong = 0, []
    for view in recording.views:
        own = [stand for stand in stands if stand.view == view]
        if not own:
            continue
        sights, episodes = _sights(recording, own, grip)
        result = CameraFaults(sights.rows, faults(sights), None)
        if result.odd.mean() <= (MOSTLY if sights.carried else 0):
            fine += 1
        else:
            wrong.append((view, sights, result, episodes))
    if not wrong:
        yield Judged(good("cameras", got=f"{fine} views have the grip in their pictures"))
        return
    usable = [_only_rolled(result) for _, _, result, _ in wrong]
    cause = None
    if not all(usable):
        cause = _cause([w[0] for w in wrong], [w[1] for w in wrong], fits)
    for (view, _, result, episodes), rolled in zip(wrong, usable, strict=True):
        odd = sorted({e for i in np.flatnonzero(result.odd) for e in episodes[i]})
        reasons = " or ".join(fault for fault, mask in result.by_fault.items() if mask.any())
        got = f"the {'picture' if rolled else 'grip'} is {reasons}"
        if len(result.odd) > 1:
            got += f" for {result.odd.sum()} of its {len(result.odd)} calibrations"
        finding = (note if rolled and not cause else bad)(
            "cameras",
            got=got,
            expected=EXPECTED,
            where=f"view {view}, {names(recording, odd)}",
            fix=f"Likely cause: {cause.words}." if cause else UNEXPLAINED,
        )
        yield Judged(finding, tuple(odd), view, explained=cause is not None)


def _only_rolled(result: CameraFaults) -> bool:
    """Whether cameras are upside down and no more, as some are mounted."""
    others = [mask for fault, mask in result.by_fault.items() if fault != "upside down"]
    return not np.any(others)


def _cause(views: Sequence[str], each: Sequence[Sights], fits: Fits | None) -> Reading | None:
    """The mix-up that explains the views that are wrong, by the grip and by what moves."""
    readings = readings_that_fit(_joint(each), np.eye(4))
    if fits is None or not readings:
        return next(iter(readings), None)
    known = {i: fit for i, r in enumerate(readings) if (fit := fits(r, views)) is not None}
    if not known:
        return readings[0]
    best = max(known, key=lambda i: known[i])
    return readings[best] if known[best] >= FITS else None


def _sights(
    recording: Recording, stands: Sequence[Stand], grip: Sequence[int]
) -> tuple[Sights, list[list[int]]]:
    """The cameras of a view with places of the grip, and the episodes of each.

    A camera that moves is one for each of some steps.
    """
    columns, rows = list(grip), []
    moves = any(stand.moves for stand in stands)
    for stand in stands:
        places = [
            np.asarray(recording.episodes[i].state[:, columns], float) for i in stand.episodes
        ]
        K, pose = stand.calibration.K, stand.calibration.base_from_camera
        if not moves:
            points = np.concatenate(places)
            points = points[np.linspace(0, len(points) - 1, POINTS).astype(int)]
            rows.append((np.reshape(K, (-1, 3, 3))[0], pose, points, stand))
            continue
        steps = chosen(len(places[0]), POINTS)
        Ks, poses = (np.broadcast_to(x, (len(places[0]), *x.shape[-2:])) for x in (K, pose))
        rows += [(Ks[t], poses[t], places[0][t : t + 1], stand) for t in steps]
    return Sights(
        rows=np.arange(len(rows)),
        poses=np.stack([r[1] for r in rows]).astype(float),
        points=np.stack([r[2] for r in rows]),
        K=np.stack([r[0] for r in rows]).astype(float),
        sizes=np.array([(r[3].height, r[3].width) for r in rows], float),
        lenses=np.stack([r[3].calibration.distortion for r in rows]).astype(float),
        carried=moves,
    ), [r[3].episodes for r in rows]


def _joint(each: Sequence[Sights]) -> Sights:
    """Several views' cameras as one, so that one mix-up must explain all; carried ones apart."""
    still = [s for s in each if not s.carried] or list(each)
    parts = {
        name: np.concatenate([getattr(s, name) for s in still])
        for name in ("rows", "poses", "points", "K", "sizes", "lenses")
    }
    return Sights(**parts, carried=still[0].carried)
