"""Digests of arrays and of files: what has changed is noticed, wherever it is."""

import numpy as np
import pytest
from tiny_checkpoints import damage_flip, flip_byte, fresh, train

from jaxcam.training.digests import DamagedError, flatten, read_all

# Orbax reads arrays side by side and closes its event loop at the first that fails; the others
# then complain from threads of their own.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def test_thirty_flipped_bytes_are_all_noticed(run):
    """Anywhere: in arrays, in what orbax writes around them, in the manifest, in the digests."""
    folder = run / "checkpoints" / "3"
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    assert len({p.relative_to(folder).parts[0] for p in files}) > 4
    rng = np.random.default_rng(0)
    for number in range(30):
        file = files[number % len(files)]
        before = file.read_bytes()
        flip_byte(file, rng.random())
        with pytest.raises(DamagedError):
            read_all(folder)
        file.write_bytes(before)
    read_all(folder)


def test_without_digests_of_files_arrays_are_still_compared(run):
    """As after a kill between the commit of a checkpoint and its digests."""
    folder = run / "checkpoints" / "3"
    (folder / "files.json").rename(folder / "files.json.part")
    _, leaves = read_all(folder)
    for name, leaf in flatten(train(fresh(), 3)).items():
        np.testing.assert_array_equal(leaves[name], leaf)
    damage_flip(run)
    with pytest.raises(DamagedError, match=r"params/\w+ has changed|cannot be read"):
        read_all(folder)
