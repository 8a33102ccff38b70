"""Recorded episodes and files of calibrations, without a simulator."""

import json
from dataclasses import replace

import numpy as np
import pytest
from filmed import SIZE, calibrations, filmed, with_sights

from jaxcam.errors import DatasetError
from jaxcam.viewer import recorded
from jaxcam.viewer.exhibit import GREEN, RED, cameras_apart

POSE = np.eye(4).tolist()
VIEW = {"K": {"fx": 60, "fy": 60, "cx": 32, "cy": 24}, "size": [64, 48], "base_from_camera": POSE}


def test_an_episode_has_its_cameras_pictures_and_the_way_of_the_grip():
    dataset = filmed(episodes=2, length=7)
    exhibit = recorded.episode(dataset, 1)
    assert [v.name for v in exhibit.viewpoints] == ["front", "left", "right"]
    assert {v.colour for v in exhibit.viewpoints} == {GREEN}
    assert exhibit.length == 7
    assert exhibit.rate == dataset.rate
    np.testing.assert_allclose(exhibit.ways[0].points, dataset.episodes[1].state[:, :3], atol=1e-6)
    view = exhibit.viewpoints[0]
    np.testing.assert_allclose(
        view.camera.world_from_camera, calibrations()["front"].base_from_camera
    )
    first = next(dataset.episodes[1].sights["front"].decode())
    np.testing.assert_array_equal(view.pictures[0], first)


def test_held_out_episodes_are_red():
    exhibit = recorded.episode(replace(filmed(episodes=2), valid=(1,)), 1)
    assert {v.colour for v in exhibit.viewpoints} == {RED}


def test_large_pictures_shrink_and_k_with_them(monkeypatch):
    monkeypatch.setattr(recorded, "WIDEST", SIZE[1] // 2)
    exhibit = recorded.episode(filmed(episodes=1, length=3), 0)
    view = exhibit.viewpoints[0]
    assert view.pictures[0].shape == (36, 48, 3)
    np.testing.assert_allclose(view.camera.K[0], [55, 0, 24])


def test_of_long_episodes_some_pictures_are_shown(monkeypatch):
    monkeypatch.setattr(recorded, "SHOWN", 9)
    exhibit = recorded.episode(filmed(episodes=1, length=8), 0)
    assert [list(v.steps) for v in exhibit.viewpoints] == [[0, 3, 6]] * 3
    assert "every 3th step" in " ".join(exhibit.notes)


def test_a_view_that_nobody_knows_is_left_out_and_told():
    dataset = with_sights(
        filmed(episodes=1),
        lambda _, view, sight: replace(sight, calibration=None) if view == "left" else sight,
    )
    exhibit = recorded.episode(dataset, 0)
    assert [v.name for v in exhibit.viewpoints] == ["front", "right"]
    assert "View left: nobody says where it stood." in exhibit.notes


def test_a_dataset_without_cameras_is_told_how_to_get_them():
    dataset = with_sights(filmed(episodes=1), lambda _, v, sight: replace(sight, calibration=None))
    with pytest.raises(DatasetError, match="--cameras"):
        recorded.episode(dataset, 0)


def write(path, **views):
    path.write_text(json.dumps({"format": 1, "views": views, "episodes": {"3": {"a": VIEW}}}))
    return path


def test_a_file_of_cameras_shows_those_that_have_both_halves(tmp_path):
    file = write(tmp_path / "cameras.json", a=VIEW, b={k: VIEW[k] for k in ("K", "size")})
    exhibit = recorded.calibrated_cameras(file)
    assert [v.name for v in exhibit.viewpoints] == ["a and 1 more"]
    assert any(note.startswith("b has not a pose") for note in exhibit.notes)


def test_a_camera_that_stands_still_is_shown_once_and_compared_where_it_moved(tmp_path):
    elsewhere = np.eye(4)
    elsewhere[0, 3] = 0.02
    pushed = VIEW | {"base_from_camera": elsewhere.tolist()}
    exhibits = []
    for name, late in (("before", VIEW), ("after", pushed)):
        episodes = {str(i): {"a": VIEW if i < 2 else late} for i in range(4)}
        file = tmp_path / f"{name}.json"
        file.write_text(json.dumps({"format": 1, "episodes": episodes}))
        exhibits.append(recorded.calibrated_cameras(file))
    before, after = exhibits
    assert [v.name for v in before.viewpoints] == ["episode 0: a and 3 more"]
    assert [v.known_as[0] for v in after.viewpoints] == ["episode 0: a", "episode 2: a"]
    assert cameras_apart(before, after) == [
        "episode 0: a: 0.0 mm and 0.00 degrees apart.",
        "episode 2: a: 20.0 mm and 0.00 degrees apart.",
    ]


def test_a_file_without_a_camera_is_an_error(tmp_path):
    file = tmp_path / "cameras.json"
    file.write_text('{"format": 1}')
    with pytest.raises(DatasetError, match="no camera has both"):
        recorded.calibrated_cameras(file)
