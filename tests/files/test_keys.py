"""Keys in files: the first line, and what is none."""

import pytest

from jaxcam.errors import ConfigError
from jaxcam.files.keys import check_key, read_key


def test_a_key_is_the_first_line_of_its_file(tmp_path):
    file = tmp_path / "key"
    file.write_text(" sesame \nof the robot in the hall\n")
    assert read_key(file, "key_file") == "sesame"


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "is empty"), (b"\nsesame", "is empty"), (b"a b", "one word"),
     ("ü".encode(), "ASCII"), (b"\xff", "cannot be read")],
)  # fmt: skip
def test_what_is_no_key_is_refused(tmp_path, content, words):
    file = tmp_path / "key"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=f"--key-file .*key.*{words}"):
        read_key(file, "--key-file")


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match=r"--key-file .* cannot be read"):
        read_key(tmp_path / "none", "--key-file")
    with pytest.raises(ConfigError, match="one word"):
        check_key("two words")
