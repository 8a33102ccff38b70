"""What paths lead to."""

import json

import numpy as np
import pytest

from jaxcam.config.commands import ViewConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.viewer.exhibit import Exhibit
from jaxcam.viewer.sources import open_viewed

POSE = np.eye(4)
VIEW = {"K": {"fx": 60, "fy": 60, "cx": 32, "cy": 24}, "size": [64, 48]}


def cameras(path, x):
    pose = POSE.copy()
    pose[0, 3] = x
    view = {**VIEW, "base_from_camera": pose.tolist()}
    path.write_text(json.dumps({"format": 1, "views": {"front": view}}))
    return str(path)


def test_a_dataset_has_an_episode_for_each_demonstration(demos):
    shown = open_viewed(ViewConfig((str(demos.path),)))
    assert list(shown.episodes) == list(range(len(demos.episodes)))
    assert shown.episodes[0].startswith("training")
    assert shown.episodes[len(demos.train)].startswith("validation")


def test_two_calibrations_lie_over_each_other_and_are_compared(tmp_path):
    config = ViewConfig((cameras(tmp_path / "a.json", 0.5), cameras(tmp_path / "b.json", 0.51)))
    exhibit = open_viewed(config).exhibit(0)
    assert [v.name for v in exhibit.viewpoints] == ["a.json: front", "b.json: front"]
    assert exhibit.notes[0] == "front: 10.0 mm and 0.00 degrees apart."


def test_two_files_of_one_name_are_told_apart(tmp_path):
    (tmp_path / "old").mkdir()
    config = ViewConfig((cameras(tmp_path / "c.json", 0), cameras(tmp_path / "old/c.json", 1)))
    names = [v.name for v in open_viewed(config).exhibit(0).viewpoints]
    assert names == ["c.json (first): front", "c.json (second): front"]


def test_a_file_of_cameras_goes_with_each_demonstration(demos, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "jaxcam.viewer.sources.demonstration",
        lambda demos, number: Exhibit("made", str(number)),
    )
    config = ViewConfig((cameras(tmp_path / "c.json", 0), str(demos.path)))
    shown = open_viewed(config)
    assert list(shown.episodes) == list(range(len(demos.episodes)))
    assert shown.exhibit(3).subtitle.endswith("3")


def test_what_is_not_there_or_nothing_is_told(tmp_path):
    with pytest.raises(DatasetError, match="no dataset, no run"):
        open_viewed(ViewConfig((str(tmp_path / "none"),)))
    (tmp_path / "folder").mkdir()
    with pytest.raises(ConfigError, match="not a run folder"):
        open_viewed(ViewConfig((str(tmp_path / "folder"),)))
    (tmp_path / "text.hdf5").write_text("nothing")
    with pytest.raises(DatasetError):
        open_viewed(ViewConfig((str(tmp_path / "text.hdf5"),)))


def test_one_or_two_can_be_looked_at():
    for targets in ((), ("a", "b", "c")):
        with pytest.raises(ConfigError, match="targets are given"):
            ViewConfig(targets)
    with pytest.raises(ConfigError, match="--port"):
        ViewConfig(("a",), save="x.html", port=1)
