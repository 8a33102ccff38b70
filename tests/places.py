"""Where the tests' files are."""

from pathlib import Path

TESTS = Path(__file__).parent
GOLDEN = TESTS / "golden"
REPO = TESTS.parent
