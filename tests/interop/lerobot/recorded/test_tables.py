"""Tables that are damaged, or have a column twice."""

import pytest

pytest.importorskip("pyarrow", reason="jaxcam[lerobot] is not installed")

from lerobot_datasets import (
    data_file,
    refused,
)
from pyarrow import parquet


def test_columns_that_clash(copied):
    root = copied()
    table = parquet.read_table(data_file(root))
    parquet.write_table(table.append_column("action", table.column("action")), data_file(root))
    refused(root, "has two columns 'action'")


def test_damaged_tables(copied):
    root = copied()
    content = data_file(root).read_bytes()
    data_file(root).write_bytes(content[: len(content) // 2])
    refused(root, r"file-000\.parquet is no whole table")
    data_file(root).write_bytes(content[:200] + b"\0" * 800 + content[1000:])
    refused(root, r"file-000\.parquet (is damaged|is no whole table)")


def test_texts_that_are_not_utf8(copied):
    root = copied()
    content = data_file(root).read_bytes()
    data_file(root).write_bytes(content.replace(b"frame_index", b"fr\xe1me_index"))
    refused(root, "is no whole table: 'utf-8' codec")
    data_file(root).write_bytes(content)
    tasks = root / "meta/tasks.parquet"
    tasks.write_bytes(tasks.read_bytes().replace(b"Pick", b"P\xe1ck"))
    refused(root, "has a text that is not UTF-8")
