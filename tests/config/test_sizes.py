"""Sizes of pictures in settings."""

import pytest

from jaxcam.config.sizes import rows_and_columns, size_name
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "size"), [(84, (84, 84)), ("84", (84, 84)), ("96x128", (96, 128))]
)
def test_a_side_or_rows_and_columns(text, size):
    assert rows_and_columns(text) == size
    assert rows_and_columns(size_name(*size)) == size
    assert TrainConfig(resolution=text).resolution == text


@pytest.mark.parametrize(
    "text", [15, 5000, "96x", "x96", "96x8", "96X128", "96x128x3", "-96x128", "", "٩٦", "1e2", 84.5]
)
def test_what_is_no_size(text):
    with pytest.raises(ConfigError, match="resolution"):
        rows_and_columns(text)
    with pytest.raises(ConfigError, match="resolution"):
        TrainConfig(resolution=text)
