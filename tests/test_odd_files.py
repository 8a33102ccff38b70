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
from odd_files import COUNT, ODD, TEXTS, flipped, odd_texts, places, replaced, written
from running import exit_code

from jaxcam.checks.run import check_run
from jaxcam.config.fields import to_json
from jaxcam.data.pairs import read_digests
from jaxcam.errors import JaxcamError
from jaxcam.interop.lerobot.policy import describe_checkpoint, read_about, read_checkpoint
from jaxcam.rays import read_pose_file
from jaxcam.reports.packs.folder import read_results
from jaxcam.reports.packs.records import read_records
from jaxcam.runs.grid import read_grid
from jaxcam.runs.identity import read_config
from jaxcam.runs.manifests import DamagedError, record_of_weights, seal, steps_in
from jaxcam.runs.metrics import read_metrics
from jaxcam.runs.rollouts import read_rows
from jaxcam.training.digests import read_all


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


def weights(folder):
    return folder / "weights.json", lambda: record_of_weights(folder)


def poses(folder):
    return folder / "poses.json", lambda: read_pose_file(folder / "poses.json")


def records(folder):
    return folder / "runs.json", lambda: read_records(folder / "runs.json")


def results(folder):
    listed = [{"run": 0, "name": "a", "seed": 0, "settings": {"task": "lift"}, "seconds": 3}]
    (folder / "runs.json").write_text(json.dumps(listed))
    return folder / "rows.jsonl", lambda: read_results(folder, "test")


def lerobot(kind, file):
    """A file of a LeRobot checkpoint, whose other files are whole; no network is built."""

    def make(folder):
        pytest.importorskip("safetensors")
        write_folder(folder, kind)
        read = read_checkpoint if kind == "smolvla" else describe_checkpoint
        return folder / file, lambda: read(folder)

    return make


def lerobot_about(folder):
    return folder / "jaxcam.json", lambda: read_about(folder)


ROW = {"step": 2, "split": "test", "pair": 0, "success": True, "status": "ok", "width": 50}
METRIC = {"step": 1, "loss": 2.0, "skipped": 0.0, "seconds": 3.5}
RATE = {"step": 2, "success_rate": 0.5, "low": 0.1, "high": 0.9, "pairs": 2}
PAIR = {"episode_seed": 3, "cameras": [[[1.0]]], "sha": "00"}
POSE = [[1.0, 0.0, 0.0, 0.5], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.2], [0.0, 0.0, 0.0, 1.0]]
RECORD = {"run": 0, "name": "a", "seed": 0, "seconds": 7,
          "settings": {"task": "lift", "scene": "fixed", "policy": "act", "conditioning": "late",
                       "preset": "laptop", "views": 1}}  # fmt: skip
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
    "weights.json": (weights, [{"file": "a.pth", "kind": "ResNet-18", "sha256": WHOLE}]),
    "poses.json": (poses, [{"config": {"seed": 3}, "poses": [POSE, POSE]}]),
    "runs.json": (records, [[RECORD, RECORD | {"run": 1, "name": "b"}]]),
    "results": (results, [ROW | {"run": 0}, ROW | {"run": 0, "pair": 1}]),
    "act/config.json": (lerobot("act", "config.json"), [config_of("act")]),
    "diffusion/config.json": (lerobot("diffusion", "config.json"), [config_of("diffusion")]),
    "smolvla/config.json": (lerobot("smolvla", "config.json"), [config_of("smolvla")]),
    "before": (lerobot("act", "policy_preprocessor.json"), [BEFORE]),
    "after": (lerobot("diffusion", "policy_postprocessor.json"), [AFTER]),
    "jaxcam.json": (lerobot_about, [{"action_space": "eef_abs", "rotations": "nominal"}]),
}
"""A reader, and what is in a healthy file: one object, or one a line."""


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
    all_places = [p for p in places(manifest) if p and len(p) < 4]
    for _ in range(COUNT):
        path.write_text(
            json.dumps(seal(replaced(manifest, drawn.choice(all_places), drawn.choice(ODD))))
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
    "weights.json": "weights",
    "checkpoints/2/files.json": "checkpoints",
    "checkpoints/2/manifest/metadata": "checkpoints",
}


@pytest.mark.parametrize("file", BROKEN)
def test_the_doctor_tells_what_is_broken(run, file):
    path = run / file
    (run / "weights.json").write_text('{"file": "a.pth", "kind": null, "sha256": "0123"}')
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
