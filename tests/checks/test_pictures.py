"""Pictures beside a dataset that do not show what its states and cameras say."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from conftest import PIXELS

from jaxcam.checks.pictures import check_caches
from jaxcam.data.samples import Layout


@pytest.fixture
def cached(demos, pictures, tmp_path):
    """The dataset and its pictures in a folder of their own, and those pictures to be changed."""
    path = tmp_path / demos.path.name
    shutil.copy(demos.path, path)
    (folder := tmp_path / "frames").mkdir()
    (source,) = (demos.path.parent / "frames").glob(f"*-{PIXELS}px-*.npy")
    shutil.copy(source, folder)
    cache = folder / source.name
    return replace(demos, path=path), cache, np.lib.format.open_memmap(cache, "r+")


@pytest.fixture
def pictures_of(lift, scene, renderer, monkeypatch):
    """Findings on a dataset's pictures; the session's renderer draws."""
    monkeypatch.setattr("jaxcam.checks.pictures.make_painter", lambda *args, **kwargs: renderer)
    return lambda demos: list(check_caches(demos, lift, scene, 3))


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda x: x[..., ::-1], "BGR"),
        (lambda x: x[:, ::-1], "bottom row is first"),
        (lambda x: x[:, :, ::-1], "left and right"),
        (lambda x: x[:, ::-1, ::-1], "upside down"),
        (lambda x: np.rot90(x, 1, (1, 2)), "by 90"),
        (lambda x: np.roll(x, 40, 0), "Delete"),
    ],
)
def test_pictures_that_show_something_else(cached, pictures_of, change, cause):
    demos, _, pictures = cached
    assert [f.mark for f in pictures_of(demos)] == ["good", "good"]
    pictures[...] = change(pictures[...].copy())
    pictures.flush()
    black, finding = pictures_of(demos)
    assert (black.mark, finding.mark) == ("good", "bad"), finding
    assert cause in finding.fix


def test_black_and_frozen_pictures(cached, pictures_of):
    demos, cache, pictures = cached
    _, second, third = Layout.of(demos).first[:3]
    pictures[0] = 0
    pictures[second:third] = pictures[second]
    pictures.flush()
    finding, _ = pictures_of(demos)
    assert finding.mark == "bad"
    assert "picture 0" in finding.where
    assert "demo_1" in finding.where
    assert str(cache) in finding.fix


def test_pictures_of_other_content_are_told_and_not_used(cached, pictures_of):
    demos, cache, _ = cached
    other = cache.with_name(cache.name.replace(demos.fingerprint, "0" * 16))
    cache.rename(other)
    (finding,) = pictures_of(demos)
    assert (finding.mark, finding.where) == ("note", other.name)


def test_of_pictures_drawn_in_part_those_that_are_drawn_are_compared(cached, pictures_of):
    demos, cache, pictures = cached
    part, flags = cache.with_suffix(".part"), cache.with_suffix(".drawn")
    cache.rename(part)
    (finding,) = pictures_of(demos)
    assert (finding.mark, finding.got, finding.where) == ("note", "none drawn yet", part.name)
    drawn = np.arange(len(pictures)) % 3 == 0
    drawn.tofile(flags)
    pictures[~drawn] = 0
    pictures.flush()
    looked, same = pictures_of(demos)
    assert (looked.mark, same.mark) == ("good", "good")
    assert f"{drawn.sum()} of {len(drawn)} pictures are drawn" in looked.got
    pictures[:] = pictures[..., ::-1]
    pictures.flush()
    _, swapped = pictures_of(demos)
    assert swapped.mark == "bad"
    assert "BGR" in swapped.fix


def test_pictures_that_are_not_what_was_drawn(cached, pictures_of, demos, pictures):
    here, cache, rgb = cached
    whole, _ = pictures_of(here)
    assert "they get checksums when they are used" in whole.got
    (sums,) = (demos.path.parent / "frames").glob(f"*-{PIXELS}px-*.sums")
    shutil.copy(sums, cache.with_suffix(".sums"))
    whole, _ = pictures_of(here)
    assert (whole.mark, "all are what was drawn" in whole.got) == ("good", True)
    rgb[7, 3, 4, 1] ^= 1
    rgb.flush()
    damaged, _ = pictures_of(here)
    assert damaged.mark == "bad"
    assert f"1 of {len(rgb)} are not what was drawn" in damaged.got
    assert damaged.where == f"{cache.name}: demo_0"
    assert cache.with_suffix(".sums").read_bytes() == sums.read_bytes()
