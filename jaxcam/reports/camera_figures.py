"""Figures about cameras: success over the sphere of directions, poses in space, ray-maps."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxcam.reports.style import BLUE, GREY, RATE, VERMILION, percent, side_by_side, styled
from jaxcam.results.rows import Row
from jaxcam.results.stats import wilson


@dataclass(frozen=True)
class GripWay:
    """Ways of the grip in one picture.

    Attributes:
        picture: What the camera saw, uint8 [H, W, 3].
        recorded: Pixels (u, v) of where the grip was at that moment and in the steps of a chunk
            [T + 1, 2]; NaN where the camera does not see it.
        predicted: Pixels of where the predicted chunk leads, likewise; None where nobody says what
            actions mean.
        caption: Which episodes and cameras these are.
    """

    picture: np.ndarray = field(repr=False)
    recorded: np.ndarray = field(repr=False)
    predicted: np.ndarray | None = field(repr=False)
    caption: str


@styled
def success_map(rows: Iterable[Row]) -> Figure:
    """Where on the sphere of cameras the policy works.

    The large panel shows each held-out camera by azimuth and elevation over a smoothed success
    rate; the side panels show the rate by bins of one angle, with Wilson intervals over the n
    cameras of each bin.

    Args:
        rows: Evaluation rows; those not finished or without angles are left out.

    Returns:
        The figure.
    """
    cameras = rate_by_camera(rows)
    figure = Figure(figsize=(8.2, 4.9), layout="constrained")
    layout = figure.add_gridspec(2, 2, width_ratios=(4.2, 1), height_ratios=(1, 2.3))
    main, top = figure.add_subplot(layout[1, 0]), figure.add_subplot(layout[0, 0])
    side = figure.add_subplot(layout[1, 1])
    azimuth, elevation, rate, _ = cameras.T
    across, up = angle_ticks(cameras)
    main.set(xlabel="camera azimuth (degrees)", ylabel="elevation (degrees)")
    mixed = draw_cameras(main, cameras, across, up)
    _binned(top, azimuth, rate, across, upright=False)
    _binned(side, elevation, rate, up, upright=True)
    top.set_title("Success by camera direction", pad=24)
    _map_legend(figure, figure.add_subplot(layout[0, 1]), mixed)
    return figure


def draw_cameras(
    axes: Axes, cameras: np.ndarray, across: np.ndarray, up: np.ndarray, scale: float = 1.0
) -> bool:
    """Draw cameras by direction over a smoothed success rate.

    Args:
        axes: Where.
        cameras: From `rate_by_camera`.
        across: Ticks of the azimuth in degrees; the first and the last are the limits.
        up: Ticks of the elevation.
        scale: Of the markers' areas.

    Returns:
        Whether some cameras had successes and failures.
    """
    axes.set(xlim=across[[0, -1]], ylim=up[[0, -1]], xticks=across, yticks=up)
    axes.grid(False)
    if not len(cameras):
        return False
    azimuth, elevation, rate, _ = cameras.T
    extent = (across[0], across[-1], up[0], up[-1])
    axes.imshow(
        smoothed_rate(cameras, across, up), origin="lower", extent=extent, aspect="auto", cmap=RATE,
        vmin=0, vmax=1, alpha=0.55, interpolation="bicubic",
    )  # fmt: skip
    won, lost = rate == 1, rate == 0
    mixed = ~won & ~lost
    for chosen, marker, size in ((won, "o", 36), (mixed, "D", 30)):
        axes.scatter(
            azimuth[chosen], elevation[chosen], s=scale * size, c=rate[chosen], marker=marker,
            cmap=RATE, vmin=0, vmax=1, edgecolors="white", linewidths=0.8,
            zorder=3, clip_on=False,
        )  # fmt: skip
    axes.scatter(
        azimuth[lost], elevation[lost], s=scale * 34, color=VERMILION, marker="x",
        linewidths=1.9 * scale**0.5, zorder=3, clip_on=False,
    )  # fmt: skip
    return bool(np.any(mixed))


def angle_ticks(cameras: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ticks of azimuth and elevation that cover the paper's range and all cameras."""
    return _range(cameras[:, 0], -90, 90, 30), _range(cameras[:, 1], 30, 60, 10)


@styled
def camera_places(
    train: np.ndarray, test: np.ndarray, centre: Sequence[float] = (0.0, 0.0, 0.8)
) -> Figure:
    """Camera positions and viewing directions, seen from above and from the side.

    Args:
        train: World-from-camera matrices [N, 4, 4] of training (OpenCV axes).
        test: World-from-camera matrices of evaluation.
        centre: Point the cameras are sampled around, in metres.

    Returns:
        The figure.
    """
    figure, (above, side) = side_by_side((8.2, 4.2), columns=2)
    for poses, colour, label in ((train, GREY, "training"), (test, BLUE, "held out")):
        poses = np.asarray(poses, float).reshape(-1, 4, 4)
        position, forward = poses[:, :3, 3] - centre, poses[:, :3, 2]
        radius = np.hypot(position[:, 0], position[:, 1])
        # Inwards or outwards along the horizontal line to the centre.
        inward = np.sum(position[:, :2] * forward[:, :2], 1) / np.maximum(radius, 1e-9)
        strong = label == "held out"
        _arrows(above, position[:, 0], position[:, 1], forward[:, :2], colour, strong)
        _arrows(side, radius, position[:, 2], np.stack([inward, forward[:, 2]], 1), colour, strong)
        above.plot([], [], "o", color=colour, label=f"{label} ({len(poses)})")
    for axes, title in ((above, "From above"), (side, "From the side")):
        axes.plot(0, 0, "+", color=VERMILION, markersize=10, markeredgewidth=2)
        axes.set_aspect("equal")
        axes.set_title(title)
    above.set(xlabel="x from the centre (m)", ylabel="y from the centre (m)")
    side.set(xlabel="horizontal distance (m)", ylabel="height above the centre (m)")
    side.set_xlim(left=-0.08)
    above.plot([], [], "+", color=VERMILION, markersize=9, markeredgewidth=2, label="centre")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@styled
def ray_picture(image: np.ndarray, rays: np.ndarray) -> Figure:
    """An image beside its ray-map: directions and moments as colours.

    Args:
        image: Levels 0 to 255, uint8 or float [H, W, 3].
        rays: Its ray-map [H, W, 6], (direction, moment).

    Returns:
        The figure.
    """
    rays = np.asarray(rays, float)
    if rays.ndim != 3 or rays.shape[-1] != 6:
        raise ValueError(f"rays must be [H, W, 6], got {rays.shape}")
    direction, moment = rays[..., :3], rays[..., 3:]
    scale = max(float(np.abs(moment).max()), 1e-9)
    figure, columns = side_by_side((8.2, 3.2), columns=3)
    image = np.asarray(image)
    if image.dtype != np.uint8:
        image = np.clip(image / 255, 0, 1)
    pictures = (
        ("Image", image),
        ("Ray direction", np.clip((direction + 1) / 2, 0, 1)),
        (f"Ray moment (±{scale:.2f} m)", np.clip((moment / scale + 1) / 2, 0, 1)),
    )
    for axes, (title, picture) in zip(columns, pictures, strict=True):
        axes.imshow(picture)
        axes.set_title(title)
        axes.set_axis_off()
    return figure


@styled
def ways_picture(ways: Sequence[GripWay]) -> Figure:
    """Pictures with the way that the grip took and the one that a policy would have sent it.

    Args:
        ways: At least one, with pictures of one size.
    """
    columns = min(3, len(ways))
    rows = -(-len(ways) // columns)
    height, width = ways[0].picture.shape[:2]
    figure = Figure(figsize=(2.7 * columns, 2.7 * rows * height / width + 0.35 * rows))
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    for axes, way in zip(grid.ravel(), ways, strict=False):
        axes.imshow(way.picture, extent=(0, width, height, 0))
        lines = ((way.recorded, BLUE, "recorded"), (way.predicted, VERMILION, "predicted"))
        for line, colour, label in lines:
            if line is not None:
                axes.plot(*line.T, color=colour, linewidth=1.6, label=label, marker="o",
                          markersize=2)  # fmt: skip
        axes.set_xlim(0, width)
        axes.set_ylim(height, 0)
        axes.set_title(way.caption, fontsize=8)
    grid[0, 0].legend(fontsize=6, loc="upper left")
    return figure


def rate_by_camera(rows: Iterable[Row]) -> np.ndarray:
    """[cameras, 4]: azimuth, elevation, success rate, rollouts."""
    outcomes: dict[tuple[float, float], list[float]] = {}
    for row in rows:
        if row.finished and row.azimuth_deg is not None and row.elevation_deg is not None:
            key = (round(float(row.azimuth_deg), 3), round(float(row.elevation_deg), 3))
            outcomes.setdefault(key, []).append(float(row.success or 0))
    table = [(*key, np.mean(values), len(values)) for key, values in outcomes.items()]
    return np.array(table, float).reshape(-1, 4)


def _range(values: np.ndarray, low: float, high: float, step: float) -> np.ndarray:
    """Bin edges that cover [low, high] and all values."""
    low = min([low, *(step * np.floor(values / step))])
    high = max([high, *(step * np.ceil(values / step))])
    return np.arange(low, high + step / 2, step)


def smoothed_rate(cameras: np.ndarray, across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Gaussian-kernel success rate on a grid; far from any camera it falls back to the mean.

    Args:
        cameras: From `rate_by_camera`.
        across: Of the azimuth in degrees, the first and the last are the grid's limits.
        up: Of the elevation.

    Returns:
        Rates [46, 91] by elevation, then azimuth, evenly spaced.
    """
    x, y = np.linspace(across[0], across[-1], 91), np.linspace(up[0], up[-1], 46)
    azimuth, elevation, rate, count = cameras.T
    near = np.exp(-0.5 * ((x[:, None] - azimuth) / 18) ** 2)
    level = np.exp(-0.5 * ((y[:, None] - elevation) / 7) ** 2)
    weight = np.einsum("yc,xc,c->yxc", level, near, count)
    prior = 0.5  # half a rollout of average outcome
    mean = np.average(rate, weights=count)
    return (weight @ rate + prior * mean) / (weight.sum(-1) + prior)


def _binned(
    axes: Axes, angle: np.ndarray, rate: np.ndarray, edges: np.ndarray, upright: bool
) -> None:
    """Success by bins of one angle; `upright` puts the angle on the vertical axis."""
    middles = (edges[:-1] + edges[1:]) / 2
    # The last bin holds its upper edge too.
    place = np.clip(np.digitize(angle, edges) - 1, 0, len(middles) - 1)
    for i, middle in enumerate(middles):
        chosen = rate[place == i]
        n = len(chosen)
        if n == 0:
            continue
        # Rollouts of several seeds on one camera count as one trial: they are not independent.
        span, point = ([*wilson(chosen.sum(), n)], [middle] * 2), (chosen.mean(), middle)
        if not upright:
            span, point = span[::-1], point[::-1]
        axes.plot(*span, color=BLUE, linewidth=2, alpha=0.45, solid_capstyle="round")
        axes.plot(*point, "o", color=BLUE, markersize=6, markeredgecolor="white", clip_on=False)
        where, align = ((1.06, middle), ("left", "center"))
        blend = axes.get_yaxis_transform()
        if not upright:
            where, align, blend = where[::-1], ("center", "bottom"), axes.get_xaxis_transform()
        axes.text(
            where[0], where[1], f"n = {n}", transform=blend, color=GREY, fontsize=8,
            ha=align[0], va=align[1],
        )  # fmt: skip
    rates, angles = (axes.xaxis, axes.yaxis) if upright else (axes.yaxis, axes.xaxis)
    (axes.set_xlim if upright else axes.set_ylim)(0, 1)
    (axes.set_ylim if upright else axes.set_xlim)(edges[0], edges[-1])
    rates.set_ticks([0, 0.5, 1])
    rates.set_major_formatter(percent())
    angles.set_ticks(edges, [""] * len(edges))


def _map_legend(figure: Figure, axes: Axes, has_mixed: bool) -> None:
    """The meaning of markers and colours, in a panel of its own."""
    axes.set_axis_off()
    entries = [
        Line2D([], [], marker="o", color=BLUE, linestyle="", markeredgecolor="white", markersize=8),
        Line2D([], [], marker="x", color=VERMILION, linestyle="", markeredgewidth=2),
    ]
    labels = ["success", "failure"]
    if has_mixed:
        entries.append(Line2D([], [], marker="D", color=GREY, linestyle="", markersize=6))
        labels.append("some of each")
    axes.legend(entries, labels, loc="upper left", borderpad=0, handletextpad=0.3)
    bar = figure.colorbar(
        ScalarMappable(Normalize(0, 1), RATE), cax=axes.inset_axes((0.02, 0.02, 0.96, 0.1)),
        orientation="horizontal", alpha=0.55, ticks=[0, 0.5, 1], format=percent(),
    )  # fmt: skip
    bar.ax.set_title("smoothed rate", fontsize=8, fontweight="normal", pad=3)
    bar.ax.tick_params(labelsize=8, length=0)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]


def _arrows(
    axes: Axes, x: np.ndarray, y: np.ndarray, direction: np.ndarray, colour: str, strong: bool
) -> None:
    """Points with a short line along the viewing direction."""
    alpha, length = (0.95, 0.12) if strong else (0.4, 0.08)
    ends = np.stack([x, y], 1) + length * direction
    axes.plot(
        np.stack([x, ends[:, 0]]), np.stack([y, ends[:, 1]]), color=colour, alpha=alpha, linewidth=1
    )
    axes.plot(x, y, "o", color=colour, alpha=alpha, markersize=4, markeredgewidth=0)
