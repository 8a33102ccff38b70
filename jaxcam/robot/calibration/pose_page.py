"""What forms that find poses have in common: the verdict, and the pictures that show it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxcam.interop.cameras.optics import Optics
from jaxcam.robot.calibration.page import overlay
from jaxcam.robot.calibration.tags.fit import PoseFit

GOOD = 0.005, np.deg2rad(0.5)
"""Two standard deviations of a pose (m, rad) up to which it is good."""
FAIR = 0.02, np.deg2rad(2.0)
"""Likewise, up to which a policy can still use it."""
MORE_TAGS = (
    "More tags, farther apart, larger or nearer ones, or pictures of more pixels, make it better."
)
"""What makes poses by tags better."""
OFF = 2.0
"""Residuals (pixels, of a picture 640 wide) from when on numbers do not fit the pictures."""


@dataclass(frozen=True)
class Located:
    """A camera's pose and what it is from."""

    view: str
    episode: str
    """Its number, or empty if it holds for all."""
    fit: PoseFit
    optics: Optics
    shown: np.ndarray = field(repr=False)
    """A picture, uint8 [H, W, 3]."""
    pictures: int
    """How many it is from."""

    @property
    def words(self) -> str:
        """Which it is."""
        return f"{self.view}, episode {self.episode}" if self.episode else self.view


COST = (
    "Of 90% of a policy that lifts a cube, 1 cm and 1 degree cost 15 points, 2 cm 27, 2 degrees 37."
)
"""What was measured of errors, see docs/beyond.md."""


def pose_verdict(
    spreads: Mapping[str, tuple[float, float]], better: str = MORE_TAGS
) -> tuple[str, bool]:
    """A plain sentence on whether poses are good enough, and whether they are.

    Args:
        spreads: By the camera's name, standard deviations of its place (m) and rotation (rad).
        better: What makes it better.
    """
    name = max(spreads, key=lambda n: max(spreads[n][0] / GOOD[0], spreads[n][1] / GOOD[1]))
    place, turn = 2 * spreads[name][0], 2 * spreads[name][1]
    who = f"the worst, {name}," if len(spreads) > 1 else "it"
    sure = f"{who} is known to {1000 * place:.1f} mm and {np.rad2deg(turn):.2f} degrees"
    if place <= GOOD[0] and turn <= GOOD[1]:
        return f"Good enough: {sure} (two standard deviations).", True
    if place <= FAIR[0] and turn <= FAIR[1]:
        return (
            f"Good enough for a policy that saw cameras like it, not for measuring: {sure} (two "
            f"standard deviations). {COST} {better}", True,
        )  # fmt: skip
    return (
        f"Not good enough: {sure} (two standard deviations). {COST} {better}", False,
    )  # fmt: skip


def pose_rows(located: list[Located]) -> list[tuple[str, ...]]:
    """Rows of a table: where each camera stands, how sure that is, and how well it fits."""
    rows = []
    for one in located:
        place, turn = one.fit.spread
        position = ", ".join(f"{x:.4f}" for x in one.fit.base_from_camera[:3, 3])
        rows.append((
            one.words, position, f"{1000 * place:.2f} mm", f"{np.rad2deg(turn):.3f}°",
            f"{one.fit.rms:.2f}", ", ".join(map(str, one.fit.numbers)), str(one.pictures),
        ))  # fmt: skip
    return rows


POSE_HEAD = ("camera", "position (m)", "deviation", "rotation", "off (pixels)", "tags", "pictures")


def pose_overlay(one: Located) -> np.ndarray:
    """A picture with corners as they were seen and as the pose has them."""
    fit = one.fit
    return overlay(one.shown, fit.pixels, fit.pixels + fit.residuals, fit.used)


def pose_about(one: Located) -> dict[str, object]:
    """What is kept of how well a pose is known."""
    place, turn = one.fit.spread
    return {
        "deviation_mm": round(1000 * place, 2),
        "deviation_deg": round(float(np.rad2deg(turn)), 3),
        "rms_pixels": round(one.fit.rms, 3),
        "tags": list(one.fit.numbers),
        "pictures": one.pictures,
    }


def overruled_note(view: str, episodes: list[str]) -> str:
    """That single episodes keep poses of their own.

    Args:
        view: The camera's name.
        episodes: Their names in the file.
    """
    return (
        f"The file has poses of view {view} for episodes {', '.join(episodes[:8])} alone, which "
        "stay, and come before this one there. Take them out of it if the camera never moved."
    )
