"""LeRobot folders that tests share, and copies to spoil."""

import shutil

import pytest


@pytest.fixture(scope="session")
def originals(tmp_path_factory):
    """Folders and what they were written from, by version and kind of pictures."""
    from lerobot_datasets import write_folder  # needs pyarrow, which the tests that ask for it have

    made = {}

    def original(version="v3.0", dtype="video"):
        if (version, dtype) not in made:
            root = tmp_path_factory.mktemp("lerobot") / "folder"
            made[version, dtype] = root, write_folder(root, version, dtype)
        return made[version, dtype]

    return original


@pytest.fixture
def copied(originals, tmp_path):
    """A folder of one's own."""

    def copy(version="v3.0", dtype="video"):
        return shutil.copytree(originals(version, dtype)[0], tmp_path / "copy")

    return copy
