"""The cache of pictures: made once, resumed, and the picture at an index is the one it names."""

import logging
import os
import shutil
from collections import namedtuple

import numpy as np
import pytest
from conftest import PIXELS

from jaxcam.data import pictures as pictures_module
from jaxcam.data.caches import Cache
from jaxcam.data.pictures import load_pictures
from jaxcam.errors import DatasetError, SimError
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import painter_of
from jaxcam.sim.types import View

Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def elsewhere(demos, tmp_path):
    """The same demonstrations in another folder, without pictures."""
    path = tmp_path / demos.path.name
    shutil.copy(demos.path, path)
    return type(demos)(**{**demos.__dict__, "path": path})


def pictures_in(demos):
    folder = demos.path.parent / "frames"
    return sorted(p.name for p in folder.iterdir() if p.suffix not in (".lock", ".sums"))


@pytest.fixture
def cached(elsewhere, demos, pictures):
    """The demonstrations in another folder with their pictures: dataset, cache, writable array."""
    (folder := elsewhere.path.parent / "frames").mkdir()
    for source in (demos.path.parent / "frames").glob(f"*-{PIXELS}px-*"):
        if source.suffix in (".npy", ".sums"):
            shutil.copy(source, folder)
    (cache,) = folder.glob("*.npy")
    return elsewhere, cache, np.lib.format.open_memmap(cache, "r+")


@pytest.fixture
def drawn(monkeypatch):
    """Numbers of pictures that are drawn, group by group."""
    draw, counts = pictures_module.draw_views, []

    def counting(*args):
        for pictures in draw(*args):
            counts.append(len(pictures))
            yield pictures

    monkeypatch.setattr(pictures_module, "draw_views", counting)
    return counts


def flip_a_bit(rgb):
    rgb[7, 3, 4, 1] ^= 1


def blacken(rgb):
    rgb[3:6] = 0


def shifted(rgb):
    rgb[20:30] = rgb[19:29].copy()


DAMAGES = {"a bit": (flip_a_bit, 1), "black": (blacken, 3), "shifted": (shifted, None)}


@pytest.mark.parametrize("kind", ["complete", "in part"])
@pytest.mark.parametrize("case", DAMAGES)
def test_pictures_that_are_not_what_was_drawn_are_drawn_again_and_told(
    cached, pictures, drawn, caplog, case, kind
):
    demos, cache, rgb = cached
    damage, count = DAMAGES[case]
    total = len(rgb)
    damage(rgb)
    rgb.flush()
    if kind == "in part":
        cache.rename(cache.with_suffix(".part"))
        np.ones(total, bool).tofile(cache.with_suffix(".drawn"))
    np.testing.assert_array_equal(load_pictures(demos, PIXELS).rgb, pictures.rgb)
    assert sum(drawn) == (count or sum(drawn))
    assert 0 < sum(drawn) <= 10
    assert f"{sum(drawn)} of {total} pictures are not what was drawn" in caplog.text
    caplog.clear()
    np.testing.assert_array_equal(load_pictures(demos, PIXELS).rgb, pictures.rgb)
    assert not caplog.records
    assert cache.exists()


def test_only_damage_to_what_is_looked_at_is_mended(cached, drawn):
    demos, _, rgb = cached
    flip_a_bit(rgb)
    rgb.flush()
    wanted = np.ones(len(rgb), bool)
    wanted[7] = False
    load_pictures(demos, PIXELS, wanted=wanted)
    assert drawn == []
    load_pictures(demos, PIXELS, wanted=~wanted)
    assert drawn == [1]


def test_checksums_that_are_damaged_have_pictures_drawn_again(cached, pictures, drawn):
    demos, cache, _ = cached
    sums = cache.with_suffix(".sums")
    content = sums.read_bytes()
    sums.write_bytes(content[:-8])
    np.testing.assert_array_equal(load_pictures(demos, PIXELS).rgb, pictures.rgb)
    assert drawn == [2]
    assert sums.read_bytes() == content


@pytest.mark.parametrize("kind", ["complete", "in part"])
def test_a_cache_of_0_1_gets_its_checksums_once(cached, pictures, drawn, caplog, kind):
    demos, cache, rgb = cached
    sums = cache.with_suffix(".sums")
    made = sums.read_bytes()
    sums.unlink()
    if kind == "in part":
        cache.rename(cache.with_suffix(".part"))
        np.ones(len(rgb), bool).tofile(cache.with_suffix(".drawn"))
    with caplog.at_level(logging.DEBUG):
        load_pictures(demos, PIXELS)
        assert f"made the checksums of {len(rgb)} pictures" in caplog.text
        assert sums.read_bytes() == made
        caplog.clear()
        load_pictures(demos, PIXELS)
        assert "made the checksums" not in caplog.text
    assert drawn == []


def test_a_note_that_says_drawn_over_black_pictures_is_not_believed(
    cached, pictures, drawn, caplog
):
    """As 0.1.0 left it after a crash of the machine: no checksums, and a hole in the file."""
    demos, cache, rgb = cached
    cache.with_suffix(".sums").unlink()
    rgb[10:] = 0
    rgb.flush()
    cache.rename(cache.with_suffix(".part"))
    np.ones(len(rgb), bool).tofile(cache.with_suffix(".drawn"))
    np.testing.assert_array_equal(load_pictures(demos, PIXELS).rgb, pictures.rgb)
    assert sum(drawn) == len(rgb) - 10
    assert "are not what was drawn" in caplog.text


def test_a_note_that_says_drawn_over_an_empty_file_is_not_believed(cached, pictures, caplog):
    demos, cache, rgb = cached
    cache.unlink()
    cache.with_suffix(".part").write_bytes(b"")
    np.ones(len(rgb), bool).tofile(cache.with_suffix(".drawn"))
    np.testing.assert_array_equal(load_pictures(demos, PIXELS).rgb, pictures.rgb)
    assert "0 bytes that cannot be read" in caplog.text


@pytest.mark.parametrize("ending", [".sums", ".drawn"])
def test_giants_and_pipes_for_records_of_a_cache(tmp_path, ending):
    path, shape = tmp_path / "a.npy", (4, 2, 2, 3)
    np.lib.format.open_memmap(path.with_suffix(".part"), "w+", np.uint8, shape)
    record = path.with_suffix(ending)
    with open(record, "wb") as file:
        file.truncate(1 << 40)
    assert not Cache(path, shape).drawn.any()
    record.unlink()
    os.mkfifo(record)
    with pytest.raises(OSError, match="regular"):
        Cache(path, shape)
    record.unlink()
    path.with_suffix(".part").unlink()
    os.mkfifo(path.with_suffix(".part"))
    assert Cache(path, shape).rgb is None


def test_cached_pictures_are_fresh_renders_of_state_and_camera(demos, pictures, renderer):
    episodes = demos.episodes
    assert len(pictures.rgb) == sum(d.length * len(d.cameras) for d in episodes)
    rng = np.random.default_rng(0)
    compared = set()
    for i, demo in enumerate(episodes):
        t, c = int(rng.integers(demo.length)), int(rng.integers(len(demo.cameras)))
        for t_, c_ in {(t, c), (0, 0), (demo.length - 1, len(demo.cameras) - 1)}:
            view = View(
                demo.qpos[[t_]],
                demo.geom_size[None],
                demo.fixtures[None],
                intrinsics(45, PIXELS)[None],
                demos.header.world_from_camera[demo.cameras[c_]][None],
            )
            row = pictures.layout.at(np.array(i), np.array(t_), np.array(c_))
            np.testing.assert_array_equal(pictures.rgb[row], renderer.rgb(view)[0])
            compared.add(int(row))
    assert {0, len(pictures.rgb) - 1} <= compared


def test_every_picture_has_one_place(demos, pictures):
    rows = [
        pictures.layout.at(np.array(i), np.array(t), np.array(c))
        for i, d in enumerate(demos.episodes)
        for t in range(d.length)
        for c in range(len(d.cameras))
    ]
    assert [int(r) for r in rows] == list(range(len(pictures.rgb)))


def test_a_second_load_renders_nothing(demos, pictures, monkeypatch):
    monkeypatch.setattr(pictures_module, "draw_views", None)
    again = load_pictures(demos, PIXELS)
    np.testing.assert_array_equal(again.rgb, pictures.rgb)
    assert not again.rgb.flags.writeable


def test_an_interrupted_rendering_ends_as_an_uninterrupted_one(elsewhere, pictures, monkeypatch):
    draw, rendered = pictures_module.draw_views, []

    def dying(*args):
        for pictures in draw(*args):
            rendered.append(len(pictures))
            if len(rendered) == 3:
                raise KeyboardInterrupt
            yield pictures

    monkeypatch.setattr(pictures_module, "draw_views", dying)
    with pytest.raises(KeyboardInterrupt):
        load_pictures(elsewhere, PIXELS)
    assert not any(name.endswith(".npy") for name in pictures_in(elsewhere))
    resumed = load_pictures(elsewhere, PIXELS)
    np.testing.assert_array_equal(resumed.rgb, pictures.rgb)
    assert len(rendered) == 3 + 4  # two were kept, the third is rendered again
    assert [name.rsplit(".", 1)[1] for name in pictures_in(elsewhere)] == ["npy"]


def test_one_process_a_core_renders_the_same(elsewhere, pictures, monkeypatch):
    monkeypatch.setattr(pictures_module, "GROUPS_PER_WORKER", 1)
    monkeypatch.setattr(pictures_module.os, "cpu_count", lambda: 2)
    np.testing.assert_array_equal(load_pictures(elsewhere, PIXELS).rgb, pictures.rgb)


def test_only_what_is_wanted_is_drawn(elsewhere, pictures, monkeypatch):
    draw, drawn = pictures_module.draw_views, []

    def counting(*args):
        for pictures in draw(*args):
            drawn.append(len(pictures))
            yield pictures

    monkeypatch.setattr(pictures_module, "draw_views", counting)
    wanted = np.random.default_rng(0).random(pictures.layout.total) < 0.2
    some = load_pictures(elsewhere, PIXELS, wanted=wanted)
    np.testing.assert_array_equal(some.rgb[wanted], pictures.rgb[wanted])
    assert not some.rgb[~wanted].any()
    assert sum(drawn) == wanted.sum()
    load_pictures(elsewhere, PIXELS, wanted=wanted)
    assert sum(drawn) == wanted.sum()
    wanted[[0, -1]] = True
    more = load_pictures(elsewhere, PIXELS, wanted=wanted)
    np.testing.assert_array_equal(more.rgb[wanted], pictures.rgb[wanted])
    assert sum(drawn) == wanted.sum()
    assert not any(name.endswith(".npy") for name in pictures_in(elsewhere))
    whole = load_pictures(elsewhere, PIXELS)
    np.testing.assert_array_equal(whole.rgb, pictures.rgb)
    assert sum(drawn) == pictures.layout.total
    assert [name.rsplit(".", 1)[1] for name in pictures_in(elsewhere)] == ["npy"]
    np.testing.assert_array_equal(some.rgb, pictures.rgb)  # the same file, still open


def test_no_room_on_the_disk(elsewhere, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 1000))
    for _ in range(2):  # a failed attempt is not taken for room
        with pytest.raises(
            DatasetError, match=r"pictures need .* GB.*--data-dir or a smaller --res"
        ):
            load_pictures(elsewhere, PIXELS)
    assert pictures_in(elsewhere) == []


def test_a_disk_that_fills_up_keeps_what_is_done(elsewhere, pictures, monkeypatch):
    write = Cache.write

    def full(self, rows, pictures):
        if self.drawn[: rows[0]].all() and rows[0] > len(self.drawn) // 2:
            monkeypatch.setattr(self, "file", self.file.with_name("none") / "full")
        write(self, rows, pictures)

    with monkeypatch.context() as patch:
        patch.setattr(Cache, "write", full)
        with pytest.raises(DatasetError, match="What is rendered is kept"):
            load_pictures(elsewhere, PIXELS)
    np.testing.assert_array_equal(load_pictures(elsewhere, PIXELS).rgb, pictures.rgb)


def test_other_pictures_have_another_cache(demos, pictures, scene):
    before = set(pictures_in(demos))
    small = load_pictures(demos, 16)
    assert small.rgb.shape[1:] == (16, 16, 3)
    (name,) = set(pictures_in(demos)) - before
    for part in (demos.fingerprint, "-16px-", painter_of(scene).look()):
        assert part in name


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c, x: c.write_bytes(c.read_bytes()[:5000]), "5000 bytes that cannot be read"),
        (lambda c, x: c.write_bytes(b""), "0 bytes that cannot be read"),
        (lambda c, x: np.save(c, x[:, :12]), r"should be uint8 .* but are uint8 .*12, 24, 3"),
        (lambda c, x: np.save(c, x[:-1]), "should be uint8"),
        (lambda c, x: np.save(c, x / np.float32(255)), "but are float32"),
    ],
)
def test_a_cache_that_is_not_what_was_written_is_refused(elsewhere, pictures, scene, change, words):
    (elsewhere.path.parent / "frames").mkdir()
    name = (
        f"{elsewhere.path.stem}-{elsewhere.fingerprint}-{PIXELS}px-{painter_of(scene).look()}.npy"
    )
    cache = elsewhere.path.parent / "frames" / name
    np.save(cache, pictures.rgb)
    change(cache, np.array(pictures.rgb))
    with pytest.raises(DatasetError, match=words) as error:
        load_pictures(elsewhere, PIXELS)
    assert f"{cache}: " in str(error.value)
    assert "Delete the file; they are drawn anew" in str(error.value)


@pytest.fixture
def black(monkeypatch, scene):
    """Makes all pictures of the next so many renderers black, whenever those draw."""

    def break_next(count):
        painter = painter_of(scene)
        draw, broken = painter.rgb, []

        def rgb(self, view):
            if self not in broken and len(broken) < count:
                broken.append(self)
            return draw(self, view) * (self not in broken)

        monkeypatch.setattr(painter, "rgb", rgb)

    return break_next


def test_black_pictures_are_drawn_by_another_renderer_once(elsewhere, pictures, black):
    black(1)
    np.testing.assert_array_equal(load_pictures(elsewhere, PIXELS).rgb, pictures.rgb)


def test_pictures_that_stay_black_are_refused(elsewhere, black):
    black(2)
    with pytest.raises(SimError, match="are black, and again with another renderer"):
        load_pictures(elsewhere, PIXELS)
    assert not [name for name in pictures_in(elsewhere) if name.endswith(".npy")]
