"""What is wrong with pictures of a board that no lens explains."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxcam.config.calibrate import LensKind
from jaxcam.errors import DatasetError
from jaxcam.robot.calibration.boards import Board, BoardSeen
from jaxcam.robot.calibration.lens.fit import LensFit, fit_lens, residuals_at_best
from jaxcam.robot.calibration.projection import pixels_of, placed

LEAST = 4
"""Pictures that tell a lens."""
LARGE = 0.6
"""Root mean square of residuals in a picture from when on it is not explained (pixels at VGA)."""
TRIALS = 16
"""Triples of pictures that are tried where some must be of another camera."""
BENT = 0.5
"""Share of the squared residuals that another shape of the board explains, if it is not flat."""


@dataclass(frozen=True)
class Shape:
    """How far a board is from flat."""

    height: np.ndarray
    """Of its corners over the plane, [n] (m); NaN where too few pictures show one."""
    explained: float
    """Share of the squared residuals that this explains."""


def allowed(size: tuple[int, int]) -> float:
    """Residuals (pixels) from when on a picture is not explained: larger pictures have larger."""
    return LARGE * max(size[0] / 640, 0.5)


def per_picture(fit: LensFit) -> np.ndarray:
    """Root mean square residual of each picture, of all its corners, [pictures] (pixels)."""
    return np.array([np.sqrt((r**2).sum(-1).mean()) for r in fit.residuals])


def fit_checked(
    board: Board,
    views: Sequence[BoardSeen],
    size: tuple[int, int],
    kind: LensKind,
    coefficients: int,
) -> tuple[LensFit, list[str]]:
    """The fit of those pictures that one lens explains, and what was left out.

    Args:
        board: What is in them.
        views: The corners of each.
        size: Width and height of the pictures.
        kind: Model of the lens.
        coefficients: How many it has.

    Raises:
        DatasetError: They are of two cameras, of a board that is not flat, or of another one.
    """
    fit = fit_lens(board.points, views, size, kind, coefficients)
    most = allowed(size)
    if (per_picture(fit) < most).all():
        _check_flat(board, fit)
        return fit, []
    _check_flat(board, fit)
    one = _one_camera(board, views, size, kind, coefficients)
    rest = [i for i in range(len(views)) if i not in one]
    names = ", ".join(views[i].name for i in rest[:8])
    if len(one) < LEAST or len(rest) > max(2, len(views) // 4):
        _check_two(board, views, one, rest, size, kind, coefficients)
        _check_flat(board, fit, least=0.25)
        raise DatasetError(
            f"No lens explains these pictures: corners are {fit.rms:.2f} pixels off (expected "
            f"below {most:.2f}), worst in {names or views[int(np.argmax(per_picture(fit)))].name}. "
            f"Likely causes: the board is not {board.words}; it is not flat; the camera's focus or "
            "zoom changed; it is a fisheye (--lens fisheye), or is none; a rolling shutter: hold "
            "the board still."
        )
    fit = fit_lens(board.points, [views[i] for i in one], size, kind, coefficients)
    _check_flat(board, fit)
    return fit, [f"Left out, since the lens of the others does not explain them: {names}."]


def board_shape(board: Board, fit: LensFit) -> Shape:
    """How far the board is from flat, by what all pictures have in common.

    Args:
        board: The board.
        fit: Of its pictures.
    """
    count = len(board.points)
    normal, side = np.zeros((count, 3, 3)), np.zeros((count, 3))
    before = 0.0
    for view, pose, residuals, used in zip(
        fit.views, fit.boards, fit.residuals, fit.used, strict=True
    ):
        points = placed(pose, board.points[view.ids])
        slopes = np.stack(
            [
                (pixels_of(points + h, fit.optics) - pixels_of(points - h, fit.optics)) / 2e-5
                for h in 1e-5 * pose[:3, :3].T
            ],
            -1,
        )
        for i, J, r in zip(view.ids[used], slopes[used], residuals[used], strict=True):
            normal[i] += J.T @ J
            side[i] -= J.T @ r
        before += float((residuals[used] ** 2).sum())
    known = np.array([np.linalg.cond(n) < 1e8 if n.any() else False for n in normal])
    shift = np.full((count, 3), np.nan)
    shift[known] = np.linalg.solve(normal[known], side[known][..., None])[..., 0]
    gain = float(np.einsum("ni,ni->", side[known], shift[known]))
    used_count = 2 * sum(int(u.sum()) for u in fit.used)
    gain -= 3 * known.sum() * before / max(used_count, 1)  # what as many numbers explain of noise
    height = shift[:, 2]
    if known.sum() >= 4:
        plane = np.c_[board.points[:, :2], np.ones(count)]
        height = height - plane @ np.linalg.lstsq(plane[known], height[known], rcond=None)[0]
    return Shape(height, gain / max(before, 1e-12))


def _check_flat(board: Board, fit: LensFit, least: float = BENT) -> None:
    shape = board_shape(board, fit)
    if shape.explained > least and fit.rms > 0.25 * allowed((fit.optics.width, fit.optics.height)):
        most = 1000 * np.nanmax(np.abs(shape.height))
        raise DatasetError(
            f"The board is not flat, or is not {board.words}: its corners lie up to {most:.1f} mm "
            f"off their places, which explains {shape.explained:.0%} of what the fit leaves "
            f"({fit.rms:.2f} pixels). Glue the print on glass, acrylic or a book's cover, measure "
            "a square on it (--square-mm), and take the pictures anew."
        )


def _one_camera(
    board: Board,
    views: Sequence[BoardSeen],
    size: tuple[int, int],
    kind: LensKind,
    coefficients: int,
) -> list[int]:
    """The largest group of pictures that one lens explains."""
    rng, best = np.random.default_rng(0), []
    few = min(coefficients, 4)
    for trial in range(TRIALS):
        # Pictures of one camera mostly follow each other.
        first = int(rng.integers(len(views))) if trial % 2 else trial * len(views) // TRIALS
        some = [(first + i) % len(views) for i in range(LEAST)]
        if trial % 2:
            some = rng.choice(len(views), min(LEAST, len(views)), replace=False).tolist()
        try:
            fit = fit_lens(board.points, [views[i] for i in some], size, kind, few)
        except DatasetError:
            continue
        if (per_picture(fit) > allowed(size)).any():
            continue
        off = [_off(board, view, fit) for view in views]
        group = [i for i, value in enumerate(off) if value < allowed(size)]
        best = group if len(group) > len(best) else best
        if len(best) > 0.9 * len(views):
            break
    return best


def _off(board: Board, view: BoardSeen, fit: LensFit) -> float:
    """Residuals of a picture (pixels) for a lens, at the best pose of the board."""
    off = residuals_at_best(board.points[view.ids], view.pixels, fit)
    return float(np.sqrt((off**2).sum(-1).mean()))


def _check_two(
    board: Board,
    views: Sequence[BoardSeen],
    one: Sequence[int],
    rest: Sequence[int],
    size: tuple[int, int],
    kind: LensKind,
    coefficients: int,
) -> None:
    if min(len(one), len(rest)) < LEAST:
        return
    try:
        fits = [
            fit_lens(board.points, [views[i] for i in some], size, kind, min(coefficients, 4))
            for some in (one, rest)
        ]
    except DatasetError:
        return
    if max(np.median(per_picture(fit)) for fit in fits) > allowed(size):
        return
    words = [
        f"{len(some)} with a focal length of {fit.optics.K[0, 0]:.0f} pixels "
        f"({views[some[0]].name} …)"
        for some, fit in zip((one, rest), fits, strict=True)
    ]
    raise DatasetError(
        f"Pictures of two cameras, or of one whose zoom or focus changed: {' and '.join(words)}. "
        "Calibrate each with its own pictures; turn autofocus off."
    )
