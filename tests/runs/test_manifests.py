"""What a checkpoint says of itself: read as it was written, or not at all."""

import json

import pytest

from jaxcam.runs.manifests import DamagedError, read_manifest, seal, sides, steps_in, without_seal

SIDE = {"seed": 3, "config": {}, "settings": {}, "spec": {}, "stats": {}, "data": "abc",
        "convention": 1, "packages": {"jax": "0.10.2"}}  # fmt: skip


def written(run, step, **changes):
    """The folder of a checkpoint that has a manifest alone."""
    content = {"step": step, "side": SIDE, "leaves": {"w": ["float32", [2, 3], "ff"]}}
    folder = run / "checkpoints" / str(step)
    (folder / "manifest").mkdir(parents=True)
    (folder / "manifest" / "metadata").write_text(json.dumps(seal(content) | changes))
    return folder


def test_a_manifest_is_read_as_it_was_written(tmp_path):
    manifest = read_manifest(written(tmp_path, 7))
    assert manifest["side"] == SIDE
    assert seal(without_seal(manifest)) == manifest
    assert "sha256" not in without_seal(manifest)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"side": SIDE | {"seed": 4}}, "has changed since it was written"),
        ({"sha256": "0" * 64}, "has changed since it was written"),
        ({"side": []}, "cannot be read"),
        ({"leaves": {"w": ["float32", [-1], "ff"]}}, "cannot be read .*w is described as"),
    ],
)
def test_a_manifest_that_is_another_is_refused(tmp_path, changes, message):
    with pytest.raises(DamagedError, match=message):
        read_manifest(written(tmp_path, 7, **changes))


def test_a_manifest_of_another_step_is_refused(tmp_path):
    folder = written(tmp_path, 7)
    with pytest.raises(DamagedError, match="of step 7"):
        read_manifest(folder.rename(folder.with_name("8")))


def test_steps_are_numbers_in_order_and_damaged_ones_have_no_side(tmp_path):
    for step in (100, 20, 3):
        written(tmp_path, step)
    written(tmp_path, 5, sha256="")
    for name in ("07", "²", "tmp"):
        (tmp_path / "checkpoints" / name).mkdir()
    assert steps_in(tmp_path / "checkpoints") == [3, 5, 20, 100]
    assert list(sides(tmp_path)) == [3, 20, 100]
    assert sides(tmp_path / "nowhere") == {}
