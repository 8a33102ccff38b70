"""Where the tests' files are."""

from pathlib import Path

HELPERS = Path(__file__).parent
TESTS = HELPERS.parent
GOLDEN = TESTS / "golden"
REPO = TESTS.parent
