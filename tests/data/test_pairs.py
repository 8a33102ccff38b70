"""Pairs of initial state and camera pose follow from their number, and are compared."""

from dataclasses import replace

import numpy as np
import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.data.pairs import cameras_seen, make_pairs, store_pairs
from jaxcam.data.splits import SPLITS
from jaxcam.errors import DatasetError
from jaxcam.runs.identity import resolve


def test_pairs_follow_from_their_number_and_are_recognised(lift, scene, scenes):
    some = make_pairs(lift, scene, 1, "test", [0, 1, 2])
    again = make_pairs(lift, scene, 1, "test", [2, 0])
    assert again.digests() == [some.digests()[2], some.digests()[0]]
    assert len(set(some.digests())) == 3
    assert make_pairs(lift, scene, 1, "validation", [0]).digests()[0] not in some.digests()
    assert make_pairs(lift, scenes["fixed"], 1, "test", [0]).digests()[0] not in some.digests()
    both = make_pairs(lift, scene, 2, "test", [1])  # pair p of two views has cameras 2p and 2p + 1
    assert np.array_equal(both.cameras[0, 0], some.cameras[2, 0])
    moved = some._replace(start=some.start._replace(qpos=some.start.qpos + 2e-6))
    assert not set(moved.digests()) & set(some.digests())


def test_pairs_of_train_are_new_starts_on_cameras_of_the_demonstrations(lift, scene, demos):
    config = TrainConfig(
        n=2, m=1, demos=demos.header.train, dataset=str(demos.path), preset="laptop"
    )
    known = cameras_seen(resolve(config, accelerator=False), demos.fingerprint)
    held_out = demos.header.valid
    np.testing.assert_array_equal(known, demos.header.world_from_camera[:-held_out])
    n, m = demos.header.n, demos.header.m
    drawn = replace(config, dataset="", n=n, m=m)  # without the file: they follow from the numbers
    np.testing.assert_allclose(cameras_seen(resolve(drawn, accelerator=False)), known, atol=1e-9)
    pairs = make_pairs(lift, scene, 1, "train", [0, 1, len(known)], known)
    np.testing.assert_array_equal(pairs.cameras[:, 0], known[[0, 1, 0]])
    taken = {demo.seed for demo in demos.episodes}
    assert not taken & set(pairs.seeds)
    for seeds in SPLITS.values():  # nobody evaluates on a million pairs
        assert not set(pairs.seeds) & set(range(seeds.episodes, seeds.episodes + 1_000_000))
    with pytest.raises(DatasetError, match="is not what the run was trained on"):
        cameras_seen(resolve(config, accelerator=False), "0123")


def test_stored_pairs_are_compared_and_grow(lift, scene, tmp_path):
    file = tmp_path / "pairs-test.json"
    some = make_pairs(lift, scene, 1, "test", [0, 1, 2])
    store_pairs(file, make_pairs(lift, scene, 1, "test", [0]))
    store_pairs(file, some)
    before = file.read_text()
    assert before.count('"sha"') == 3
    store_pairs(file, make_pairs(lift, scene, 1, "test", [0, 1]))
    assert file.read_text() == before
    cameras = some.cameras.copy()
    cameras[1, 0, 0, 3] += 0.01
    with pytest.raises(DatasetError, match="pair 1 was"):
        store_pairs(file, some._replace(cameras=cameras))
