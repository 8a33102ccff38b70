"""What a policy is sent: the cameras that are used, under its names, with their calibrations."""

import json

import numpy as np
import pytest
from rehearsal import CAMERAS

from jaxcam.errors import CameraError, ConfigError, PortError
from jaxcam.robot.trials.sights import PolicySight, calibrations, read_calibrations, views_for

NAMES = ("first", "second", "third")
PICTURE = np.zeros((42, 42, 3), np.uint8)


def sight(placement="2", **changes):
    known, lacking = calibrations(read_calibrations(CAMERAS, NAMES), NAMES, placement)
    assert lacking == []
    views = {"first": "view_0", "third": "view_1"}
    return PolicySight(**{"cameras": NAMES, "views": views, "known": known} | changes)


def test_two_of_three_with_their_cameras():
    given = {f"observation.images.{name}": PICTURE + i for i, name in enumerate(NAMES)}
    request = sight(prompt="Lift it.").request(given | {"observation/state": np.zeros(3)})
    assert set(request) == {
        "observation.images.view_0", "observation.images.view_1", "observation.state", "prompt",
        *(f"camera.view_{i}.{part}" for i in (0, 1) for part in ("intrinsics", "base_from_camera")),
    }  # fmt: skip
    assert request["observation.images.view_1"].max() == 2
    K = request["camera.view_1.intrinsics"]  # of pictures of half the size
    np.testing.assert_allclose(K[:2, 2], 21)
    np.testing.assert_allclose(K[0, 0], 101.397 / 2)
    place = json.loads(CAMERAS.read_text())["episodes"]["2"]["third"]["base_from_camera"]
    np.testing.assert_allclose(
        request["camera.view_1.base_from_camera"][:3, 3], place["position"], rtol=1e-6
    )


def test_what_the_robot_says_of_a_camera_that_moves_comes_first():
    pose = np.eye(4, dtype=np.float32)
    given = {f"observation.images.{name}": PICTURE for name in NAMES}
    said = {"camera.third.base_from_camera": pose, "camera.second.base_from_camera": pose}
    request = sight().request(given | said)
    np.testing.assert_array_equal(request["camera.view_1.base_from_camera"], pose)
    assert "camera.second.base_from_camera" not in request


def test_pictures_of_several_steps_have_one_camera():
    given = {f"observation.images.{name}": np.stack([PICTURE] * 3) for name in NAMES}
    assert sight().request(given)["camera.view_0.intrinsics"].shape == (3, 3)


def test_without_cameras_an_observation_goes_as_it_is():
    given = {"observation.images.front": PICTURE, "camera.front.intrinsics": np.eye(3)}
    assert PolicySight().request(given).keys() == given.keys()


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({}, PortError, "No picture of the camera 'first': .* that came are none"),
        ({"observation.images.frist": PICTURE}, PortError, "came are observation.images.frist"),
        (dict.fromkeys(("observation.images.first", "observation.images.third"), PICTURE[0]),
         PortError, r"has shape \[42, 3\]"),
        (dict.fromkeys(("observation.images.first", "observation.images.third"), PICTURE[:20]),
         CameraError, "first: K for another size"),
    ],
)  # fmt: skip
def test_what_cannot_be_sent_is_told(given, error, words):
    with pytest.raises(error, match=words):
        sight().request(given)


def test_names_of_cameras_may_have_dots():
    names = ("arm", "arm.left", "arm.right")
    views = {"arm.left": "view_0", "arm": "view_1"}
    given = {f"observation.images.{name}": PICTURE + i for i, name in enumerate(names)}
    pose = {f"camera.{name}.base_from_camera": np.eye(4) for name in names}
    request = PolicySight(names, views).request(given | pose)
    assert set(request) == {
        f"{a}.view_{i}{b}"
        for i in (0, 1)
        for a, b in (("observation.images", ""), ("camera", ".base_from_camera"))
    }
    assert request["observation.images.view_0"].max() == 1


def test_a_policy_s_own_names_come_first():
    assert views_for(("side", "front"), ("front", "wrist")) == {"side": "wrist", "front": "front"}
    assert views_for(("a", "c"), ("v0", "v1")) == {"a": "v0", "c": "v1"}
    assert views_for(("b", "c"), ("a", "b", "c")) == {"b": "b", "c": "c"}
    assert views_for(("a",), ()) == {"a": "a"}
    assert views_for(("a", "b"), ("v",)) == {"a": "v", "b": "b"}


def test_what_a_file_lacks_is_said(tmp_path):
    content = json.loads(CAMERAS.read_text())
    del content["episodes"]["3"]["second"]
    del content["views"]["first"]["K"]
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(content))
    file = read_calibrations(path, NAMES)
    known, lacking = calibrations(file, NAMES, "3")
    assert set(known) == {"third"}
    assert [words.removeprefix(f"{path} has ") for words in lacking] == [
        "no K of the camera 'first' at placement '3'",
        "no single pose of the camera 'second' at placement '3'",
    ]
    assert "did you mean '7'" in calibrations(file, NAMES, "77")[1][0]
    with pytest.raises(ConfigError, match="no view 'fist', did you mean 'first'"):
        read_calibrations(path, ("fist",))
