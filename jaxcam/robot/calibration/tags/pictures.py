"""Finding tags in pictures, and pictures that do not go with the others."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from jaxcam.config.calibrate import TagFamily
from jaxcam.errors import DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.robot.calibration.boards import dictionary_of, other_family, tags_in
from jaxcam.robot.calibration.pictures import NamedPicture
from jaxcam.robot.calibration.tags.edges import refine_corners
from jaxcam.robot.calibration.tags.fit import TagCorners, middle_corners, shifts

STILL = 0.8
"""Pixels, of a picture 640 wide, up to which tags stand where they were."""
FEW = 0.2
"""Share of a camera's pictures that may be left out without a word being wrong."""
NEEDS = (
    "The detector needs tags of 20 pixels or more with their white margin, sharp, and not "
    "overexposed."
)


@dataclass(frozen=True)
class TagSights:
    """Tags in the pictures of a camera that stands still."""

    names: tuple[str, ...]
    """Of the pictures with tags."""
    pictures: tuple[TagCorners, ...] = field(repr=False)
    """Corners of tags in each."""
    shown: np.ndarray = field(repr=False)
    """One of the pictures, uint8 [H, W, 3]."""
    without: tuple[str, ...] = ()
    """Pictures that show no tag."""

    @property
    def middle(self) -> dict[int, np.ndarray]:
        """Each tag's corners, [4, 2]."""
        return middle_corners(self.pictures)


def find_tags(picture: NamedPicture, family: TagFamily, optics: Optics) -> dict[int, np.ndarray]:
    """Corners of the tags in a picture, refined; one that is there twice is none.

    Args:
        picture: The picture.
        family: Theirs.
        optics: How the camera sees.
    """
    grey = picture.grey
    cells = dictionary_of(family).markerSize + 2
    found_tags: dict[int, np.ndarray] = {}
    twice = set()
    for number, corners in tags_in(grey, family):
        twice |= {number} & found_tags.keys()
        found_tags[number] = refine_corners(grey, corners, cells, optics)
    return {n: c for n, c in found_tags.items() if n not in twice}


def tag_sights(
    pictures: Iterable[NamedPicture],
    family: TagFamily,
    known: Iterable[int],
    optics: Optics,
    where: str,
) -> TagSights:
    """The tags in the pictures of a camera.

    Args:
        pictures: Of the camera.
        family: Of the tags.
        known: Numbers that count.
        optics: How the camera sees.
        where: Whose pictures these are, for messages.

    Raises:
        DatasetError: None shows such a tag; the message says what is there instead.
    """
    names, corners, without = [], [], []
    shown, first, numbers, count = None, None, set(known), 0
    others: set[int] = set()
    for picture in pictures:
        count, first = count + 1, first or picture
        tags = find_tags(picture, family, optics)
        others |= tags.keys() - numbers
        tags = {n: c for n, c in tags.items() if n in numbers}
        if tags:
            names.append(picture.name)
            corners.append(tags)
            shown = picture.rgb if shown is None else shown
        else:
            without.append(picture.name)
    if shown is None:
        why = why_no_tag(first, family, others, numbers) if first else ""
        listed = ", ".join(without[:5]) + (" …" if len(without) > 5 else "")
        raise DatasetError(
            f"{where}: no tag {_list(numbers)} of the family {family} in {count} pictures "
            f"({listed}). {why}{NEEDS}"
        )
    return TagSights(tuple(names), tuple(corners), shown, tuple(without))


def _list(numbers: Iterable[int]) -> str:
    ordered = sorted(numbers)
    return ", ".join(map(str, ordered[:8])) + (" …" if len(ordered) > 8 else "")


def why_no_tag(picture: NamedPicture, family: TagFamily, others: set[int], known: set[int]) -> str:
    """Why no known tag is in a picture, as far as one can say; empty if nothing else is there.

    Args:
        picture: The picture.
        family: The family that was looked for.
        others: Numbers of it that are in the pictures.
        known: Numbers that count.
    """
    if others:
        return (
            f"Other tags are there: {_list(others)}; known are {_list(known)}. Were others put up, "
            "or is the file of tags another one's? "
        )
    mirrored = np.ascontiguousarray(picture.grey[:, ::-1])
    if any(n in known for n, _ in tags_in(mirrored, family)):
        return (
            "They are there mirrored: the pictures are flipped left to right. Record them "
            "unflipped. "
        )
    if other := other_family(picture.grey, family):
        return f"Tags of the family {other} are there: say so where the family is named. "
    return ""


def standing(sights: TagSights, size: tuple[int, int], where: str) -> tuple[TagSights, list[str]]:
    """The pictures in which the camera stands where it stands in most.

    Args:
        sights: Of a camera that should stand still.
        size: Width and height of its pictures.
        where: Whose pictures these are.

    Returns:
        Them, and what was left out, in words.

    Raises:
        DatasetError: It moved, or the pictures are of two cameras; the message says from when on.
    """
    off = shifts(sights.pictures, sights.middle)
    away = off > STILL * max(size[0] / 640, 0.5)
    if not away.any():
        return sights, []
    names = [name for name, is_away in zip(sights.names, away, strict=True) if is_away]
    if away.mean() > FEW:
        change = _changes(sights.pictures)
        most = float(np.nanmax(off))
        raise DatasetError(
            f"{where}: the camera moved, or these are pictures of two cameras: tags are up to "
            f"{most:.1f} pixels elsewhere in {len(names)} of {len(off)} pictures, from "
            f"{sights.names[change]} on. Calibrate each place with its own pictures; tags on "
            "things that move do not count as known places. A camera on the hand is for "
            "calibrate hand-eye --mount grip."
        )
    kept = [i for i in range(len(off)) if not away[i]]
    still = TagSights(
        tuple(sights.names[i] for i in kept), tuple(sights.pictures[i] for i in kept),
        sights.shown, sights.without,
    )  # fmt: skip
    return still, [f"{where}: left out, tags are elsewhere in them: {', '.join(names[:5])}."]


def _changes(pictures: Sequence[TagCorners]) -> int:
    """The first picture whose tags are farthest from those of the picture before it."""
    steps = [0.0]
    for before, after in pairwise(pictures):
        off = [np.linalg.norm(after[n] - before[n], axis=-1) for n in after if n in before]
        steps.append(float(np.median(np.concatenate(off))) if off else 0.0)
    return int(np.argmax(steps))
