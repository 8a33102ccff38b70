"""Files of YAML: data, and each name once."""

import pytest

from jaxcam.errors import ConfigError
from jaxcam.files.yaml import read_yaml


def test_content_is_read(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text("a: [1, two, 3.0]\nshared: &s {x: 1}\nb: {<<: *s, y: 2}\n1: true\n")
    expected = {"a": [1, "two", 3.0], "shared": {"x": 1}, "b": {"x": 1, "y": 2}, 1: True}
    assert read_yaml(file) == expected


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", "'a' is there twice"),
        ("c:\n  - {a: 1, a: 2}\n", "'a' is there twice"),
        ("a: [", "cannot be read"),
        ("a: !!python/object/apply:os.getcwd []", "could not determine a constructor"),
        ("[" * 400, "cannot be read"),
        ("\x00", "cannot be read"),
        ("? [a]\n: 1\n", "unhashable"),
    ],
)
def test_what_is_none_is_refused(tmp_path, text, words):
    file = tmp_path / "a.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_yaml(file)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_yaml(tmp_path)
