"""Pictures as PNG files."""

from pathlib import Path

import cv2
import numpy as np

from jaxcam.files.whole import whole


def write_png(path: Path, picture: np.ndarray) -> Path:
    """Writes a picture, uint8 RGB, as small as PNG can."""
    settings = [cv2.IMWRITE_PNG_COMPRESSION, 9]
    content = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), settings)[1]
    with whole(path) as part:
        part.write_bytes(content.tobytes())
    return path
