"""Figures of cameras: success by direction, where they are, their rays as colours."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from run_rows import evaluation, texts

from jaxcam.reports.camera_figures import camera_places, ray_picture, success_map
from jaxcam.reports.style import save


def test_success_map_counts_cameras_in_bins():
    rows = evaluation([1, 0] * 25)
    figure = success_map([*rows, *evaluation([1] * 50, seed=1)])
    _main, top, side = figure.axes[:3]
    azimuth = np.array([row.azimuth_deg for row in rows])
    counts, _ = np.histogram(azimuth, np.arange(-90, 91, 30))
    assert texts(top) == [f"n = {n}" for n in counts if n]  # two seeds, still one camera each
    assert sum(int(t.removeprefix("n = ")) for t in texts(side)) == 50


def test_success_map_leaves_out_unfinished_rollouts():
    rows = evaluation([1, 0] * 25)
    rows = [replace(row, status="error") for row in rows[:20]] + rows[20:]
    top = success_map(rows).axes[1]
    assert sum(int(t.removeprefix("n = ")) for t in texts(top)) == 30


def test_smoothed_rate_follows_the_outcomes():
    rows = [replace(row, success=row.azimuth_deg > 0) for row in evaluation([0] * 50)]
    field = success_map(rows).axes[0].images[0].get_array()
    assert field[:, 10].max() < 0.2
    assert field[:, -10].min() > 0.8


def test_camera_poses_are_drawn_where_they_are():
    pose = np.eye(4)
    pose[:3, 3] = (0.6, 0.8, 1.3)
    above, side = camera_places(pose[None], pose[None], centre=(0, 0, 0.8)).axes
    position = [line.get_xydata()[0] for line in above.lines if len(line.get_xydata()) == 1]
    assert position[0] == pytest.approx([0.6, 0.8])
    position = [line.get_xydata()[0] for line in side.lines if len(line.get_xydata()) == 1]
    assert position[0] == pytest.approx([1.0, 0.5])


def test_ray_picture_shows_directions_as_colours(tmp_path):
    rays = np.zeros((8, 8, 6), np.float32)
    rays[..., 2] = 1
    image = np.full((8, 8, 3), 128, np.uint8)
    figure = ray_picture(image, rays)
    assert np.allclose(figure.axes[1].images[0].get_array(), (0.5, 0.5, 1))
    path = save(figure, tmp_path / "new" / "rays.png")
    assert cv2.imread(str(path)).shape == (512, 1312, 3)
    with pytest.raises(ValueError, match=r"\[H, W, 6\]"):
        ray_picture(image, rays[..., :3])
