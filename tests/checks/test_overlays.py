"""Axes drawn over pictures."""

import numpy as np
import pytest

from jaxcam.checks.overlays import (
    AXES,
    PATH,
    Moment,
    draw,
    draw_axes,
    draw_over,
    grip_pose,
    moments,
    sheet,
    table_pose,
)
from jaxcam.rays import Camera


def test_axes_are_drawn_where_the_camera_projects_them():
    picture = np.zeros((100, 100, 3), np.uint8)
    camera = Camera.from_fovy(np.pi / 2, 100, 100, np.eye(4))
    pose = np.eye(4)
    pose[:3, 3] = 0, 0, 1
    draw_axes(picture, camera, pose, 0.5)  # x right, y down, z away from the camera
    np.testing.assert_array_equal(picture[50, 70], AXES[0])
    np.testing.assert_array_equal(picture[70, 50], AXES[1])
    assert not picture[:45].any()
    assert not picture[:, :45].any()
    behind = np.zeros_like(picture)
    pose[2, 3] = -1
    draw_axes(behind, camera, pose, 0.5)
    assert not behind.any()


def test_overlays_show_grip_and_table(demos, scene, renderer):
    demo = demos.train[1]
    np.testing.assert_allclose(grip_pose(demo, 3)[:3, 3], demo.eef_pos[3])
    table = table_pose(demo, scene)
    assert table[2, 3] == pytest.approx(0.8)
    np.testing.assert_allclose(table[:2, 3], demo.fixtures[0, :2])
    fresh = draw(demos, [Moment(1, 3, 2), Moment(1, 3, 1)], renderer)
    assert (fresh[0] != fresh[1]).any()
    drawn = np.zeros((64, 64, 3), np.uint8)
    draw_over(drawn, demos, Moment(1, 3, 2), scene)
    for colour in (*AXES, PATH):  # all of them are in the picture
        assert (abs(drawn - np.array(colour)).max(-1) < 40).any()
    whole = sheet([drawn] * 5, ["caption"] * 5)
    assert whole.shape[0] > 2 * 64
    np.testing.assert_array_equal(whole[4:68, 4:68], drawn)


def test_moments_are_spread_over_demonstrations_times_and_cameras(demos):
    shown = moments(demos, 4)
    assert [m.row for m in shown] == [0, 1, 3, 5]
    assert [m.camera for m in shown] == [0, 1, 2, 0]
    episodes = demos.episodes
    assert all(0 <= m.t < episodes[m.row].length for m in shown)
    assert len({m.t for m in shown}) == 4
    assert len(moments(demos, 99)) == 6
