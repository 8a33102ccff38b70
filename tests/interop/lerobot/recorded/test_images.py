"""Images in tables, and what else can be in their place."""

import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

from lerobot_datasets import (
    LENGTHS,
    TOP,
    data_file,
    edit_table,
    refused,
    shown,
)
from pyarrow import parquet

from jaxcam.errors import DatasetError
from jaxcam.interop.lerobot.reading import read_lerobot


def test_a_changed_image_changes_the_fingerprint(copied):
    root = copied("v3.0", "image")
    before = read_lerobot(root).fingerprint
    column = parquet.read_table(data_file(root)).column(TOP)
    edit_table(data_file(root), **{TOP: [column[1].as_py(), *column.to_pylist()[1:]]})
    assert read_lerobot(root).fingerprint != before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"bytes": b"no picture", "path": "x.png"}, "step 0 cannot be decoded"),
        ({"bytes": None, "path": "images/x.png"}, "step 0 is not in the table"),
        ("x.png", "has no PNG or JPEG but string"),
        (None, r"has no column 'observation\.images\.top'. It has "),
    ],
)
def test_images_that_are_none(copied, content, words):
    root = copied("v3.0", "image")
    edit_table(data_file(root), **{TOP: [content] * 10 if content else None})
    refused(root, words)


def test_an_image_that_is_damaged_is_told_as_it_is_decoded(copied):
    root = copied("v3.0", "image")
    images = parquet.read_table(data_file(root)).column(TOP).to_pylist()
    images[7] = {"bytes": images[7]["bytes"][:40], "path": ""}
    edit_table(data_file(root), **{TOP: images})
    recording = read_lerobot(root)
    assert len(shown(recording.episodes[0])) == LENGTHS[0]
    with pytest.raises(DatasetError, match="episode 1 of view 'top': the picture of step 1"):
        shown(recording.episodes[1])
