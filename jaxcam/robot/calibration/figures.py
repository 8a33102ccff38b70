"""Figures of calibrations: residuals, coverage, how sure rays are, and cameras in space."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxcam.interop.cameras.optics import Optics
from jaxcam.reports.style import BLUE, GREY, INK, VERMILION, side_by_side, styled
from jaxcam.robot.calibration.lens.fit import LensFit, ray_pixels
from jaxcam.robot.calibration.projection import placed, straightened

RED, GREEN = "#C23B22", "#3A8F4B"
"""Of x and y in drawn axes; z is blue."""


def _picture_axes(axes: Axes, width: int, height: int, title: str) -> None:
    axes.set(xlim=(0, width), ylim=(height, 0), title=title, xlabel="pixels")
    axes.set_aspect("equal")
    axes.grid(False)


@styled
def residual_figure(
    pixels: np.ndarray, residuals: np.ndarray, used: np.ndarray, size: tuple[int, int]
) -> Figure:
    """Residuals: around zero, and as arrows over the picture.

    Args:
        pixels: Of all corners, [N, 2].
        residuals: The fit less what was seen, [N, 2].
        used: Which count, bool [N].
        size: Width and height of the picture.
    """
    figure, (around, over) = side_by_side((8.2, 3.6), columns=2)
    kept = residuals[used]
    limit = max(0.3, 1.15 * float(np.abs(kept).max(initial=0)))
    around.plot(*kept.T, "o", color=BLUE, markersize=2.5, alpha=0.5, markeredgewidth=0)
    around.axhline(0, color=GREY, linewidth=0.8)
    around.axvline(0, color=GREY, linewidth=0.8)
    around.set(xlim=(-limit, limit), ylim=(limit, -limit), xlabel="across (pixels)",
               ylabel="down (pixels)", title="Residuals")  # fmt: skip
    around.set_aspect("equal")
    typical = max(float(np.median(np.linalg.norm(kept, axis=-1))) if len(kept) else 0, 1e-3)
    scale = 0.025 * size[0] / typical
    over.quiver(*pixels[used].T, *(kept.T * scale), color=BLUE, angles="xy", scale_units="xy",
                scale=1, width=0.003)  # fmt: skip
    away = pixels[~used]
    if len(away):
        over.plot(*away.T, "x", color=VERMILION, markersize=5, label=f"left out ({len(away)})")
        over.legend(loc="upper right", fontsize=8)
    _picture_axes(over, *size, f"The same over the picture, {scale:.0f} times as long")
    return figure


@styled
def coverage_figure(fit: LensFit) -> Figure:
    """Where corners were seen, and how sure each ray is."""
    figure, (where, sure) = side_by_side((8.2, 3.4), columns=2)
    size = fit.optics.width, fit.optics.height
    for view, used in zip(fit.views, fit.used, strict=True):
        where.plot(*view.pixels[used].T, "o", markersize=2.4, markeredgewidth=0, alpha=0.7)
    _picture_axes(where, *size, f"Corners of {len(fit.views)} pictures")
    pixels = ray_pixels(*size)
    shown = sure.contourf(pixels[..., 0], pixels[..., 1], np.minimum(2 * fit.rays, 4),
                          levels=[0, 0.1, 0.2, 0.3, 0.5, 0.75, 1, 2, 4],
                          cmap="viridis_r")  # fmt: skip
    _picture_axes(sure, *size, "Rays: two standard deviations (pixels)")
    figure.colorbar(shown, ax=sure, shrink=0.85)
    return figure


@styled
def space_figure(
    cameras: Mapping[str, Sequence[np.ndarray]],
    optics: Mapping[str, Optics],
    squares: Mapping[str, np.ndarray],
    origin: str = "robot base",
) -> Figure:
    """Cameras as pyramids around the robot's base, in 3-D, from two sides.

    Args:
        cameras: By the view's name, its poses [4, 4] in the frame that is drawn.
        optics: By the view's name, how it sees.
        squares: By their names, corners of tags or boards in that frame, [n, 4, 3].
        origin: What stands at zero.
    """
    figure = Figure(figsize=(8.2, 4.2), layout="constrained")
    parts = [np.zeros((1, 3)), *(s.reshape(-1, 3) for s in squares.values())]
    parts += [np.asarray(poses)[:, :3, 3] for poses in cameras.values()]
    points = np.concatenate(parts)
    middle = (points.max(0) + points.min(0)) / 2
    reach = max(float(np.ptp(points, 0).max()) / 2, 0.1) * 1.15
    colours = (BLUE, VERMILION, GREEN, "#8A5FBF", "#B8860B", INK)
    for place, (elevation, azimuth) in enumerate(((22, -50), (82, -90))):
        axes = figure.add_subplot(1, 2, place + 1, projection="3d")
        assert isinstance(axes, Axes3D)
        _axes_at(axes, np.eye(4), 0.25 * reach)
        axes.text(0, 0, 0, f" {origin}", fontsize=8)
        for i, (view, poses) in enumerate(cameras.items()):
            colour = colours[i % len(colours)]
            for pose in poses:
                _pyramid(axes, pose, optics[view], 0.16 * reach, colour)
            x, y, z = poses[0][:3, 3]
            axes.text(x, y, z, f" {view}", fontsize=8, color=colour)
        for name, corners in squares.items():
            axes.add_collection3d(
                Poly3DCollection(corners, facecolors="#C9CED6", edgecolors=INK, linewidths=0.7)
            )
            x, y, z = corners[0].mean(0)
            axes.text(x, y, z, f" {name}", fontsize=7, color=GREY)
        for limit, centre in zip(
            (axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True
        ):
            limit(centre - reach, centre + reach)
        axes.set_box_aspect((1, 1, 1))
        axes.view_init(elevation, azimuth)
        axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
        axes.tick_params(labelsize=6)
        axes.set_title(("From the side", "From above")[place])
    return figure


def _axes_at(axes: Axes3D, pose: np.ndarray, length: float) -> None:
    for axis, colour in zip(pose[:3, :3].T, (RED, GREEN, BLUE), strict=True):
        ends = np.stack([pose[:3, 3], pose[:3, 3] + length * axis])
        axes.plot(*ends.T, color=colour, linewidth=2)


def _pyramid(axes: Axes3D, pose: np.ndarray, optics: Optics, length: float, colour: str) -> None:
    """A camera: its centre, and its picture at some distance."""
    w, h = optics.width, optics.height
    corners = straightened(np.array([[0.0, 0], [w, 0], [w, h], [0, h]]), optics)
    corners = np.clip(np.nan_to_num(corners, nan=1.5), -1.5, 1.5)
    rays = np.c_[corners, np.ones(4)]
    ends = placed(pose, length * rays / np.linalg.norm(rays, axis=-1).max())
    lines = [[pose[:3, 3], end] for end in ends]
    lines += [[ends[i], ends[(i + 1) % 4]] for i in range(4)]
    axes.add_collection3d(Line3DCollection(lines, colors=colour, linewidths=1.1))
