"""A dataset that a test may spoil."""

import shutil

import pytest


@pytest.fixture
def copy(demos, tmp_path):
    """Path of a copy of the session's dataset."""
    return shutil.copy(demos.path, tmp_path / demos.path.name)
