"""The frame cache: made once, resumed, and the picture at an index is the one it names."""

import shutil
from collections import namedtuple

import numpy as np
import pytest
from conftest import PIXELS

from jaxcam.data import pictures as frames_module
from jaxcam.data.pictures import intrinsics, load_frames
from jaxcam.errors import DatasetError
from jaxcam.rays import Camera
from jaxcam.sim.mujoco.render import Renderer
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
    return sorted(p.name for p in folder.iterdir() if p.suffix != ".lock")


def test_cached_pictures_are_fresh_renders_of_state_and_camera(demos, frames, renderer):
    every = demos.train + demos.valid
    assert len(frames.pictures) == sum(d.length * len(d.cameras) for d in every)
    rng = np.random.default_rng(0)
    seen = set()
    for i, demo in enumerate(every):
        t, c = int(rng.integers(demo.length)), int(rng.integers(len(demo.cameras)))
        for t_, c_ in {(t, c), (0, 0), (demo.length - 1, len(demo.cameras) - 1)}:
            view = View(
                demo.qpos(demos.header.nq)[[t_]],
                demo.geom_size[None],
                demo.fixtures[None],
                intrinsics(45, PIXELS)[None],
                demos.header.world_from_camera[demo.cameras[c_]][None],
            )
            row = frames.layout.at(np.array(i), np.array(t_), np.array(c_))
            np.testing.assert_array_equal(frames.pictures[row], renderer.rgb(view)[0])
            seen.add(int(row))
    assert {0, len(frames.pictures) - 1} <= seen


def test_every_frame_has_one_place(demos, frames):
    rows = [
        frames.layout.at(np.array(i), np.array(t), np.array(c))
        for i, d in enumerate(demos.train + demos.valid)
        for t in range(d.length)
        for c in range(len(d.cameras))
    ]
    assert [int(r) for r in rows] == list(range(len(frames.pictures)))


def test_a_second_load_renders_nothing(demos, frames, monkeypatch):
    monkeypatch.setattr(frames_module, "_draw", None)
    again = load_frames(demos, PIXELS)
    np.testing.assert_array_equal(again.pictures, frames.pictures)
    assert not again.pictures.flags.writeable


def test_an_interrupted_rendering_ends_as_an_uninterrupted_one(elsewhere, frames, monkeypatch):
    draw, rendered = frames_module._draw, []

    def dying(*args):
        for pictures in draw(*args):
            rendered.append(len(pictures))
            if len(rendered) == 3:
                raise KeyboardInterrupt
            yield pictures

    monkeypatch.setattr(frames_module, "_draw", dying)
    with pytest.raises(KeyboardInterrupt):
        load_frames(elsewhere, PIXELS)
    assert not any(name.endswith(".npy") for name in pictures_in(elsewhere))
    resumed = load_frames(elsewhere, PIXELS)
    np.testing.assert_array_equal(resumed.pictures, frames.pictures)
    assert len(rendered) == 3 + 4  # two were kept, the third is rendered again
    assert [name.rsplit(".", 1)[1] for name in pictures_in(elsewhere)] == ["npy"]


def test_one_process_a_core_renders_the_same(elsewhere, frames, monkeypatch):
    monkeypatch.setattr(frames_module, "GROUPS_PER_WORKER", 1)
    monkeypatch.setattr(frames_module.os, "cpu_count", lambda: 2)
    np.testing.assert_array_equal(load_frames(elsewhere, PIXELS).pictures, frames.pictures)


def test_only_what_is_wanted_is_drawn(elsewhere, frames, monkeypatch):
    draw, drawn = frames_module._draw, []

    def counting(*args):
        for pictures in draw(*args):
            drawn.append(len(pictures))
            yield pictures

    monkeypatch.setattr(frames_module, "_draw", counting)
    wanted = np.random.default_rng(0).random(frames.layout.total) < 0.2
    some = load_frames(elsewhere, PIXELS, wanted=wanted)
    np.testing.assert_array_equal(some.pictures[wanted], frames.pictures[wanted])
    assert not some.pictures[~wanted].any()
    assert sum(drawn) == wanted.sum()
    load_frames(elsewhere, PIXELS, wanted=wanted)
    assert sum(drawn) == wanted.sum()
    wanted[[0, -1]] = True
    more = load_frames(elsewhere, PIXELS, wanted=wanted)
    np.testing.assert_array_equal(more.pictures[wanted], frames.pictures[wanted])
    assert sum(drawn) == wanted.sum()
    assert not any(name.endswith(".npy") for name in pictures_in(elsewhere))
    every = load_frames(elsewhere, PIXELS)
    np.testing.assert_array_equal(every.pictures, frames.pictures)
    assert sum(drawn) == frames.layout.total
    assert [name.rsplit(".", 1)[1] for name in pictures_in(elsewhere)] == ["npy"]
    np.testing.assert_array_equal(some.pictures, frames.pictures)  # the same file, still open


def test_no_room_on_the_disk(elsewhere, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 1000))
    for _ in range(2):  # a failed attempt is not taken for room
        with pytest.raises(
            DatasetError, match=r"pictures need .* GB.*--data-dir or a smaller --res"
        ):
            load_frames(elsewhere, PIXELS)
    assert pictures_in(elsewhere) == []


def test_a_disk_that_fills_up_keeps_what_is_done(elsewhere, frames, monkeypatch):
    write = frames_module._Part.write

    def full(self, rows, pictures):
        if self.drawn[: rows[0]].all() and rows[0] > len(self.drawn) // 2:
            monkeypatch.setattr(self, "part", self.part.with_name("none") / "full")
        write(self, rows, pictures)

    with monkeypatch.context() as patch:
        patch.setattr(frames_module._Part, "write", full)
        with pytest.raises(DatasetError, match="What is rendered is kept"):
            load_frames(elsewhere, PIXELS)
    np.testing.assert_array_equal(load_frames(elsewhere, PIXELS).pictures, frames.pictures)


def test_other_pictures_have_another_cache(demos, frames):
    before = set(pictures_in(demos))
    small = load_frames(demos, 16)
    assert small.pictures.shape[1:] == (16, 16, 3)
    (name,) = set(pictures_in(demos)) - before
    for part in (demos.fingerprint, "-16px-", Renderer.look()):
        assert part in name


def test_intrinsics_are_of_the_whole_picture():
    camera = Camera(intrinsics(45, 84), np.eye(4), 84, 84).validate()
    np.testing.assert_allclose(np.rad2deg(camera.fovy), 45, rtol=1e-6)
    np.testing.assert_allclose(intrinsics(45, 84)[:2, 2], 42)
