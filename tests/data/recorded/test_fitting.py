"""Recorded pictures brought to a size: nothing is cut or bent, and K goes with the pixels."""

import numpy as np
import pytest

from jaxcam.data.recorded.fitting import fit, keeping_shape

K = np.array([[100.0, 0, 64], [0, 110, 47], [0, 0, 1]])


@pytest.mark.parametrize("recorded", [(96, 128), (128, 96), (64, 64), (480, 640), (37, 211)])
@pytest.mark.parametrize("wanted", [(48, 64), (64, 48), (84, 84), (200, 100)])
def test_intrinsics_move_with_the_pixels(recorded, wanted):
    """A bright blob is where K says that its point is."""
    rows, columns = recorded
    y, x = rows * 0.4, columns * 0.7
    grid_y, grid_x = np.mgrid[:rows, :columns] + 0.5
    width = max(rows, columns) / 16
    blob = np.exp(-((grid_x - x) ** 2 + (grid_y - y) ** 2) / (2 * width**2))
    picture = np.repeat((255 * blob).astype(np.uint8)[..., None], 3, -1)
    fitted = fit(recorded, wanted)
    result = fitted.picture(picture)[..., 0].astype(float)
    assert result.shape == wanted
    inside = np.array([x, y, 1.0])
    there = (fitted.intrinsics(K) @ np.linalg.inv(K) @ inside)[:2]
    at_y, at_x = np.mgrid[: wanted[0], : wanted[1]] + 0.5
    middle = [(result * a).sum() / result.sum() for a in (at_x, at_y)]
    weight = (blob * grid_x).sum() / blob.sum(), (blob * grid_y).sum() / blob.sum()
    expected = there + (np.array(weight) - (x, y)) * fitted.zoom  # edges cut the blob
    np.testing.assert_allclose(middle, expected, atol=0.35)


def test_one_zoom_and_black_where_there_is_nothing():
    fitted = fit((100, 200), (50, 50))
    assert fitted.zoom == (0.25, 0.25)
    result = fitted.picture(np.full((100, 200, 3), 200, np.uint8))
    assert (result[:12] == 0).all()
    assert (result[-12:] == 0).all()
    assert (result[13:37] == 200).all()


def test_a_picture_that_fits_is_left_as_it_is():
    picture = np.arange(48 * 64 * 3, dtype=np.uint8).reshape(48, 64, 3)
    fitted = fit((48, 64), (48, 64))
    assert fitted.picture(picture) is picture
    np.testing.assert_array_equal(fitted.intrinsics(K), K)


@pytest.mark.parametrize(
    ("recorded", "shorter", "expected"),
    [((480, 640), 84, (84, 112)), ((720, 1280), 84, (84, 148)), ((64, 64), 84, (84, 84)),
     ((1280, 720), 96, (172, 96))],
)  # fmt: skip
def test_the_shape_is_kept(recorded, shorter, expected):
    assert keeping_shape(recorded, shorter) == expected
