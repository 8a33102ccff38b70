"""What is to be seen, and two of it over each other."""

from dataclasses import replace

import numpy as np
import pytest
from exhibits import an_exhibit

from jaxcam.rays.rotations import matrix_from_rotvec
from jaxcam.viewer.exhibit import FIRST, SECOND, Exhibit, overlaid


@pytest.fixture(scope="module")
def exhibit():
    return an_exhibit()


def test_a_stage_lasts_as_long_as_what_moves_in_it(exhibit):
    assert exhibit.length == 6
    assert replace(exhibit, bodies=()).length == 6  # the grip's way
    assert Exhibit("still", "").length == 1


def test_two_stages_have_colours_and_names_of_whose_they_are(exhibit):
    both = overlaid(exhibit, exhibit, ("old", "new"))
    assert len(both.viewpoints) == 2 * len(exhibit.viewpoints)
    assert {(v.group, v.colour) for v in both.viewpoints} == {("old", FIRST), ("new", SECOND)}
    names = [x.name for x in (*both.viewpoints, *both.bodies, *both.ways, *both.outcomes)]
    assert len(set(names)) == len(names)
    assert [body.opacity for body in both.bodies] == [1, 1, 0.4, 0.4]


def test_cameras_of_one_name_are_told_how_far_apart_they_are(exhibit):
    view = exhibit.viewpoints[0]
    turned = np.eye(4)
    turned[:3, :3] = matrix_from_rotvec(np.deg2rad([0, 0, 2.0]))
    turned[:3, 3] = 0.003, 0.004, 0
    camera = replace(view.camera, world_from_camera=view.camera.world_from_camera @ turned)
    other = replace(exhibit, viewpoints=(replace(view, camera=camera),))
    notes = overlaid(exhibit, other, ("old", "new")).notes
    assert notes[0] == "front: 5.0 mm and 2.00 degrees apart."
    assert sum("apart" in note for note in notes) == 1
