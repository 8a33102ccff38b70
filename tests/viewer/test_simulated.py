"""Demonstrations of our tasks as exhibits."""

import jax
import numpy as np
import pytest
from many_cameras import with_optics

from jaxcam.config.conditions import Conditions
from jaxcam.data.header import optics_ranges
from jaxcam.data.pictures import views_of
from jaxcam.data.splits import SPLITS
from jaxcam.errors import SimError
from jaxcam.rays import Camera, invert, sample_poses
from jaxcam.rays.optics import at_size, sample_optics
from jaxcam.sim import make_painter, make_task
from jaxcam.sim.types import Start
from jaxcam.viewer import simulated
from jaxcam.viewer.exhibit import GREEN, RED
from jaxcam.viewer.simulated import Course, demonstration, training_cameras


@pytest.fixture(autouse=True)
def few_small_pictures(monkeypatch):
    monkeypatch.setattr(simulated, "SIDE", 24)
    monkeypatch.setattr(simulated, "DRAWN", 6)


def test_a_training_demonstration_has_green_cameras_and_the_tests_are_red(demos):
    exhibit, demo = demonstration(demos, 1), demos.episodes[1]
    base_from_world = np.asarray(invert(demos.world.world_from_base))
    shown = [v for v in exhibit.viewpoints if len(v.pictures)]
    expected = base_from_world @ demos.header.world_from_camera[demo.cameras]
    np.testing.assert_allclose([v.camera.world_from_camera for v in shown], expected, atol=1e-6)
    assert {v.colour for v in shown} == {GREEN}
    green = [v for v in exhibit.viewpoints if v.group == "training"]
    assert len(green) == len(training_cameras(demos))
    red = [v for v in exhibit.viewpoints if v.group == "test"]
    test = sample_poses(demos.task.cameras, len(red), SPLITS["test"].cameras)
    np.testing.assert_allclose(
        [v.camera.world_from_camera for v in red], base_from_world @ test, atol=1e-6
    )
    assert {v.colour for v in red} == {RED}


def test_it_lasts_as_long_as_its_states_and_the_way_is_that_of_the_grip(demos):
    exhibit, demo = demonstration(demos, 0), demos.episodes[0]
    assert exhibit.length == demo.length + 1
    moved = demo.eef_pos - demos.world.world_from_base[:3, 3]
    np.testing.assert_allclose(
        exhibit.ways[0].points, moved @ demos.world.world_from_base[:3, :3], atol=1e-6
    )
    assert exhibit.bodies


def test_pictures_show_what_a_camera_sees_at_their_steps(demos):
    """The cube's pixels: red where the projected cube is."""
    exhibit = demonstration(demos, 0)
    view = exhibit.viewpoints[0]
    assert len(view.steps) == len(view.pictures) > 1
    assert view.steps[1] == view.steps[0] + -(-(demos.episodes[0].length + 1) * 3 // 6)
    assert not np.array_equal(view.pictures[0], view.pictures[-1])


def test_a_validation_demonstration_is_of_held_out_cameras(demos):
    exhibit = demonstration(demos, len(demos.train))
    assert {v.colour for v in exhibit.viewpoints if len(v.pictures)} == {RED}
    assert "for validation" in exhibit.subtitle


def test_cameras_that_differ_are_shown_with_their_own_intrinsics_and_lenses(demos):
    """In pictures, frusta and the rays of pixels; those of the test are drawn as training's."""
    ranges = {"fovy": "20:70", "lens": "opencv:-0.3:-0.1"}
    varied = with_optics(demos, **ranges)
    exhibit, demo = demonstration(varied, 1), varied.episodes[1]
    shown = [v for v in exhibit.viewpoints if len(v.pictures)]
    for view, row in zip(shown, demo.cameras, strict=True):
        np.testing.assert_allclose(view.camera.K, varied.header.intrinsics(24)[row])
        np.testing.assert_array_equal(view.camera.distortion, varied.header.distortion[row])
    view_of_all = views_of(demo, varied, 24)
    painter = make_painter(varied.world, 24, varied=varied.task.varied, lenses=True)
    first = jax.tree.map(lambda part: part[:1], view_of_all)
    np.testing.assert_array_equal(shown[0].pictures[0], painter.rgb(first)[0])
    test = [v.camera for v in exhibit.viewpoints if v.group == "test"]
    optics = optics_ranges(Conditions(**ranges), varied.task.fovy_deg)
    K, lens = sample_optics(optics, len(test), SPLITS["test"].cameras)
    np.testing.assert_allclose([c.K for c in test], at_size(K, 24))
    np.testing.assert_array_equal([c.distortion for c in test], lens)


def test_where_nothing_can_be_drawn_cameras_are_shown_all_the_same(demos, monkeypatch):
    def refuse(self):
        raise SimError("no renderer")

    monkeypatch.setattr(type(demos.task), "require", refuse)
    exhibit = demonstration(demos, 0)
    assert "No pictures are drawn: no renderer" in exhibit.notes
    assert not any(len(v.pictures) for v in exhibit.viewpoints)


def test_objects_of_maniskill_are_boxes_where_their_states_have_them():
    task = make_task("push")
    world = task.scene("fixed")
    fixtures = np.zeros((2 + len(task.markers), 7))
    fixtures[:, 3] = 1
    start = Start(world.qpos0, np.empty((0, 3)), fixtures)
    qpos = np.tile(world.qpos0, (2, 1))
    name = world.objects[0]
    at = world.qpos_of(name)
    qpos[1, at : at + 3] = 0.1, 0.2, 0.03
    camera = Camera.from_fovy(np.ones(1), 8, 8)
    course = Course(task, world, start, qpos, camera, test=False)
    bodies, note = course.bodies()
    assert [b.name for b in bodies] == [*world.objects, *task.markers]
    place = world.world_from_base @ [*bodies[0].base_from_body[1, :3, 3], 1]
    np.testing.assert_allclose(place[:3], [0.1, 0.2, 0.03], atol=1e-6)
    np.testing.assert_allclose(np.ptp(bodies[0].vertices, axis=0), simulated.BOX)
    assert "SAPIEN" in note
