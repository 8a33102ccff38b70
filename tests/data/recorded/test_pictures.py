"""Pictures of recorded datasets: decoded once, and kept."""

import dataclasses

import numpy as np
import pytest
import robots

from jaxcam.data.recorded.parts import HeldOut, parts_of
from jaxcam.data.recorded.pictures import load_recorded_pictures
from jaxcam.errors import DatasetError

SIZE = (24, 32)


def test_pictures_are_decoded_once(tmp_path):
    recording = robots.recording(tmp_path)
    parts = parts_of(recording, HeldOut(count=1), 1)
    first = load_recorded_pictures(recording, parts, SIZE, tmp_path)
    assert first.drawn.all()

    def fails():
        raise AssertionError("decoded again")

    for episode in recording.episodes:
        for view, sight in episode.sights.items():
            episode.sights[view] = dataclasses.replace(sight, decode=fails)
    again = load_recorded_pictures(recording, parts, SIZE, tmp_path)
    np.testing.assert_array_equal(again.rgb, first.rgb)


def test_pictures_of_another_calibration_or_folder_are_the_same(tmp_path):
    recording = dataclasses.replace(robots.recording(tmp_path / "old"), pictures="shown")
    parts = parts_of(recording, HeldOut(count=1), 1)
    load_recorded_pictures(recording, parts, SIZE, tmp_path)
    (file,) = (tmp_path / "frames").glob("*.npy")
    moved = dataclasses.replace(recording, path=tmp_path / "new", fingerprint="calibrated anew")
    load_recorded_pictures(moved, parts, SIZE, tmp_path)
    assert list((tmp_path / "frames").glob("*.npy")) == [file]
    others = dataclasses.replace(recording, pictures="filmed anew")
    load_recorded_pictures(others, parts, SIZE, tmp_path)
    assert len(list((tmp_path / "frames").glob("*.npy"))) == 2


def test_a_film_that_is_too_short_is_refused(tmp_path):
    recording = robots.recording(tmp_path)
    episode = recording.episodes[1]
    sight = episode.sights["side"]
    short = lambda: list(sight.decode())[:-2]  # noqa: E731
    episode.sights["side"] = dataclasses.replace(sight, decode=lambda: iter(short()))
    parts = parts_of(recording, HeldOut(count=0), 1)
    with pytest.raises(
        DatasetError, match="episode '1' has 11 steps, but view side has 9 pictures"
    ):
        load_recorded_pictures(recording, parts, SIZE, tmp_path)
