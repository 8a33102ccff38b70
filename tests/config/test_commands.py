"""What the settings of commands refuse."""

import pytest

from jaxcam.config.commands import CheckConfig, EvaluateConfig, ReportConfig
from jaxcam.config.foreign import ForeignConfig
from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        (EvaluateConfig, {"run": ("a",), "split": "valid"}, "did you mean 'validation'"),
        (EvaluateConfig, {"run": ("a",), "width": 0}, "width must be at least 1"),
        (EvaluateConfig, {"run": ("a",), "ensemble": -1.5}, "ensemble must be at least -1"),
        (EvaluateConfig, {"run": ()}, "No run is given"),
        (EvaluateConfig, {"run": ("a",), "protocol": "paper", "pairs": 7}, "leave out --step"),
        (EvaluateConfig, {"run": ("a",), "protocol": "paper", "step": 7}, "leave out --step"),
        (EvaluateConfig, {"run": ("a",), "protocol": "paper", "split": "train"}, "gives results"),
        (EvaluateConfig, {"foreign": ForeignConfig("a:b"), "split": "train"}, "nobody says which"),
        (ReportConfig, {"runs": ("a",), "split": "train"}, "unknown split|split"),
        (ReportConfig, {"runs": ()}, "No run is given"),
        (CheckConfig, {"target": "a", "env": True}, "not both"),
        (CheckConfig, {}, "Nothing to check"),
        (CheckConfig, {"target": "a", "episodes": -1}, "episodes must be at least 0"),
    ],
)
def test_bad_settings_are_refused(kind, settings, message):
    with pytest.raises(ConfigError, match=message):
        kind(**settings)


def test_the_papers_protocol_has_its_own_pairs():
    assert EvaluateConfig(("a",), protocol="paper").pairs == 50
