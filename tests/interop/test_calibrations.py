"""Calibrations of recorded cameras: which source counts, what is made of it, what is refused."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from odd_files import COUNT, flipped, odd_texts
from recorded import HEIGHT, STEPS, WIDTH, recording
from rich.console import Console

from jaxcam.data.recorded.recording import Calibration, Placement
from jaxcam.errors import CameraError, ConfigError, DatasetError, JaxcamError
from jaxcam.interop.calibrations import calibrated, require_calibrated, sources
from jaxcam.rays import Camera, lens, look_at, opengl_from_opencv

POSE = np.asarray(look_at(np.array([0.9, 0.2, 0.5]), np.array([0.4, 0.0, 0.1])), np.float64)
OTHER = np.asarray(look_at(np.array([0.1, -0.8, 0.7]), np.array([0.4, 0.0, 0.1])), np.float64)
BASE = np.array([[0, -1, 0, -0.5], [1, 0, 0, 0.2], [0, 0, 1, 0.9], [0, 0, 0, 1.0]])
K = np.array([[60.0, 0, 30.5], [0, 61.0, 25.0], [0, 0, 1]])
WIDE = [-0.2, 0.05, 0.001, -0.0005, 0.01]
FRONT = {
    "K": K.tolist(),
    "size": [WIDTH, HEIGHT],
    "lens": "opencv",
    "distortion": WIDE,
    "base_from_camera": POSE.tolist(),
}
WRIST = {
    "K": {"fx": 60, "fy": 61.0, "cx": 30.5, "cy": 25},
    "size": [WIDTH, HEIGHT],
    "base_from_camera": "wrist.npz",
}


def moving(length, shift=0.0):
    """Poses of a camera that is carried about [T, 4, 4]."""
    poses = np.tile(OTHER, (length, 1, 1))
    poses[:, 0, 3] += shift + 0.01 * np.arange(length)
    return poses


def write(folder, content, name="cameras.json"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def poses(tmp_path):
    """The file of the wrist's poses, beside `cameras.json`."""
    np.savez(tmp_path / "wrist.npz", **{str(i): moving(n, i) for i, n in enumerate(STEPS)})


def content(**more):
    return {"format": 1, "views": {"front": FRONT, "wrist": WRIST}} | more


def read(folder, views, **more):
    """The first episode's calibrations from a file with these views."""
    path = write(folder, {"format": 1, "views": views} | more)
    sights = calibrated(recording(), path).episodes[0].sights
    return {view: sight.calibration for view, sight in sights.items()}


def front(folder, **changes):
    """The front camera's calibration, of a file with changes of its entries; None takes one out."""
    entries = {k: v for k, v in (FRONT | changes).items() if v is not None}
    return read(folder, {"front": entries})["front"]


def test_a_file_calibrates_all_episodes(tmp_path, poses):
    path = write(tmp_path, content())
    before = recording()
    result = calibrated(before, path)
    require_calibrated(result, "late")
    for number, (episode, length) in enumerate(zip(result.episodes, STEPS, strict=True)):
        camera = episode.sights["front"].calibration
        np.testing.assert_array_equal(camera.K, K)
        np.testing.assert_array_equal(camera.base_from_camera, POSE)
        np.testing.assert_array_equal(camera.distortion, lens.pack(np.array(WIDE)))
        assert camera.source == str(path)
        wrist = episode.sights["wrist"].calibration
        np.testing.assert_array_equal(wrist.K, K)
        np.testing.assert_array_equal(wrist.base_from_camera, moving(length, number))
        assert not wrist.distortion.any()
    assert result.fingerprint != before.fingerprint
    assert result.fingerprint == calibrated(recording(), path).fingerprint
    nearer = content() | {
        "views": {"front": FRONT | {"distortion": [-0.21, *WIDE[1:]]}, "wrist": WRIST}
    }
    assert result.fingerprint != calibrated(before, write(tmp_path, nearer)).fingerprint


def test_opencv_calibrations_keep_their_rays(tmp_path):
    """K and coefficients as `calibrateCamera` gives them: whole numbers are centres of pixels."""
    camera = front(tmp_path, pixel_centers=0)
    np.testing.assert_array_equal(camera.K[:2, 2], K[:2, 2] + 0.5)
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 0.9], [0.2, -0.2, 1.2]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(WIDE))
    ours, _ = Camera(camera.K, np.eye(4), HEIGHT, WIDTH, camera.distortion).project(points)
    np.testing.assert_allclose(ours, theirs[:, 0] + 0.5, atol=1e-9)


def test_poses_in_a_world(tmp_path):
    """Of a world, and of OpenGL's axes."""
    entries = {k: v for k, v in FRONT.items() if k != "base_from_camera"}
    world = {"world_from_camera": opengl_from_opencv(BASE @ POSE).tolist(), "axes": "opengl"}
    file = {"front": entries | world}
    camera = read(tmp_path, file, world_from_base=BASE.tolist())["front"]
    np.testing.assert_allclose(camera.base_from_camera, POSE, atol=1e-12)


def test_lenses(tmp_path):
    fisheye = [0.02, 0.01, -0.003, 0.001]
    camera = front(tmp_path, lens="fisheye", distortion=fisheye)
    np.testing.assert_array_equal(camera.distortion, lens.pack(np.array(fisheye), "fisheye"))
    for name in (None, "opencv"):
        camera = front(tmp_path, lens=name)
        np.testing.assert_array_equal(camera.distortion, lens.pack(np.array(WIDE)))
    for name in (None, "pinhole"):
        assert not front(tmp_path, lens=name, distortion=None).distortion.any()


def test_an_episode_has_its_own(tmp_path, poses):
    moved = POSE.copy()
    moved[0, 3] += 0.03
    changes = {
        "1": {"front": {"base_from_camera": moved.tolist()}},
        "episode 2": {"front": {"lens": "pinhole"}, "wrist": {"size": [128, 96]}},
    }
    episodes = calibrated(recording(), write(tmp_path, content(episodes=changes))).episodes
    cameras = [e.sights["front"].calibration for e in episodes]
    for camera, pose, bends in zip(cameras, (POSE, moved, POSE), (True, True, False), strict=True):
        np.testing.assert_array_equal(camera.base_from_camera, pose)
        np.testing.assert_array_equal(camera.K, K)
        assert camera.distortion.any() == bends
    half = np.diag([0.5, 0.5, 1]) @ K
    wrists = [e.sights["wrist"].calibration.K for e in episodes]
    np.testing.assert_array_equal(np.stack(wrists), [K, K, half])


@pytest.mark.parametrize("scale", [2, 0.5, 7.5])
def test_k_follows_the_size_of_the_pictures(tmp_path, scale):
    size = [round(WIDTH * scale), round(HEIGHT * scale)]
    matrix = np.diag([scale, scale, 1]) @ K
    camera = front(tmp_path, K=matrix.tolist(), size=size)
    np.testing.assert_allclose(camera.K, K, atol=1e-12)
    theirs = Camera(matrix, POSE, size[1], size[0], np.array(WIDE))
    ours = Camera(camera.K, POSE, HEIGHT, WIDTH, camera.distortion)
    uv, _ = theirs.project(np.array([0.4, 0.05, 0.12]))
    np.testing.assert_allclose(ours.project(np.array([0.4, 0.05, 0.12]))[0] * scale, uv, atol=1e-9)


def columns(sight):
    camera = Calibration(K, OTHER, source="the columns camera.front.*")
    return replace(sight, calibration=camera)


def with_columns(result):
    """The recording as a reader gives it that found columns of the front camera."""
    episodes = [
        replace(e, sights=e.sights | {"front": columns(e.sights["front"])}) for e in result.episodes
    ]
    return replace(result, episodes=episodes)


def test_the_first_source_counts_and_each_is_told(tmp_path, poses, capsys):
    """Columns, the dataset's own file, the one that is given, and what its format says."""
    dataset = tmp_path / "dataset"
    own = FRONT | {"base_from_camera": OTHER.tolist()}
    notes = write(dataset, {"format": 1, "views": {"front": own}}, "meta/jaxcam.json")
    given = write(tmp_path, content())
    placed = recording(dataset, placement=Placement(BASE, "six numbers"))
    said = Console(width=60)

    def told_of(result, cameras=given):
        calibrated(result, cameras, said)
        return capsys.readouterr().out.splitlines()

    assert told_of(with_columns(placed)) == [
        "View front: the columns camera.front.*.",
        f"View wrist: {given}.",
        f"{given} is not used for view front: the columns camera.front.* comes first.",
    ]
    assert told_of(placed) == [
        f"View front: {notes}.",
        f"View wrist: {given}.",
        f"{given} is not used for view front: {notes} comes first.",
    ]
    notes.unlink()
    assert told_of(placed) == [f"View front: {given}.", f"View wrist: {given}."]
    optics = {k: v for k, v in FRONT.items() if k != "base_from_camera"}
    write(tmp_path, {"format": 1, "views": {"front": optics}})
    words = f"K: {given}; pose: six numbers"
    assert told_of(placed) == [
        f"View front: {words}.",
        "View wrist: nobody says K (its pose: six numbers).",
    ]
    front = calibrated(placed, given).episodes[0].sights["front"].calibration
    np.testing.assert_array_equal(front.base_from_camera, BASE)
    lacking = [f"View {view}: nobody says K (its pose: six numbers)." for view in placed.views]
    assert told_of(placed, None) == lacking


def test_columns_stay_as_they_are():
    before = with_columns(recording())
    result = calibrated(before)
    assert result.fingerprint == before.fingerprint
    front = result.episodes[0].sights["front"].calibration
    np.testing.assert_array_equal(front.base_from_camera, OTHER)
    assert sources(result)[1] == "View wrist: nobody says K and its pose."


def test_what_an_export_notes_is_no_calibration(tmp_path):
    """The file that version 0.1.0 and later exports have: their rows have the cameras."""
    notes = {"task": "lift", "action_space": "eef_delta", "fovy_deg": 45.0, "jaxcam": "0.1.0",
             "intrinsics": K.tolist(), "world_from_base": BASE.tolist(),
             "conventions": {}}  # fmt: skip
    write(tmp_path, notes, "meta/jaxcam.json")
    assert sources(calibrated(recording(tmp_path)))[0] == "View front: nobody says K and its pose."
    write(tmp_path, notes | content() | {"views": {"front": FRONT}}, "meta/jaxcam.json")
    assert "jaxcam.json" in sources(calibrated(recording(tmp_path)))[0]
    write(tmp_path, {"format": 1, "veiws": {}}, "meta/jaxcam.json")
    with pytest.raises(ConfigError, match="'veiws', did you mean 'views'"):
        calibrated(recording(tmp_path))


def test_missing_calibrations_are_refused_with_the_shortest_way(tmp_path):
    some = write(tmp_path, {"format": 1, "views": {}, "episodes": {"1": {"front": FRONT}}})
    result = calibrated(recording(), some)
    require_calibrated(result, "none")
    with pytest.raises(DatasetError) as error:
        require_calibrated(result, "late")
    words = str(error.value)
    assert "front (in 2 of 3 episodes): K and its pose; wrist (in 3 of 3 episodes)" in words
    assert "--cameras cameras.json" in words
    assert f'"size": [{WIDTH}, {HEIGHT}], "base_from_camera"' in words
    assert "--conditioning none" in words
    assert (
        sources(result)[0]
        == f"View front: nobody says K and its pose (2 episodes); {some} (1 episodes)."
    )


def test_half_a_calibration_is_told(tmp_path):
    """What is asked for is only what is missing, and K is not asked for twice."""
    optics = {k: v for k, v in FRONT.items() if k != "base_from_camera"}
    path = write(tmp_path, {"format": 1, "views": {"front": optics, "wrist": optics}})
    with pytest.raises(DatasetError) as error:
        require_calibrated(calibrated(recording(), path), "token")
    words = str(error.value)
    assert f"front (in 3 of 3 episodes): its pose (K: {path})" in words
    assert '"base_from_camera"' in words
    assert '"size"' not in words


def test_names_of_lerobot_may_be_in_full(tmp_path):
    for name in ("front", "observation.images.front"):
        path = write(tmp_path, {"format": 1, "views": {name: FRONT}})
        result = calibrated(recording(views=("front",)), path)
        require_calibrated(result, "late")
        assert all(e.sights["front"].calibration for e in result.episodes)


def turned(**changes):
    return lambda: {"format": 1, "views": {"front": FRONT | changes}}


def matrix(i, j, value, source=K):
    result = np.array(source)
    result[i, j] = value
    return result.tolist()


BAD = {
    "NaN in K": (turned(K=matrix(0, 0, np.nan)), CameraError, "finite numbers"),
    "a singular K": (turned(K=matrix(0, 0, 0.0)), CameraError, "fx != 0"),
    "negative focal lengths": (turned(K=(K * [[-1], [-1], [1]]).tolist()), CameraError, "fy > 0"),
    "K transposed": (turned(K=K.T.tolist()), CameraError, "K is transposed"),
    "K in parts": (turned(K={"fx": 1, "fy": 2, "cx": 3}), ConfigError, "no 'cy'"),
    "K of text": (turned(K=[["a", 0, 0]] * 3), ConfigError, "lists of numbers"),
    "K of two rows": (turned(K=K[:2].tolist()), CameraError, r"shape \[2, 3\]"),
    "K without a size": (turned(size=None), ConfigError, "without 'size'"),
    "sides swapped": (turned(size=[HEIGHT, WIDTH]), CameraError, "48x64, the pictures are 64x48"),
    "another shape": (turned(size=[64, 64]), CameraError, "does not scale evenly: K is for 64x64"),
    "a crop": (turned(size=[80, 48]), CameraError, "does not scale evenly"),
    "a size of 0": (turned(size=[0, 48]), CameraError, "positive whole number"),
    "three sides": (turned(size=[64, 48, 3]), ConfigError, "size has 2 values"),
    "centres elsewhere": (turned(pixel_centers=1), ConfigError, "0.5 or, in OpenCV"),
    "an unknown lens": (turned(lens="fishey"), ConfigError, "did you mean 'fisheye'"),
    "a bent pinhole": (turned(lens="pinhole"), ConfigError, "a pinhole has no distortion"),
    "an empty lens": (turned(distortion=[]), ConfigError, "without 'distortion'"),
    "twelve coefficients": (turned(distortion=[0.1] * 12), CameraError, "wrong shape"),
    "nine coefficients": (turned(distortion=[0.1] * 8 + [0]), CameraError, "nine coefficients"),
    "a fisheye of five": (turned(lens="fisheye"), CameraError, "wrong shape"),
    "NaN in a pose": (turned(base_from_camera=matrix(0, 3, np.nan, POSE)), CameraError, "finite"),
    "a mirrored pose": (turned(base_from_camera=(POSE * [[1, 1, -1, 1]]).tolist()), CameraError,
                        "mirrored basis"),
    "a pose transposed": (turned(base_from_camera=POSE.T.tolist()), CameraError, "is transposed"),
    "a scaled pose": (turned(base_from_camera=(POSE * [[2], [2], [2], [1]]).tolist()), CameraError,
                      "holds a scale"),
    "three rows": (turned(base_from_camera=POSE[:3].tolist()), CameraError, "append it"),
    "ragged rows": (turned(base_from_camera=[[1, 2], [3]]), ConfigError, "of one length"),
    "a long quaternion": (turned(base_from_camera={"position": [0, 0, 1],
                                                   "quaternion_wxyz": [2, 0, 0, 0]}),
                          CameraError, "quaternion of length 2"),
    "another order": (turned(base_from_camera={"position": [0, 0, 1], "quaternion_xyzw": [0] * 4}),
                      ConfigError, "did you mean 'quaternion_wxyz'"),
    "a long position": (turned(base_from_camera={"position": [0, 0, 1, 1],
                                                 "quaternion_wxyz": [1, 0, 0, 0]}),
                        ConfigError, r"expected \[3\] and \[4\]"),
    "the earth's centre": (turned(base_from_camera=matrix(0, 3, 6.4e6, POSE)), CameraError,
                           "coordinates on the earth"),
    "two poses": (turned(world_from_camera=POSE.tolist()), ConfigError, "Leave one out"),
    "no base": (lambda: {"format": 1, "views": {"front": {"world_from_camera": POSE.tolist()}}},
                ConfigError, "without 'world_from_base'"),
    "a moving base": (lambda: content(world_from_base=moving(3).tolist()), ConfigError, "one pose"),
    "unknown axes": (turned(axes="openg"), ConfigError, "did you mean 'opengl'"),
    "a misspelt entry": (turned(distorsion=WIDE), ConfigError, "did you mean 'distortion'"),
    "a misspelt view": (lambda: {"format": 1, "views": {"frnt": FRONT}}, ConfigError,
                        "view 'frnt', did you mean 'front'"),
    "a misspelt view of an episode": (lambda: content(episodes={"0": {"wirst": WRIST}}),
                                      ConfigError, "did you mean 'wrist'"),
    "an episode by two names": (lambda: content(episodes={"1": {}, "episode 1": {}}), ConfigError,
                                "'1' and 'episode 1' are one"),
    "an unknown episode": (lambda: content(episodes={"3": {}}), ConfigError, "Known: 0 to 2"),
    "a view by two names": (lambda: {"format": 1, "views": {"observation.images.front": FRONT,
                                                            "front": FRONT}},
                            ConfigError, "are one"),
    "a list of views": (lambda: {"format": 1, "views": [FRONT]}, ConfigError, "views must be dict"),
    "a newer format": (lambda: content(format=2), ConfigError, "newer jaxcam"),
    "no format": (lambda: {"views": {}}, ConfigError, "no 'format'"),
    "a list": (lambda: [], ConfigError, "not an object"),
    "too few poses": (turned(base_from_camera=moving(4).tolist()), CameraError,
                      "episode 'episode 0', view 'front'.* expected 5, .*got 4"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_is_refused_and_named(tmp_path, poses, what):
    make, error, words = BAD[what]
    path = write(tmp_path, make())
    with pytest.raises(error, match=words) as caught:
        calibrated(recording(), path)
    assert str(path) in str(caught.value)


def test_a_name_that_is_there_twice_is_refused(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text('{"format": 1, "views": {"front": {}, "front": {}}}')
    with pytest.raises(DatasetError, match="'front' is there twice"):
        calibrated(recording(), path)
    with pytest.raises(DatasetError, match=r"none\.json: no such file"):
        calibrated(recording(), tmp_path / "none.json")


def test_columns_are_checked_too():
    calibration = Calibration(K, moving(4), source="the columns camera.front.*")
    result = recording(views=("front",), calibration=calibration)
    with pytest.raises(CameraError, match=r"episode 0', view 'front', from the columns.*got 4"):
        calibrated(result)


def test_odd_values_and_flipped_bits_are_refused_or_cameras(tmp_path, poses):
    path, refused = tmp_path / "cameras.json", 0
    episodes = {"1": {"front": {"base_from_camera": OTHER.tolist()}}}
    healthy = content(episodes=episodes, world_from_base=BASE.tolist(), about={"by": "me"})
    texts = [text.encode("utf-8", "surrogatepass") for text in odd_texts([healthy])]
    for text in [*texts, *flipped(json.dumps(healthy).encode())]:
        path.write_bytes(text)
        try:
            result = calibrated(recording(), path)
        except JaxcamError as error:
            str(error).encode()
            refused += 1
            continue
        for episode in result.episodes:
            for sight in episode.sights.values():
                if sight.calibration:
                    camera = sight.calibration
                    R = camera.base_from_camera[..., :3, :3]
                    assert np.isfinite(camera.base_from_camera).all()
                    assert np.isfinite(camera.K).all()
                    assert np.abs(np.linalg.inv(R) - np.swapaxes(R, -1, -2)).max() < 1e-2
    assert refused > COUNT
