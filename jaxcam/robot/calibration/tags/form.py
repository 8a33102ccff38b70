"""`calibrate tags`: from tags at known places to poses in the file of calibrations."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from jaxcam.config.calibrate import TagsConfig
from jaxcam.data.recorded.recording import Recording, Sight
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.paths import absolute
from jaxcam.interop.cameras.optics import Optics
from jaxcam.interop.cameras.writing import (
    Changes,
    check_updatable,
    overruled,
    pose_json,
    update_cameras,
)
from jaxcam.interop.recordings import is_recording, read_recording
from jaxcam.robot.calibration.figures import residual_figure, space_figure
from jaxcam.robot.calibration.known import not_used_note, optics_of_view, require_view
from jaxcam.robot.calibration.page import (
    CalibrationPage,
    page_path,
    show_calibration,
    spread_out,
)
from jaxcam.robot.calibration.pictures import NamedPicture, read_pictures
from jaxcam.robot.calibration.pose_page import (
    OFF,
    POSE_HEAD,
    Located,
    overruled_note,
    pose_about,
    pose_overlay,
    pose_rows,
    pose_verdict,
)
from jaxcam.robot.calibration.tags.fit import PoseFit, locate, middle_corners, shifts
from jaxcam.robot.calibration.tags.pictures import TagSights, standing, tag_sights
from jaxcam.robot.calibration.tags.places import Tags, read_tags

SAME = 0.5
"""Pixels, of a picture 640 wide, up to which a camera stands in an episode as in the others."""


def calibrate_tags(config: TagsConfig, console: Console) -> None:
    """Runs the form; see `TagsConfig`.

    Raises:
        ConfigError: Settings do not go together, a file is none, or a view has no K.
        DatasetError: The pictures are not what is needed; the message says what is missing.
    """
    cameras, tags = absolute(config.cameras), read_tags(absolute(config.tags))
    check_updatable(cameras)
    path = page_path(config.out, cameras, "tags", config.view)
    source = absolute(config.source[0])
    is_dataset = len(config.source) == 1 and is_recording(source)
    with console.status("looking for tags"):
        if is_dataset:
            recording = read_recording(source)
            located, notes = _of_recording(recording, config, tags, cameras)
            called = {str(i): e.name for i, e in enumerate(recording.episodes)}
        else:
            (located, notes), called = _of_pictures(config, tags, cameras), {}
    changes = _changes(located, everywhere=is_dataset)
    update_cameras(cameras, replace(changes, called=called))
    for one in located:
        if not one.episode and (others := overruled(cameras, one.view)):
            notes.append(overruled_note(one.view, others))
    page = _page(located, tags, notes)
    views = ", ".join(dict.fromkeys(one.view for one in located))
    show_calibration(page, path, console, f"{cameras}: poses of {views}.")


def _of_pictures(config: TagsConfig, tags: Tags, cameras: Path) -> tuple[list[Located], list[str]]:
    """The pose of the one camera that pictures are of."""
    if not config.view:
        raise ConfigError(
            "Which camera took these pictures? --view is its name, for example --view front."
        )
    pictures = list(read_pictures(config.source))
    pictures = [pictures[i] for i in spread_out(len(pictures), config.most)]
    optics = optics_of_view(cameras, config.view, pictures[0].size)
    where = f"view '{config.view}'"
    sights = tag_sights(pictures, tags.family, tags.corners, optics, where)
    still, notes = standing(sights, pictures[0].size, where)
    if sights.without:
        notes.append(f"No known tag in {len(sights.without)} pictures: {sights.without[0]} ….")
    fit = _located(still, tags, optics, where)
    return [Located(config.view, "", fit, optics, still.shown, len(still.names))], notes


def _of_recording(
    recording: Recording, config: TagsConfig, tags: Tags, cameras: Path
) -> tuple[list[Located], list[str]]:
    """The poses of a dataset's views in each episode: one for all where it never moved."""
    if config.view:
        require_view(config.view, recording)
    views = (config.view,) if config.view else recording.views
    located, notes, reasons = [], [], []
    for view in views:
        try:
            own, more = _of_view(recording, view, config.most, tags, cameras)
        except (DatasetError, ConfigError) as error:
            if config.view or len(views) == 1:
                raise
            reasons.append(f"View {view} was not calibrated: {error}")
            continue
        located += own
        notes += [*more, *filter(None, [not_used_note(recording, view, cameras)])]
    if not located:
        raise DatasetError(" ".join(reasons))
    return located, notes + reasons


def _of_view(
    recording: Recording, view: str, most: int, tags: Tags, cameras: Path
) -> tuple[list[Located], list[str]]:
    sights: dict[int, TagSights] = {}
    notes, reasons, optics = [], [], None
    for number, episode in enumerate(recording.episodes):
        if view not in episode.sights:
            continue
        sight, where = episode.sights[view], f"episode {number}, view '{view}'"
        size = sight.width, sight.height
        optics = optics_of_view(cameras, view, size)
        try:
            some = tag_sights(
                pictures_of(sight, episode.length, most), tags.family, tags.corners, optics, where
            )
            sights[number], more = standing(some, size, where)
            notes += more
        except DatasetError as error:
            reasons.append(str(error))
    if optics is None or not sights:
        raise DatasetError(reasons[0] if reasons else f"No episode was seen by view '{view}'.")
    if reasons:
        notes.append(f"{len(reasons)} episodes without a pose: {reasons[0]}")
    middles = {number: some.middle for number, some in sights.items()}
    off = shifts(list(middles.values()), middle_corners(list(middles.values())))
    still = bool((off <= SAME * max(optics.width / 640, 0.5)).all())
    if still and not reasons:
        pictures = [p for some in sights.values() for p in some.pictures]
        names = tuple(name for some in sights.values() for name in some.names)
        first = next(iter(sights.values()))
        together = TagSights(names, tuple(pictures), first.shown)
        fit = _located(together, tags, optics, f"view '{view}'")
        return [Located(view, "", fit, optics, first.shown, len(names))], notes
    located = [
        Located(
            view, str(number), _located(some, tags, optics, f"episode {number}, view '{view}'"),
            optics, some.shown, len(some.names),
        )
        for number, some in sights.items()
    ]  # fmt: skip
    return located, notes


def pictures_of(sight: Sight, length: int, most: int) -> Iterator[NamedPicture]:
    """Pictures of an episode, evenly spaced.

    Args:
        sight: What a camera saw of it.
        length: Its steps.
        most: How many at most.
    """
    chosen = set(spread_out(length, most))
    for step, rgb in enumerate(sight.decode()):
        if step in chosen:
            yield NamedPicture(f"step {step}", rgb)


def _located(sights: TagSights, tags: Tags, optics: Optics, where: str) -> PoseFit:
    try:
        fit = locate(sights.middle, tags, optics)
    except DatasetError as error:
        raise DatasetError(f"{where}: {error}") from error
    limit = OFF * max(optics.width / 640, 0.5)
    if fit.rms > limit or fit.used.mean() < 0.5:
        raise DatasetError(
            f"{where}: tags are {fit.rms:.1f} pixels from where the file of tags has them "
            f"(expected below {limit:.1f}), and {(~fit.used).mean():.0%} of their corners do not "
            f"fit at all; seen: {', '.join(map(str, fit.numbers))}. Likely causes: a "
            "place in the file is wrong, was measured in another frame than the robot's base, or "
            "has the wrong axes (x right, y up, z out of the tag); two tags are exchanged; K is "
            "another camera's."
        )
    return fit


def _changes(located: Sequence[Located], *, everywhere: bool) -> Changes:
    views, episodes, about = {}, {}, {}
    for one in located:
        entries = pose_json(one.fit.base_from_camera)
        if one.episode:
            episodes.setdefault(one.episode, {})[one.view] = entries
            # Not as the view's pose, which stays, and so does what is known of it.
            notes = about.setdefault(one.view, {"tags": {"by": "tags", "episodes": {}}})
            notes["tags"]["episodes"][one.episode] = pose_about(one)
        else:
            views[one.view] = entries
            about[one.view] = {"pose": {"by": "tags", **pose_about(one)}}
    return Changes(views, episodes, tuple(views) if everywhere else (), about)


def _notes(located: Sequence[Located], tags: Tags) -> list[str]:
    notes = []
    for one in located:
        if one.fit.dropped:
            notes.append(f"{one.words}: tag {one.fit.dropped[0]} does not lie where the file has "
                         "it; it did not count.")  # fmt: skip
        elif not one.fit.used.all():
            notes.append(f"{one.words}: {int((~one.fit.used).sum())} corners did not count: half "
                         "hidden, or of a tag that lies elsewhere.")  # fmt: skip
    alone = [one.words for one in located if len(one.fit.numbers) == 1]
    if alone:
        notes.append(
            f"One tag alone ({alone[0]}): that its size is right cannot be seen. A second one "
            "tells, and makes the rotation surer."
        )
    if not tags.accuracy:
        notes.append("Deviations are of the pictures alone: 'accuracy' in the file of tags says "
                     "how well their places are known (m).")  # fmt: skip
    return notes


def _page(located: Sequence[Located], tags: Tags, notes: Sequence[str]) -> CalibrationPage:
    verdict, good = pose_verdict({one.words: one.fit.spread for one in located})
    shown = [located[i] for i in spread_out(len(located))]
    first = located[0]
    size = first.optics.width, first.optics.height
    own = [one for one in located if (one.optics.width, one.optics.height) == size]
    by_view: dict[str, list[np.ndarray]] = {}
    for one in located:
        by_view.setdefault(one.view, []).append(one.fit.base_from_camera)
    figures = {
        "Cameras around the robot's base (x red, y green, z blue), and the tags.": space_figure(
            by_view, {one.view: one.optics for one in located},
            {f"tag {n}": corners[None] for n, corners in tags.corners.items()},
        ),
        "What the fit leaves of each corner.": residual_figure(
            np.concatenate([one.fit.pixels for one in own]),
            np.concatenate([one.fit.residuals for one in own]),
            np.concatenate([one.fit.used for one in own]), size,
        ),
    }  # fmt: skip
    overlays = {
        f"{one.words}: rings are the tags' corners, crosses where the pose has them.":
            pose_overlay(one)
        for one in shown
    }  # fmt: skip
    title = "Poses by tags of " + ", ".join(by_view)
    return CalibrationPage(
        title, f"{len(tags.corners)} tags of the family {tags.family}", verdict, good,
        pose_rows(list(located)), POSE_HEAD, [*notes, *_notes(located, tags)], overlays, figures,
    )  # fmt: skip
