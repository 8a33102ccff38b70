"""A LeRobot checkpoint whose files were damaged, or written by others: refused or read."""

import json
import shutil

import pytest
from lerobot_policies import inputs_of, settings_for
from odd_files import flipped, odd_texts

from jaxcam.errors import CheckpointError, JaxcamError
from jaxcam.interop.lerobot import policy
from jaxcam.interop.lerobot.pipelines import AFTER, BEFORE
from jaxcam.models.weights.load import read_weights


@pytest.fixture(scope="module", params=["act", "diffusion"])
def checkpoint(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lerobot") / request.param
    policy.export_policy(inputs_of(settings_for(request.param)), folder)
    (folder / "model.safetensors").unlink()  # large, and read last
    return folder


FILES = ["config.json", f"{BEFORE}.json", f"{AFTER}.json", "jaxcam.json"]


class ReadError(Exception):
    """All has been read but the weights."""


def stop(path):
    raise ReadError


@pytest.mark.parametrize("file", FILES)
def test_odd_values_and_flipped_bits_are_read_or_refused(checkpoint, file, tmp_path, monkeypatch):
    folder = shutil.copytree(checkpoint, tmp_path / "out")
    monkeypatch.setattr(policy, "read_weights", stop)
    content, refused = (folder / file).read_bytes(), 0
    texts = [t.encode("utf-8", "surrogatepass") for t in odd_texts([json.loads(content)])]
    for damaged in [*texts, *flipped(content)]:
        (folder / file).write_bytes(damaged)
        try:
            policy.read_foreign(folder)
        except ReadError:
            continue
        except JaxcamError as error:
            refused += 1
            str(error).encode("utf-8", "surrogatepass")
    assert refused > 20 or file == "jaxcam.json"


def test_flipped_bits_of_statistics_are_read_or_refused(checkpoint):
    """Of the header: those of numbers change numbers, and nothing says what these were."""
    file = checkpoint / f"{BEFORE}_step_3_normalizer_processor.safetensors"
    content = file.read_bytes()
    header = int.from_bytes(content[:8], "little") + 8
    refused = 0
    for damaged in flipped(content[:header]):
        file.write_bytes(damaged + content[header:])
        try:
            read_weights(file)
        except CheckpointError as error:
            refused += 1
            str(error).encode("utf-8", "surrogatepass")
    assert refused > 20
