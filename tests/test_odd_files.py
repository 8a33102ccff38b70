"""Files that were damaged or written by others: what is read of them is refused or what was meant.

Every kind of file is damaged in 60 places, and gets 60 values that do not belong there. What has a
digest is then refused or unchanged; of the rest, nothing but an error that says what is wrong.
"""

import hashlib
import json
import random
import re
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml
from checked_run import CONFIG, make_run
from lerobot_folders import FEATURES, config_of, write_folder
from running import exit_code

from jaxcam.checks.run import check_run
from jaxcam.config.fields import to_json
from jaxcam.data.pairs import read_digests
from jaxcam.errors import JaxcamError
from jaxcam.interop.lerobot.policy import describe, read_about, read_checkpoint
from jaxcam.runs.grid import read_grid
from jaxcam.runs.identity import read_config
from jaxcam.runs.manifests import DamagedError, seal, steps_in
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import read_rows
from jaxcam.training.digests import read_all

COUNT = 60
ODD = [
    None, True, False, -1, 0, 1, 2, 1.5, -0.0, 2**31, 2**63, 10**400, float("inf"), float("nan"),
    "", "\0", "\ud800", "x" * 5000, "../../../x", "[/red]", "NaN", [], [[]], [None], [1, "a"], {},
    {"": {}}, {"a": 1}, [{}], "\x1b[2J",
]  # fmt: skip
"""Values of all kinds that JSON has."""
TEXTS = ["", "null", "[]", "7", '"a"', "{", "[" * 200_000, "{}", '{"a": 1}', "\ufeff{}", "NaN"]
"""Whole files."""


def metrics(folder):
    return folder / "metrics.jsonl", lambda: read_metrics(folder)


def rows(folder):
    return folder / "rows.jsonl", lambda: read_rows(folder / "rows.jsonl")


def config(folder):
    return folder / "config.json", lambda: read_config(folder)


def pairs(folder):
    return folder / "pairs-test.json", lambda: read_digests(folder / "pairs-test.json")


def grid(folder):
    return folder / "grid.yaml", lambda: read_grid(folder / "grid.yaml")


def lerobot(kind, file):
    """A file of a LeRobot checkpoint, whose other files are whole; no network is built."""

    def make(folder):
        pytest.importorskip("safetensors")
        write_folder(folder, kind)
        read = read_checkpoint if kind == "smolvla" else describe
        return folder / file, lambda: read(folder)

    return make


def lerobot_about(folder):
    return folder / "jaxcam.json", lambda: read_about(folder)


ROW = {"step": 2, "split": "test", "pair": 0, "success": True, "status": "ok", "width": 50}
METRIC = {"step": 1, "loss": 2.0, "skipped": 0.0, "seconds": 3.5}
RATE = {"step": 2, "success_rate": 0.5, "low": 0.1, "high": 0.9, "pairs": 2}
PAIR = {"episode_seed": 3, "cameras": [[[1.0]]], "sha": "00"}
WHOLE = hashlib.sha256(b"0000").hexdigest()
GRID = {
    "title": "a",
    "runs_dir": "runs",
    "protocol": "one",
    "settings": {"preset": "laptop", "seed": [0, 1], "model": ["width=64"]},
    "runs": [{"task": "lift", "conditioning": ["none", "late"]}],
    "slurm": {"timeout_min": 4},
}
SCALES = {"eps": 1e-8, "features": FEATURES["output_features"], "norm_map": {"ACTION": "MIN_MAX"}}
DEVICE = {"registry_name": "device_processor", "config": {"device": "cpu", "float_dtype": None}}
BEFORE = {
    "name": "policy_preprocessor",
    "steps": [
        {"registry_name": "rename_observations_processor", "config": {"rename_map": {}}},
        {"registry_name": "to_batch_processor", "config": {}},
        DEVICE,
        {"registry_name": "normalizer_processor", "config": SCALES | {"norm_map": {}}},
    ],
}
AFTER = {"steps": [{"registry_name": "unnormalizer_processor", "config": SCALES}, DEVICE]}
KINDS = {
    "config.json": (config, [json.loads(to_json(CONFIG))]),
    "metrics.jsonl": (metrics, [METRIC, RATE, METRIC]),
    "rows.jsonl": (rows, [ROW, ROW | {"pair": 1}]),
    "pairs-test.json": (pairs, [{"sha256": WHOLE, "pairs": [PAIR, PAIR]}]),
    "grid.yaml": (grid, [GRID]),
    "act/config.json": (lerobot("act", "config.json"), [config_of("act")]),
    "diffusion/config.json": (lerobot("diffusion", "config.json"), [config_of("diffusion")]),
    "smolvla/config.json": (lerobot("smolvla", "config.json"), [config_of("smolvla")]),
    "before": (lerobot("act", "policy_preprocessor.json"), [BEFORE]),
    "after": (lerobot("diffusion", "policy_postprocessor.json"), [AFTER]),
    "jaxcam.json": (lerobot_about, [{"action_space": "eef_abs", "rotations": "nominal"}]),
}
"""A reader, and what is in a healthy file: one object, or one a line."""


def written(objects):
    return "".join(json.dumps(content) + "\n" for content in objects)


def places(value, path=()):
    """Where a value has parts."""
    yield path
    parts = value.items() if isinstance(value, dict) else ()
    parts = enumerate(value) if isinstance(value, list) else parts
    for key, part in parts:
        yield from places(part, (*path, key))


def replaced(value, path, odd):
    """A copy of a value with something else at a place."""
    if not path:
        return odd
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = replaced(value[path[0]], path[1:], odd)
    return copy


def odd_texts(objects):
    """A file's text with odd values at places that are drawn, and other texts instead of it."""
    drawn = random.Random(0)
    every = [place for place in places(objects) if place]
    for _ in range(COUNT):
        yield written(replaced(objects, drawn.choice(every), drawn.choice(ODD)))
    yield from TEXTS


def flipped(content):
    drawn = random.Random(1)
    for _ in range(COUNT):
        damaged = bytearray(content)
        damaged[drawn.randrange(len(content))] ^= 1 << drawn.randrange(8)
        yield bytes(damaged)


@pytest.mark.parametrize("kind", KINDS)
def test_odd_values_and_flipped_bits_are_read_or_refused(tmp_path, kind):
    make, objects = KINDS[kind]
    path, read = make(tmp_path)
    texts = [text.encode("utf-8", "surrogatepass") for text in odd_texts(objects)]
    refused = 0
    for content in [*texts, *flipped(written(objects).encode())]:
        path.write_bytes(content)
        try:
            read()
        except JaxcamError as error:
            refused += 1
            str(error).encode()
    assert refused > COUNT / 2
    path.unlink()
    path.mkdir()
    if kind != "pairs-test.json":
        with pytest.raises(JaxcamError):
            read()


def test_a_grid_of_yaml_that_is_no_json(tmp_path):
    for text in ("a: [", "- a", "runs: {a: 1}", "a: !!python/name:os.system", "\x00", "a: &a [*a]"):
        (tmp_path / "grid.yaml").write_text(text)
        with pytest.raises(JaxcamError):
            read_grid(tmp_path / "grid.yaml")
    (tmp_path / "grid.yaml").write_text(yaml.safe_dump(GRID))
    assert len(read_grid(tmp_path / "grid.yaml").runs) == 4


def test_numbers_of_metrics_are_told_from_others(tmp_path):
    file = tmp_path / "metrics.jsonl"
    file.write_text('{"step": 1, "loss": NaN}\n{"step": 2, "success_rate": 1.5}\n')
    with pytest.raises(JaxcamError, match=r"metrics.jsonl, line 2: success_rate is 1.5"):
        read_metrics(tmp_path)
    file.write_text('{"step": 1, "loss": "low"}\n')
    with pytest.raises(JaxcamError, match="'loss' is 'low', expected a number"):
        read_metrics(tmp_path)


@pytest.fixture
def run(tmp_path, demos):
    return make_run(tmp_path / "runs" / "a", demos)


SEALED = ["manifest/metadata", "files.json"]


@pytest.mark.parametrize("file", SEALED)
def test_a_checkpoint_is_refused_or_equal(run, file):
    checkpoint = run / "checkpoints" / "2"
    path, healthy = checkpoint / file, read_all(checkpoint)[0]
    content = path.read_bytes()
    texts = [text.encode("utf-8", "surrogatepass") for text in odd_texts([json.loads(content)])]
    for damaged in [*texts, *flipped(content)]:
        path.write_bytes(damaged)
        try:
            assert read_all(checkpoint)[0] == healthy
        except DamagedError:
            continue


def test_values_of_another_kind_are_refused_under_a_right_seal(run):
    """As they are after somebody has written the seal anew."""
    checkpoint = run / "checkpoints" / "2"
    (checkpoint / "files.json").unlink()
    path = checkpoint / "manifest" / "metadata"
    manifest = json.loads(path.read_text())
    del manifest["sha256"]
    drawn, refused = random.Random(2), 0
    every = [p for p in places(manifest) if p and len(p) < 4]
    for _ in range(COUNT):
        path.write_text(
            json.dumps(seal(replaced(manifest, drawn.choice(every), drawn.choice(ODD))))
        )
        try:
            read_all(checkpoint)
        except DamagedError:
            refused += 1
    assert refused >= 10


BROKEN = {
    "config.json": "configuration",
    "metrics.jsonl": "metrics",
    "eval/rows.jsonl": "evaluation",
    "env.txt": "environment",
    "checkpoints/2/files.json": "checkpoints",
    "checkpoints/2/manifest/metadata": "checkpoints",
}


@pytest.mark.parametrize("file", BROKEN)
def test_the_doctor_tells_what_is_broken(run, file):
    path = run / file
    for text in [*TEXTS, '{"step": "x"}\n', '{"dataset": "\\ud800"}', '{"\\ud800": 1}', "\udcff"]:
        path.write_bytes(text.encode("utf-8", "surrogateescape") + b"\n")
        for finding in check_run(run):
            finding.got.encode()
    path.unlink()
    path.mkdir()
    assert BROKEN[file] in {f.what for f in check_run(run) if f.mark != "good"}


def test_the_doctor_takes_folders_for_checkpoints_that_are_none(run):
    for name in ("²", "007", "١", "9" * 200):
        (run / "checkpoints" / name).mkdir()
    assert steps_in(run / "checkpoints") == [1, 2, int("9" * 200)]
    assert exit_code("check", run) == 1


def test_a_run_without_settings_has_the_defaults(tmp_path):
    (tmp_path / "config.json").write_text("{}")
    assert None not in asdict(read_config(tmp_path)).values()
    assert re.match("runs/lift", read_config(tmp_path).run_dir)
    assert Path(read_config(tmp_path).data_dir) == Path("data")
