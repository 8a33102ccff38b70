"""`calibrate lens`: from pictures of a board to K and lens in the file of calibrations."""

import hashlib
from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console

from jaxcam.config.calibrate import LensConfig
from jaxcam.errors import DatasetError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.writing import Changes, check_updatable, optics_json, update_cameras
from jaxcam.robot.calibration.boards import Board, BoardSeen, marker_sides, why_not
from jaxcam.robot.calibration.figures import coverage_figure, residual_figure, space_figure
from jaxcam.robot.calibration.lens.coverage import missing_places, missing_tilts, most_different
from jaxcam.robot.calibration.lens.faults import fit_checked
from jaxcam.robot.calibration.lens.fit import LensFit
from jaxcam.robot.calibration.lens.printing import print_board
from jaxcam.robot.calibration.page import (
    CalibrationPage,
    overlay,
    page_path,
    show_calibration,
    spread_out,
)
from jaxcam.robot.calibration.pictures import NamedPicture, read_pictures

LEAST = 6
"""Pictures with the board that are needed."""
MARKER = 0.06
"""Share by which markers may look larger or smaller than they are said to be."""
LOST = 4.0
"""Two standard deviations of the rays of most of the picture (pixels at VGA) from when on nothing
is written."""
GOOD, FAIR = 0.5, 2.0
"""Two standard deviations of the worst ray (pixels at VGA) of a good lens, and of a usable one."""
UNKNOWN = 0.02
"""Standard deviation of the focal length, as a share of it, from when on nothing is written."""


def calibrate_lens(config: LensConfig, console: Console) -> None:
    """Runs the form; see `LensConfig`.

    Raises:
        ConfigError: Settings do not go together, or a place has something else.
        DatasetError: The pictures are not what is needed; the message says what is missing.
    """
    marker = 0.7 * config.square_mm if config.marker_mm is None else config.marker_mm
    board = Board(config.board, config.columns, config.rows, config.square_mm / 1000,
                  marker / 1000, config.family)  # fmt: skip
    if config.print_board:
        path = absolute(config.print_board)
        sheet = print_board(board, path)
        console.print(
            f"Wrote {path} for {sheet}, landscape: print it at 100 %, glue it on something flat, "
            "and measure the line below the board.", soft_wrap=True,
        )  # fmt: skip
        return
    cameras = absolute(config.cameras)
    check_updatable(cameras)
    path = page_path(config.out, cameras, "lens", config.view)
    with console.status("looking for the board"):
        pictures, views, notes = find_boards(read_pictures(config.pictures), board)
    count = len(views)
    chosen = most_different(views, board.points, config.most)
    pictures, views = [pictures[i] for i in chosen], [views[i] for i in chosen]
    if len(chosen) < count:
        notes.append(f"Of {count} pictures with the board, the {len(chosen)} that differ most.")
    coefficients = 4 if config.lens == "fisheye" else config.coefficients
    with console.status("calibrating"):
        fit, left_out = fit_checked(board, views, pictures[0].size, config.lens, coefficients)
    notes += _markers(board, fit)
    names = {view.name for view in fit.views}
    pictures = [p for p in pictures if p.name in names]
    notes += left_out + _advice(fit)
    _require_known(fit)
    page = _page(config, board, fit, pictures, notes)
    entries = optics_json(
        fit.optics.K, (fit.optics.width, fit.optics.height), fit.kind, fit.coefficients
    )
    about = {"lens": _about(fit, board)}
    update_cameras(cameras, Changes({config.view: entries}, about={config.view: about}))
    show_calibration(page, path, console, f"{cameras}: K and lens of view {config.view}.")


def find_boards(
    pictures: Iterator[NamedPicture], board: Board
) -> tuple[list[NamedPicture], list[BoardSeen], list[str]]:
    """The pictures that show the board, its corners in each, and what there is to know.

    Args:
        pictures: Of one camera.
        board: What they should show.

    Raises:
        DatasetError: Too few show it; the message says which, and why if that can be seen.
    """
    there, views, without, reasons, copies = [], [], [], [], []
    known: dict[bytes, str] = {}
    for picture in pictures:
        seal = hashlib.sha256(picture.rgb.tobytes()).digest()
        if seal in known:
            copies.append(f"{picture.name} (of {known[seal]})")
            continue
        known[seal] = picture.name
        view = board.find(picture.grey, picture.name)
        if view is not None:
            there.append(picture)
            views.append(view)
            continue
        without.append(picture.name)
        if len(reasons) < 3 and (reason := why_not(picture.grey, board)):
            reasons.append(f"in {picture.name} {reason}")
    named = ", ".join(without[:6]) + (f" and {len(without) - 6} more" if len(without) > 6 else "")
    twice = f"Copies do not count: {', '.join(copies[:4])}{' …' * (len(copies) > 4)}."
    if len(views) < LEAST:
        why = f" {reasons[0][0].upper()}{reasons[0][1:]}." if reasons else ""
        why += f" {twice}" if copies else ""
        raise DatasetError(
            f"{len(views)} of {len(views) + len(without)} pictures show the board ({board.words}); "
            f"at least {LEAST} are needed, 20 are good. Not in {named or 'any other'}.{why} "
            "The detector needs squares of 10 pixels or more, sharp, not overexposed, with the "
            "board's white margin; a plain chessboard must be seen whole."
        )
    notes = [f"No board in {len(without)} pictures: {named}."] if without else []
    notes += [twice] if copies else []
    return there, views, notes


def _advice(fit: LensFit) -> list[str]:
    size = fit.optics.width, fit.optics.height
    notes = []
    if len(fit.views) < 15:
        notes.append(f"{len(fit.views)} pictures: take 20.")
    if places := missing_places(fit.views, size):
        notes.append(f"No corners, so rays are extrapolated, in: {', '.join(places)}. "
                     "Hold the board there, also so that a part of it is outside.")  # fmt: skip
    if tilts := missing_tilts(fit.boards):
        notes.append(f"No picture with the board tilted by 15 degrees or more so that its "
                     f"{', its '.join(tilts)} is: such pictures tell the focal length from the "
                     "distance.")  # fmt: skip
    return notes


def _markers(board: Board, fit: LensFit) -> list[str]:
    """That markers look larger or smaller than was said."""
    side = marker_sides(board, fit.views)
    if not abs(side / board.marker - 1) > MARKER:  # also where there is none
        return []
    return [
        f"Markers look {1000 * side:.1f} mm large beside squares of {1000 * board.square:g} mm, "
        f"not {1000 * board.marker:g}: measure both (--square-mm, --marker-mm). K and the lens "
        "do not depend on it, poses found with this board do."
    ]


def _require_known(fit: LensFit) -> None:
    share = max(fit.sigmas[0] / fit.optics.K[0, 0], fit.sigmas[1] / fit.optics.K[1, 1])
    centre = max(fit.sigmas[2:4]) / fit.optics.width
    rays = 2 * float(np.nanmedian(fit.rays))
    if share > UNKNOWN or centre > UNKNOWN or rays > LOST * max(fit.optics.width / 640, 0.5):
        missing = missing_tilts(fit.boards)
        tilts = f"with its {', with its '.join(missing)}" if missing else "more strongly tilted"
        raise DatasetError(
            f"These pictures do not tell the lens: the focal length is sure to {share:.1%} and the "
            f"centre to {centre:.1%} of the width (expected below {UNKNOWN:.0%}), rays to "
            f"{rays:.1f} pixels. Likely cause: the board is parallel to the picture, or the same, "
            f"in all of them. Take pictures "
            f"{tilts}, by 30 degrees or more, near and far."
        )


def _verdict(fit: LensFit) -> tuple[str, bool]:
    worst, middle = 2 * float(np.nanmax(fit.rays)), 2 * float(np.nanmedian(fit.rays))
    scale = max(fit.optics.width / 640, 0.5)
    degrees = np.rad2deg(middle / fit.optics.K[0, 0])
    sure = f"rays are known to {middle:.2f} pixels ({degrees:.3f} degrees) in most of the picture"
    if worst <= GOOD * scale:
        return f"Good enough: {sure}, and to {worst:.2f} in its worst corner.", True
    if worst <= FAIR * scale:
        return (
            f"Good enough for most uses: {sure}, but only to {worst:.2f} in its worst corner; "
            "more pictures there would help.", True,
        )  # fmt: skip
    return (
        f"Not good enough at the picture's edge: {sure}, but only to {worst:.2f} in its worst "
        "corner. Take more pictures there.", False,
    )  # fmt: skip


def _about(fit: LensFit, board: Board) -> dict[str, object]:
    names = ("fx", "fy", "cx", "cy")
    return {
        "board": board.words,
        "pictures": len(fit.views),
        "rms_pixels": round(fit.rms, 3),
        "worst_ray_pixels": round(2 * float(np.nanmax(fit.rays)), 3),
        "deviations": {n: round(float(s), 3) for n, s in zip(names, fit.sigmas[:4], strict=True)},
    }


def _page(
    config: LensConfig,
    board: Board,
    fit: LensFit,
    pictures: Sequence[NamedPicture],
    notes: Sequence[str],
) -> CalibrationPage:
    verdict, good = _verdict(fit)
    size = fit.optics.width, fit.optics.height
    K = fit.optics.K
    values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    rows = [
        (name, f"{value:.2f} pixels", f"{sigma:.2f}")
        for name, value, sigma in zip(("fx", "fy", "cx", "cy"), values, fit.sigmas, strict=False)
    ]
    letters = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    letters = ("k1", "k2", "k3", "k4") if fit.kind == "fisheye" else letters
    rows += [
        (name, f"{value:.5f}", f"{sigma:.5f}")
        for name, value, sigma in zip(letters, fit.coefficients, fit.sigmas[4:], strict=False)
    ]
    rows.append(("corners are off by (RMS)", f"{fit.rms:.3f} pixels", ""))
    rows.append(("corners that count", f"{sum(int(u.sum()) for u in fit.used)}", ""))
    overlays = {}
    for i in spread_out(len(fit.views)):
        view = fit.views[i]
        fitted = view.pixels + fit.residuals[i]
        overlays[f"{view.name}: rings are the corners, crosses where the calibration has them."] = (
            overlay(pictures[i].rgb, view.pixels, fitted, fit.used[i])
        )
    squares = np.array([[0, 0], [board.columns, 0], [board.columns, board.rows], [0, board.rows]])
    edge = np.c_[board.square * squares, np.zeros(4)]
    corners = np.stack([edge @ b[:3, :3].T + b[:3, 3] for b in fit.boards])
    figures = {
        "Where corners were seen, and how sure the rays are.": coverage_figure(fit),
        "What the fit leaves of each corner.": residual_figure(
            np.concatenate([v.pixels for v in fit.views]),
            np.concatenate(fit.residuals), np.concatenate(fit.used), size,
        ),
        "The board before the camera (x right, y down, z forward).": space_figure(
            {config.view: [np.eye(4)]}, {config.view: fit.optics}, {"board": corners}, "camera"
        ),
    }  # fmt: skip
    subtitle = f"{len(fit.views)} pictures of {size[0]}x{size[1]}, {board.words}"
    return CalibrationPage(
        f"Lens of {config.view}", subtitle, verdict, good, rows,
        notes=notes, overlays=overlays, figures=figures,
    )  # fmt: skip
