"""A recorded dataset in whatever layout it comes."""

import json

import pytest

from jaxcam.errors import DatasetError
from jaxcam.interop.recordings import read_recording


def test_a_lerobot_folder_is_read_with_its_calibrations(tmp_path):
    pytest.importorskip("pyarrow")
    from lerobot_datasets import write_folder  # needs pyarrow

    written = write_folder(tmp_path / "cups")
    recording = read_recording(tmp_path / "cups")
    assert len(recording.episodes) == len(written.states)
    assert all(s.calibration is None for e in recording.episodes for s in e.sights.values())


@pytest.mark.parametrize(
    ("noted", "expected"),
    [("eef_abs", "eef_abs"), ("eef_delta_componentwise", "unknown"), (3, "unknown")],
)
def test_a_folder_may_say_what_its_actions_are(tmp_path, noted, expected):
    pytest.importorskip("pyarrow")
    from lerobot_datasets import write_folder  # needs pyarrow

    write_folder(tmp_path / "cups")
    notes = {"action_space": noted, "conventions": {}}
    (tmp_path / "cups" / "meta/jaxcam.json").write_text(json.dumps(notes))
    assert read_recording(tmp_path / "cups").action_is == expected


@pytest.mark.parametrize("content", [(), ("meta/other.json",), ("data.hdf5",)])
def test_a_folder_that_is_none_is_refused(tmp_path, content):
    for name in content:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("{}")
    with pytest.raises(DatasetError, match="no recorded dataset: it has neither"):
        read_recording(tmp_path)
