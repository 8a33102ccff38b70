"""The list of faults is whole, and the tests that it names exist."""

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in (TESTS.parent / "docs" / "faults.md").read_text("utf-8").splitlines()
    if line.startswith("| ") and not line.startswith(("| #", "| fault"))
]


def test_every_case_has_a_row_in_order():
    assert [int(row[0]) for row in ROWS if len(row) == 4] == list(range(1, 65))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_case_is_tested_or_does_not_apply(row):
    fault, answer, tests = row[-3:]
    assert fault
    named = re.findall(r"`([\w/]+\.py)::(test_\w+)`", tests)
    assert len(named) == tests.count("::")
    assert named or "does not apply" in answer
    for file, function in named:
        assert f"\ndef {function}(" in (TESTS / file).read_text("utf-8"), (file, function)
