"""Cameras that a file says for all requests."""

import json

import numpy as np
import pytest
from port_requests import NAMES, SPEC, camera, request

from jaxcam.errors import ConfigError, JaxcamError
from jaxcam.robot.requests import RequestReader
from jaxcam.robot.rig import read_rig


def entry(size=(64, 96), x=0.0, **more):
    height, width = size
    K, pose = camera(height, width, x)
    return {"K": K.tolist(), "size": [width, height], "base_from_camera": pose.tolist(), **more}


def write(folder, views, **more):
    file = folder / "cameras.json"
    file.write_text(json.dumps({"format": 1, "views": views, **more}))
    return file


def test_requests_need_not_say_what_the_file_says(tmp_path):
    views = {"front": entry(x=0.0), "observation.images.wrist": entry(x=0.25), "third": entry()}
    rig = read_rig(write(tmp_path, views), NAMES.views)
    assert rig.others == ("third",)
    assert rig.says_all_of(NAMES.views)
    reader = RequestReader(NAMES, SPEC, rig=rig)
    bare = {k: v for k, v in request().items() if not k.startswith("camera.")}
    [by_file], [by_request] = (
        reader.read(bare).moments,
        RequestReader(NAMES, SPEC).read(request()).moments,
    )
    for name in by_request:  # pictures are half the size that the file's K is for
        np.testing.assert_allclose(by_file[name], by_request[name], atol=1e-5)


def test_a_request_overrules_the_file(tmp_path):
    lens = {"lens": "opencv", "distortion": [-0.2, 0.05, 0, 0]}
    rig = read_rig(write(tmp_path, {"front": entry(x=3.0, **lens)}), NAMES.views)
    assert not rig.says_all_of(NAMES.views)
    reader = RequestReader(NAMES, SPEC, rig=rig)
    [moment] = reader.read(request()).moments
    assert moment["base_from_camera"][0, 0, 3] == 0
    assert "distortion" not in moment
    [moment] = reader.read(request(camera__front__intrinsics=None)).moments
    assert moment["distortion"][0, 0] == np.float32(-0.2)


def test_of_a_camera_on_the_hand_the_request_says_where_it_is(tmp_path):
    own = {k: v for k, v in entry(x=0.25).items() if k != "base_from_camera"}
    views = {"front": entry(x=0.0), "wrist": own | {"grip_from_camera": np.eye(4).tolist()}}
    rig = read_rig(write(tmp_path, views), NAMES.views)
    assert not rig.says_all_of(NAMES.views)
    given = {k: v for k, v in request().items() if k != "camera.wrist.intrinsics"}
    (moment,) = RequestReader(NAMES, SPEC, rig=rig).read(given).moments
    assert np.isfinite(moment["base_from_camera"]).all()


def test_pictures_of_another_shape_than_in_the_file(tmp_path):
    rig = read_rig(write(tmp_path, {"front": entry((64, 64))}), NAMES.views)
    with pytest.raises(JaxcamError, match="K is for 64x64, the pictures are 48x32"):
        RequestReader(NAMES, SPEC, rig=rig).read(request(camera__front__intrinsics=None))


@pytest.mark.parametrize(
    ("views", "more", "words"),
    [
        ({"side": entry()}, {}, r"no camera of the policy's views \(front, wrist\), but of side"),
        ({"front": entry()}, {"episodes": {"0": {}}}, "'episodes' are for recorded datasets"),
        ({"wrist": {**entry(), "base_from_camera": [np.eye(4).tolist()] * 3}}, {}, "picture by p"),
        ({"wrist": {**entry(), "base_from_camera": "wrist.npz"}}, {}, "picture by picture"),
    ],
)
def test_what_holds_for_no_request_is_refused(tmp_path, views, more, words):
    with pytest.raises(ConfigError, match=words):
        read_rig(write(tmp_path, views, **more), NAMES.views)
