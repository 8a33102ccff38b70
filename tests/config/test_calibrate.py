"""Settings of `jaxcam.calibrate`."""

import pytest

from jaxcam.config.calibrate import CalibrateConfig, HandEyeConfig, LensConfig, TagsConfig
from jaxcam.config.flags import parse
from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("argv", "form"),
    [
        (["lens", "a", "b", "--view", "front"], LensConfig(("a", "b"), "front")),
        (["tags", "data"], TagsConfig(("data",))),
        (["hand-eye", "data", "--view", "front"], HandEyeConfig("data", "front")),
    ],
)
def test_each_form_has_a_word(argv, form):
    assert parse(CalibrateConfig, argv).form == form


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: LensConfig(), "--print-board"),
        (lambda: LensConfig(("a",)), "--view is its name"),
        (lambda: LensConfig(("a",), "front", marker_mm=30.0), "smaller than its square"),
        (lambda: LensConfig(("a",), "front", coefficients=6), "4, 5 or 8"),
        (lambda: LensConfig(("a",), "front", lens="fisheye", coefficients=8), "a fisheye has four"),
        (lambda: LensConfig(("a",), print_board="b.pdf"), "reads no pictures"),
        (lambda: LensConfig(("a",), "front", lens="wide"), "Unknown lens 'wide'"),
        (lambda: TagsConfig(()), "No pictures"),
        (lambda: HandEyeConfig("data"), "--view is its name"),
        (lambda: HandEyeConfig("data", "front", size_mm=0.0), "size_mm"),
    ],
)
def test_what_does_not_go_together(make, match):
    with pytest.raises(ConfigError, match=match):
        make()
