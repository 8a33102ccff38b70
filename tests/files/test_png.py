"""Pictures in files."""

import cv2
import numpy as np

from jaxcam.files.png import write_png


def test_png_keeps_the_colours(tmp_path):
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[..., 0] = 200
    written = cv2.imread(str(write_png(tmp_path / "a.png", picture)))
    assert written[0, 0].tolist() == [0, 0, 200]
