"""Rows that survive crashes."""

import json
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from jaxcam.errors import DatasetError
from jaxcam.files.jsonl import append_jsonl, read_jsonl


def test_jsonl_round_trip(tmp_path):
    path = tmp_path / "rows.jsonl"
    assert read_jsonl(path) == []
    append_jsonl(path, {"a": np.float32(0.5), "b": [1, "ä\n"]})
    append_jsonl(path, {"c": np.arange(2)}, {"d": np.bool_(True)}, fsync=True)
    append_jsonl(path)
    assert read_jsonl(path) == [{"a": 0.5, "b": [1, "ä\n"]}, {"c": [0, 1]}, {"d": True}]
    assert len(path.read_text().splitlines()) == 3


@pytest.mark.parametrize("torn", [b'{"step": 3, "lo', b'{"step": 3}', b"\x80", b"x" * 200_000])
@pytest.mark.parametrize("whole", [b"", b'{"step": 1}\n{"step": 2}\n'])
def test_torn_last_line_is_ignored_and_cut(tmp_path, torn, whole):
    path = tmp_path / "rows.jsonl"
    path.write_bytes(whole + torn)
    rows = [json.loads(line) for line in whole.splitlines()]
    assert read_jsonl(path) == rows
    append_jsonl(path, {"step": 4})
    assert read_jsonl(path) == [*rows, {"step": 4}]
    assert path.read_bytes().startswith(whole)


def test_damage_before_the_last_line_is_an_error(tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_text('{"step": 1}\n{"st\n{"step": 3}\n')
    with pytest.raises(DatasetError, match=r"rows\.jsonl, line 2, is damaged"):
        read_jsonl(path)


def test_writers_killed_while_appending_leave_whole_rows(tmp_path):
    path = tmp_path / "rows.jsonl"
    script = textwrap.dedent("""
        import sys
        from jaxcam.files.jsonl import append_jsonl, read_jsonl
        start = len(read_jsonl(sys.argv[1]))
        for i in range(start, 10**9):
            append_jsonl(sys.argv[1], {"i": i, "text": "x" * 5000})
            if i == start + 20: print("going", flush=True)
    """)
    for _ in range(2):
        command = [sys.executable, "-c", script, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            assert writer.stdout.readline()
            writer.kill()
    rows = read_jsonl(path)
    assert len(rows) > 40
    assert [row["i"] for row in rows] == list(range(len(rows)))


@pytest.mark.parametrize("line", ["[1]", "3", "null", '"text"', "[" * 100_000])
def test_lines_that_are_no_objects_are_an_error(tmp_path, line):
    path = tmp_path / "rows.jsonl"
    path.write_text(line + "\n")
    with pytest.raises(
        DatasetError, match=r"rows\.jsonl, line 1(, is damaged|: expected names with values)"
    ):
        read_jsonl(path)


def test_a_full_disk_is_an_error():
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    with pytest.raises(OSError, match="No space left"):
        append_jsonl("/dev/full", {"step": 1})
