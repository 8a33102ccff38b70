"""Requests read and refused."""

from dataclasses import replace

import numpy as np
import pytest
from port_requests import NAMES, SPEC, camera, request

from jaxcam.data.recorded.fitting import fit
from jaxcam.errors import CameraError, JaxcamError, PortError
from jaxcam.rays.lens import pack
from jaxcam.robot.requests import RequestReader

LENS = np.asarray(pack(np.array([-0.2, 0.05, 0, 0])), np.float32)


def read(message, *, names=NAMES, spec=SPEC, **how):
    return RequestReader(names, spec, **how).read(message)


def test_a_request_is_fitted_as_in_training():
    message = request(size=(30, 60))
    [moment] = read(message).moments
    fitted = fit((30, 60), (16, 24))
    assert moment["image"].shape == (2, 16, 24, 3)
    for i, view in enumerate(NAMES.views):
        picture = message[f"observation.images.{view}"]
        np.testing.assert_array_equal(moment["image"][i], fitted.picture(picture))
        K = fitted.intrinsics(message[f"camera.{view}.intrinsics"]).astype(np.float32)
        np.testing.assert_array_equal(moment["K"][i], K)
    np.testing.assert_array_equal(moment["proprio"], message["observation.state"])
    assert "distortion" not in moment


def test_pictures_of_the_policys_size_and_their_cameras_stay_as_they_are():
    message = request(size=(16, 24))
    [moment] = read(message).moments
    np.testing.assert_array_equal(moment["image"][0], message["observation.images.front"])
    np.testing.assert_array_equal(moment["K"][0], message["camera.front.intrinsics"])
    np.testing.assert_array_equal(
        moment["base_from_camera"][1], message["camera.wrist.base_from_camera"]
    )


def test_slashes_are_dots():
    dots = request()
    slashes = {name.replace(".", "/"): value for name, value in dots.items()}
    for one, other in zip(read(dots).moments, read(slashes).moments, strict=True):
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


def test_a_policy_of_fewer_views_takes_any_of_them_in_their_order():
    spec = replace(SPEC, views=1)
    message = request(views=("wrist",))
    [moment] = read(message, spec=spec).moments
    assert moment["base_from_camera"][0, 0, 3] == 0
    with pytest.raises(PortError, match=r"expected 1 of these: .*front.*wrist; got .*front.*wrist"):
        read(request(), spec=spec)


def test_a_lens_comes_with_its_intrinsics():
    [moment] = read(request(camera__front__distortion=LENS)).moments
    np.testing.assert_array_equal(moment["distortion"], [LENS, np.zeros(9)])
    message = request(camera__front__distortion=LENS, camera__front__intrinsics=None)
    with pytest.raises(PortError, match="a lens and its K come together"):
        read(message, needs_cameras=False)


def test_a_policy_that_is_told_no_cameras_needs_none():
    message = {k: v for k, v in request().items() if not k.startswith("camera.")}
    with pytest.raises(PortError, match=r"camera\.front\.intrinsics and camera\.front\.base_from"):
        read(message)
    [moment] = read(message, needs_cameras=False).moments
    assert moment["K"].shape == (2, 3, 3)
    [moment] = read(request(camera__front__distortion=LENS), needs_cameras=False).moments
    assert "distortion" not in moment  # it would be another program, for nothing


def test_several_observations_are_stacked_oldest_first():
    spec = replace(SPEC, obs_steps=3)
    message = request()
    for name in ("observation.images.front", "observation.images.wrist", "observation.state"):
        message[name] = np.stack([message[name] // 3 if "images" in name else message[name]] * 3)
    message["observation.state"][:, 0] = 1, 2, 3
    moving = np.stack([message["camera.wrist.base_from_camera"]] * 3)
    moving[:, 0, 3] = 0.1, 0.2, 0.3
    message["camera.wrist.base_from_camera"] = moving
    moments = read(message, spec=spec).moments
    assert [moment["proprio"][0] for moment in moments] == [1, 2, 3]
    places = [moment["base_from_camera"][:, 0, 3].tolist() for moment in moments]
    np.testing.assert_allclose(places, [[0, 0.1], [0, 0.2], [0, 0.3]], atol=1e-6)
    message["observation.state"] = message["observation.state"][0]
    with pytest.raises(PortError, match=r"one moment, or 3 of each; .*front has 3.*state has 1"):
        read(message, spec=spec)


IMAGE = "observation__images__front"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({IMAGE: None}, r"expected these: observation\.images\.front, .*got .*\.wrist"),
        ({IMAGE: np.zeros((16, 24, 3), np.float32)}, r"images\.front: expected uint8 .* float32"),
        ({IMAGE: np.zeros((3, 16, 24), np.uint8)}, r"\[rows, columns, 3\], got uint8 \[3, 16, 24"),
        ({IMAGE: np.zeros((0, 24, 3), np.uint8)}, r"got uint8 \[0, 24, 3\]"),
        ({IMAGE: np.zeros((2, 16, 24, 3), np.uint8)}, r"got uint8 \[2, 16, 24, 3\]"),
        ({IMAGE: [1, 2]}, "got list"),
        ({IMAGE: np.zeros((5000, 2, 3), np.uint8)}, "up to 4096 pixels a side"),
        ({"observation__state": None}, r"state is missing: expected float32 \[3\]: x, y, grip"),
        ({"observation__state": np.zeros(4)}, r"expected float32 \[3\], got float64 \[4\]"),
        ({"observation__state": np.array(["a", "b", "c"])}, "got <U1"),
        ({"observation__state": np.array([1, np.nan, 2])}, "finite numbers, got .*nan"),
        ({"observation__state": np.array([1, 1e300, 2])}, "finite numbers"),
        ({"observation__state": 3.0}, "got float"),
        ({"observation__sate": np.zeros(3)}, "did you mean 'observation.state'"),
        ({"observation/state": np.zeros(3)}, "twice"),
        ({"camera__front__intrinsics": np.eye(4)}, r"expected float32 \[3, 3\], got float64 \[4"),
        ({"camera__front__intrinsics": np.zeros((3, 3))}, "focal lengths"),
        ({"camera__wrist__base_from_camera": np.diag([2.0, 2, 2, 1])}, "rotation R of base_from_c"),
        ({"camera__wrist__base_from_camera": np.full((4, 4), np.inf)}, "finite numbers"),
        ({"camera__front__intrinsics": None}, "or start the server with --cameras"),
        ({"prompt": 3}, "prompt: expected text, got int"),
        ({"call": -1}, "call: expected a whole number from 0"),
        ({"row": 1}, "row: expected a whole number from 0 to 0, got 1"),
        ({"row": True}, "row: expected a whole number"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_what_was_expected(changes, words):
    with pytest.raises((PortError, CameraError), match=words):
        read(request(**changes))


@pytest.mark.parametrize("message", [[], 3, None, "state"])
def test_what_is_no_observation_is_refused(message):
    with pytest.raises(PortError, match="entries by their names"):
        read(message)


def test_names_that_are_no_text_are_refused():
    with pytest.raises(PortError, match="Unknown entry 7"):
        read(request() | {7: 8})


def test_a_camera_of_a_view_without_a_picture_is_refused():
    spec = replace(SPEC, views=1)
    with pytest.raises(PortError, match=r"camera\.wrist\.intrinsics, but no observation\.images"):
        read(request(observation__images__wrist=None), spec=spec)


def test_what_was_learned_is_all_that_can_be_asked_for():
    assert read(request(prompt="anything"))
    assert read(request(prompt="Lift it. "), prompts=("Lift it.",))
    with pytest.raises(PortError, match=r"expected 'Lift it.'.* got 'Dance.'"):
        read(request(prompt="Dance."), prompts=("Lift it.",))


def test_each_new_camera_is_checked_and_known_ones_are_not(monkeypatch):
    looked = []
    real = RequestReader.__module__ + ".Camera"
    from jaxcam.robot import requests

    class Looking(requests.Camera):
        def validate(self, name="camera"):
            looked.append(name)
            return super().validate(name)

    monkeypatch.setattr(real, Looking)
    reader = RequestReader(NAMES, SPEC)
    K, pose = camera(32, 48, x=0.123)
    moved = {"camera__front__base_from_camera": pose, "camera__front__intrinsics": K}
    reader.read(request(**moved))
    first = looked.count("camera of view 'front'")
    reader.read(request(**moved))
    assert first == looked.count("camera of view 'front'") == 1
    spoilt = pose.copy()
    spoilt[0, 0] = 3
    for _ in range(2):  # a bad one is looked at every time
        with pytest.raises(JaxcamError, match="rotation"):
            reader.read(request(**moved | {"camera__front__base_from_camera": spoilt}))


def test_of_several_prompts_the_one_that_is_asked_is_told_by_number():
    known = ("Lift it.", "Put it down.")
    [moment] = read(request(prompt="Put it down. "), prompts=known).moments
    assert moment["instruction"] == 1
    assert "instruction" not in read(request(prompt="Lift it."), prompts=known[:1]).moments[0]
    for prompt in ("Dance.", None):
        with pytest.raises(PortError, match=r"expected one of 'Lift it\.', 'Put it down\.'"):
            read(request(prompt=prompt), prompts=known)
