"""What importing shares: how a file's demonstrations are split, and what is said of them."""

import io

import h5py
import pytest
from rich.console import Console
from robomimic_files import EPISODES, imported, of_many, recorded, write

from jaxcam.config.train import TrainConfig
from jaxcam.errors import DatasetError
from jaxcam.interop.importing import Masks, held_back
from jaxcam.pipeline import like_its_dataset, training_data
from jaxcam.runs.identity import resolve

MASKS = {
    "train": [0, 1, 2, 3, 4, 5, 6, 7],
    "valid": [8, 9],
    "6_demos": [0, 1, 2, 3, 4, 5],
    "6_demos_train": [1, 2, 3, 4, 5],
    "6_demos_valid": [0],
    "better": [0, 1, 8],
    "early": [0, 1, 2],
}


@pytest.mark.parametrize(
    ("count", "masks", "settings", "train", "valid"),
    [
        (12, MASKS, {}, range(8), [8, 9]),
        (12, MASKS, {"filter_key": "train"}, range(8), [8, 9]),
        (12, MASKS, {"filter_key": "6_demos"}, [1, 2, 3, 4, 5], [0]),
        (12, MASKS, {"filter_key": "6_demos_train"}, [1, 2, 3, 4, 5], [0]),
        (12, MASKS, {"filter_key": "better"}, [0, 1], [8]),
        (12, MASKS, {"filter_key": "early"}, [0, 1], [2]),
        (12, MASKS, {"validation": 1}, range(11), [11]),
        (12, MASKS, {"validation": 0}, range(12), []),
        (12, {"train": [0, 1, 2]}, {}, [0, 1], [2]),
        (12, {"train": [0, 1, 2]}, {"filter_key": "train"}, [0, 1], [2]),
        (12, {"valid": [0]}, {}, range(1, 12), [0]),
        (21, {}, {}, range(19), [19, 20]),
        (9, {}, {}, range(8), [8]),
        (2, {}, {}, [0], [1]),
        (1, {}, {}, [0], []),
    ],
)
def test_splits_are_the_files(tmp_path, count, masks, settings, train, valid):
    path = of_many(tmp_path / "many.hdf5", count, masks)
    everything = [f"demo_{i}" for i in range(count)]
    with h5py.File(path) as file:
        lists = Masks.of(path, file, everything)
        halves = lists.split(settings.get("filter_key"), settings.get("validation"))
    assert halves == ([f"demo_{i}" for i in train], [f"demo_{i}" for i in valid])


@pytest.mark.parametrize(
    ("masks", "settings", "message"),
    [
        ({"train": [0, 1], "valid": [1]}, {}, "demo_1 is in mask/train and in mask/valid"),
        ({"train": [0, 7]}, {}, "mask/train lists 'demo_7', which the file does not have"),
        ({"valid": [0, 1]}, {}, "none is left to train on"),
        ({"valid": [1]}, {"filter_key": "valid"}, "none is left to train on"),
    ],
)
def test_splits_that_cannot_be_meant_are_refused(tmp_path, masks, settings, message):
    path = of_many(tmp_path / "few.hdf5", 2, masks)
    with pytest.raises(DatasetError, match=message):
        imported(path, **settings)


@pytest.mark.parametrize(
    ("count", "held"), [(0, 0), (1, 0), (2, 1), (9, 1), (10, 1), (19, 1), (20, 2), (200, 20)]
)
def test_every_tenth_is_held_back_and_one_at_least(count, held):
    assert held_back(count) == held


def test_masks_choose_demonstrations(tmp_path):
    names = ["demo_0", "demo_1"]
    mask = {"valid": names[:1], "train": names[1:], "better": names, "one": names[1:]}
    path = write(tmp_path / "mask.hdf5", recorded("1.5"), mask=mask)
    lengths = [len(recorded("1.5")[f"states_{i}"]) - 1 for i in range(EPISODES)]
    for settings, train_lengths, valid_lengths in (
        ({}, lengths[1:], lengths[:1]),
        ({"filter_key": "better", "validation": 0}, lengths, []),
        ({"filter_key": "one"}, lengths[1:], []),
    ):
        demos = imported(path, **settings)
        assert [d.length for d in demos.train] == train_lengths
        assert [d.length for d in demos.valid] == valid_lengths
    with pytest.raises(DatasetError, match="no filter key 'beter', did you mean 'better'"):
        imported(path, filter_key="beter")
    with pytest.raises(DatasetError, match="none is left to train on"):
        imported(path, validation=2)


class DrawnError(Exception):
    """Raised where pictures would be drawn."""


@pytest.mark.parametrize("validation", [0, 1])
def test_training_without_validation_says_so(tmp_path, monkeypatch, validation):
    def stop(*_):
        raise DrawnError

    monkeypatch.setattr("jaxcam.pipeline.load_pictures", stop)
    path = imported(of_many(tmp_path / "few.hdf5", 2, {}), validation=validation).path
    config = like_its_dataset(TrainConfig(dataset=str(path), resolution=16))
    console = Console(file=io.StringIO(), width=300)
    with pytest.raises(DrawnError):
        training_data([resolve(config, accelerator=False)], console)
    said = console.file.getvalue()
    assert (f"{path}: No validation demonstrations" in said) == (validation == 0)
