"""Poses as people write them, and files of poses that may not be read."""

import numpy as np
import pytest

from jaxcam.errors import JaxcamError
from jaxcam.interop.cameras.poses import checked_pose, place_of
from jaxcam.rays import look_at, opengl_from_opencv
from jaxcam.rays.rotations import quaternion_from_matrix

POSE = np.asarray(look_at(np.array([0.9, 0.2, 0.5]), np.array([0.4, 0.0, 0.1])), np.float64)


def moving(length):
    """Poses of a camera that is carried about [T, 4, 4]."""
    poses = np.tile(POSE, (length, 1, 1))
    poses[:, 0, 3] += 0.01 * np.arange(length)
    return poses


def test_ways_to_write_a_pose(tmp_path):
    quaternion = quaternion_from_matrix(POSE[:3, :3])
    parts = {"position": POSE[:3, 3].tolist(), "quaternion_wxyz": quaternion.tolist()}
    for value, axes in (
        (POSE.tolist(), "opencv"),
        (parts, "opencv"),
        (opengl_from_opencv(POSE).tolist(), "opengl"),
        (np.round(POSE, 4).tolist(), "opencv"),
        (parts | {"quaternion_wxyz": np.round(quaternion, 4).tolist()}, "opencv"),
    ):
        pose = checked_pose(place_of(value, "front", tmp_path), "front", axes)
        np.testing.assert_allclose(pose, POSE, atol=2e-4)
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)
    poses = moving(5)
    each = {
        "position": poses[:, :3, 3].tolist(),
        "quaternion_wxyz": np.tile(quaternion, (5, 1)).tolist(),
    }
    pose = checked_pose(place_of(each, "wrist", tmp_path), "wrist")
    np.testing.assert_allclose(pose, poses, atol=1e-12)


def test_files_beside_the_text(tmp_path):
    (tmp_path / "poses").mkdir()
    np.save(tmp_path / "front.npy", np.float32(POSE))
    np.savez_compressed(tmp_path / "poses" / "wrist.npz", **{"3": moving(4), "night": moving(2)})
    front, wrist = (place_of(n, "a", tmp_path) for n in ("front.npy", "poses/wrist.npz"))
    np.testing.assert_array_equal(front.read(("episode 0", "0")), np.float32(POSE))
    np.testing.assert_array_equal(wrist.read(("episode 3", "3")), moving(4))
    np.testing.assert_array_equal(wrist.read(("night", "3")), moving(2))
    assert wrist.read(("episode 4", "4")) is None


def pickled(folder):
    np.save(folder / "p.npy", np.array([{}]), allow_pickle=True)
    return "p.npy"


def outside(folder):
    np.save(folder.parent / "outside.npy", POSE)
    return "../outside.npy"


def linked(folder):
    np.save(folder.parent / "outside.npy", POSE)
    (folder / "link.npy").symlink_to(folder.parent / "outside.npy")
    return "link.npy"


def absolute(folder):
    np.save(folder.parent / "outside.npy", POSE)
    return str(folder.parent / "outside.npy")


def cut(folder):
    np.savez(folder / "cut.npz", **{"0": moving(5)})
    (folder / "cut.npz").write_bytes((folder / "cut.npz").read_bytes()[:200])
    return "cut.npz"


def cut_array(folder):
    np.save(folder / "cut.npy", moving(5))
    (folder / "cut.npy").write_bytes((folder / "cut.npy").read_bytes()[:200])
    return "cut.npy"


def text(folder):
    np.save(folder / "t.npy", np.array(["a"]))
    return "t.npy"


def giant(folder):
    with open(folder / "g.npy", "wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 4, 4)}
        np.lib.format.write_array_header_1_0(file, header)
    return "g.npy"


FILES = {
    "missing": (lambda folder: "no.npy", "no such file"),
    "of another kind": (lambda folder: "cameras.json", "no name of a .npy or .npz"),
    "pickled": (pickled, "Python objects"),
    "outside": (outside, "leads out of"),
    "linked": (linked, "leads out of"),
    "absolute": (absolute, "leads out of"),
    "cut": (cut, "damaged"),
    "a cut array": (cut_array, "damaged"),
    "text": (text, "expected numbers"),
    "giant": (giant, "damaged"),
}


@pytest.mark.parametrize("what", FILES)
def test_files_of_poses_that_may_not_be_read(tmp_path, what):
    make, words = FILES[what]
    folder = tmp_path / "cameras"
    folder.mkdir()
    name = make(folder)
    with pytest.raises(JaxcamError, match=words):
        checked_pose(place_of(name, "front", folder).read(("0",)), "front")
