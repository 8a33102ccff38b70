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
