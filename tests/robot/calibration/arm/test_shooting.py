"""Which pictures are taken, without their lens, and masks of other tools."""

from pathlib import Path

import numpy as np
import pytest

from jaxcam.data.recorded.recording import Calibration, Episode, Placement, Recording, Sight
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays.lens import distort, pack
from jaxcam.robot.calibration.arm.joints import JointNumbers
from jaxcam.robot.calibration.arm.shooting import (
    Straightener,
    chosen_steps,
    optics_for,
    read_masks,
    take_film,
)

K = np.array([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]])
OPTICS = Optics(K, 120, 80, np.zeros(9))


def recording(length=6, shape=(80, 120, 3), calibration=None, placement=None):
    pictures = [np.full(shape, 20 * t, np.uint8) for t in range(length)]
    sight = Sight(80, 120, lambda: iter(pictures), calibration, placement)
    state = np.linspace(0, 1, length)[:, None].astype(np.float32)
    return Recording(
        Path("cups"), ("front",), ("joint_1",), (), 10.0,
        [Episode("0", state, state, "", {"front": sight})], "",
    )  # fmt: skip


def test_steps_are_spaced_along_the_way_of_the_joints():
    angles = np.r_[np.zeros(50), np.linspace(0, 1, 11)][:, None]
    steps = chosen_steps(angles, 5)
    assert len(steps) == 5
    assert steps[-1] == 60
    assert (np.diff(angles[steps, 0]) > 0.15).all()
    np.testing.assert_array_equal(chosen_steps(np.zeros((4, 2)), 3), [0])


def test_a_film_has_pictures_joints_and_speeds():
    film = take_film(recording(), "front", JointNumbers((0,), None), OPTICS, [0], 3)
    np.testing.assert_array_equal(film.rgb[:, 0, 0, 0], 20 * film.steps)
    np.testing.assert_allclose(film.angles[:, 0], film.steps / 5, atol=1e-6)
    np.testing.assert_allclose(film.speeds, 2.0, atol=1e-5)
    assert film.opening is None


def test_pictures_of_another_size_are_refused():
    with pytest.raises(DatasetError, match=r"120x40, expected 120x80"):
        take_film(recording(shape=(40, 120, 3)), "front", JointNumbers((0,), None), OPTICS, [0], 3)


def test_the_lens_is_undone():
    lens = np.asarray(pack(np.array([-0.3, 0.05, 0, 0]), "opencv"))
    x, y = 0.3, 0.2
    u, v, _ = distort(np.float64(x), np.float64(y), lens, "opencv")
    at = np.array([u * 100 + 60, v * 100 + 40])
    ys, xs = np.mgrid[:80, :120] + 0.5
    spot = (255 * np.exp(-((xs - at[0]) ** 2 + (ys - at[1]) ** 2) / 8)).astype(np.uint8)
    straight = Straightener(Optics(K, 120, 80, lens))
    shown_film = straight(np.repeat(spot[..., None], 3, 2))[..., 0].astype(float)
    middle = (shown_film * xs).sum() / shown_film.sum(), (shown_film * ys).sum() / shown_film.sum()
    np.testing.assert_allclose(middle, [x * 100 + 60, y * 100 + 40], atol=0.15)


def test_large_pictures_become_smaller_as_their_intrinsics():
    straight = Straightener(Optics(10 * K, 1200, 800, np.zeros(9)))
    assert straight(np.zeros((800, 1200, 3), np.uint8)).shape == (320, 480, 3)
    np.testing.assert_allclose(straight.K[:2], 4 * K[:2])


def test_the_datasets_own_optics(tmp_path):
    own = recording(calibration=Calibration(K, np.eye(4)))
    np.testing.assert_array_equal(optics_for(own, "front", tmp_path / "none.json").K, K)
    lens = pack(np.array([-0.2, 0.05, 0, 0]), "opencv")
    format_says = recording(placement=Placement(None, "", K, "metadata", lens))
    optics = optics_for(format_says, "front", tmp_path / "none.json")
    np.testing.assert_array_equal(optics.K, K)
    np.testing.assert_array_equal(optics.distortion, lens)
    with pytest.raises(ConfigError, match="A pose needs K and the lens first"):
        optics_for(recording(), "front", tmp_path / "none.json")


def test_masks_of_another_tool(tmp_path):
    mask = np.zeros((1, 40, 60), bool)
    mask[0, 10:20] = True
    np.savez(tmp_path / "m.npz", episode=[0], step=[2], mask=mask)
    masks = read_masks(tmp_path / "m.npz")
    film = take_film(recording(), "front", JointNumbers((0,), None), OPTICS, [0], 3, masks)
    np.testing.assert_array_equal(film.steps, [2])
    assert film.masks is not None
    np.testing.assert_array_equal(np.flatnonzero(film.masks[0, :, 60]), range(20, 40))


def test_files_that_are_no_masks(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_masks(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_masks(tmp_path / "bad.npz")
    np.savez(tmp_path / "odd.npz", episode=[0, 1], step=[2], mask=np.zeros((1, 4, 4)))
    with pytest.raises(ConfigError, match="arrays of shapes"):
        read_masks(tmp_path / "odd.npz")
