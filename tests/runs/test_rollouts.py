"""Rows in a run's folder are the run's own, or refused."""

import json
import shutil
from dataclasses import replace

import pytest
from checked_run import CONFIG, row, save_checkpoints, write

from jaxcam.config.fields import to_json
from jaxcam.errors import DatasetError
from jaxcam.results.stats import latest_rows, success_rate
from jaxcam.runs.rollouts import read_run_rows, stored_weights, weights_digest
from jaxcam.training.checkpoint import load_policy_inputs
from jaxcam.training.digests import describe, flatten


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run with two checkpoints, and an evaluation of three pairs."""
    folder = tmp_path_factory.mktemp("runs") / "mine"
    (folder / "eval").mkdir(parents=True)
    (folder / "config.json").write_text(to_json(CONFIG))
    save_checkpoints(folder, "abc")
    digests = [{"sha": f"{pair:016x}"} for pair in range(3)]
    (folder / "eval" / "pairs-test.json").write_text(json.dumps({"pairs": digests}))
    write(folder / "eval" / "rows.jsonl", [own_row(folder, pair) for pair in range(3)])
    return folder


def own_row(folder, pair, **changes):
    said = {name: getattr(CONFIG, name) for name in ("task", "scene", "policy", "conditioning")}
    return row(2, pair, run="mine", seed=CONFIG.seed, pair_sha=f"{pair:016x}",
               weights_sha=stored_weights(folder, 2), steps=9, **said) | changes  # fmt: skip


@pytest.fixture
def run(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "mine")


def test_the_digest_on_disk_is_that_of_the_weights_that_act(run):
    params = load_policy_inputs(run, 2).params
    described = {name: describe(leaf) for name, leaf in flatten(params).items()}
    assert stored_weights(run, 2) == weights_digest(described)
    assert stored_weights(run, 3) is None


def test_a_runs_own_rows_are_read(run):
    rows = read_run_rows(run)
    assert [r.pair for r in rows] == [0, 1, 2]
    assert {r.run for r in rows} == {"mine"}


FOREIGN = {
    "another seed": ({"seed": 7}, "seed 7, expected 0"),
    "another conditioning": ({"conditioning": "token"}, "conditioning 'token'"),
    "other weights": ({"weights_sha": "0" * 16}, "weights '0000000000000000', expected"),
    "another pair": ({"pair_sha": "f" * 16}, "pair 'ffffffffffffffff', expected"),
    "a second outcome": ({"success": False}, "second outcome"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_row_that_is_not_the_runs_is_refused(run, case):
    changes, words = FOREIGN[case]
    rows = [own_row(run, pair) for pair in range(3)]
    write(run / "eval" / "rows.jsonl", [*rows, own_row(run, 2, **changes)])
    with pytest.raises(DatasetError, match=f"line 4: this row of pair .* is not of.*{words}"):
        read_run_rows(run)


def test_rows_of_another_run_without_digests_are_refused(run):
    """As version 0.1.0 wrote them: the name is all that tells."""
    rows = [own_row(run, pair, weights_sha=None) for pair in range(2)]
    write(run / "eval" / "rows.jsonl", [*rows, own_row(run, 2, weights_sha=None, run="other")])
    with pytest.raises(DatasetError, match="run 'other', expected 'mine'"):
        read_run_rows(run)


def test_a_renamed_run_does_not_mix_widths(run):
    renamed = run.rename(run.with_name("renamed"))
    again = [own_row(renamed, pair, run="renamed", width=7) for pair in range(2)]
    rows = [own_row(renamed, pair) for pair in range(3)]
    write(renamed / "eval" / "rows.jsonl", [*rows, *again])
    latest = latest_rows(read_run_rows(renamed))
    assert {(r.run, r.width) for r in latest} == {("renamed", 7)}
    assert success_rate(latest).n == 2


def test_rows_that_were_written_within_the_folder_are_its_own(run, monkeypatch):
    """`cd RUN; python -m jaxcam.evaluate .` once wrote rows of a run without a name."""
    rows = [own_row(run, pair, weights_sha=None, run="") for pair in range(3)]
    write(run / "eval" / "rows.jsonl", rows)
    monkeypatch.chdir(run)
    assert {r.run for r in read_run_rows(run.relative_to(run))} == {"mine"}


@pytest.mark.parametrize("content", ["[]", '{"pairs": 3}', '{"pairs": [1]}', "{", "null"])
def test_pairs_of_the_wrong_shape_are_refused(run, content):
    (run / "eval" / "pairs-test.json").write_text(content)
    with pytest.raises(DatasetError, match=r"pairs-test\.json is damaged"):
        read_run_rows(run)


@pytest.mark.parametrize("content", ["[]", "{}", '{"leaves": 3}', '{"leaves": {"ema/w": 1}}', ""])
def test_a_manifest_of_the_wrong_shape_has_no_digest(run, content):
    (run / "checkpoints" / "2" / "manifest" / "metadata").write_text(content)
    assert stored_weights(run, 2) is None


def test_weights_that_are_gone_still_have_one_digest(run):
    shutil.rmtree(run / "checkpoints")
    assert len(read_run_rows(run)) == 3
    rows = [replace(r, weights_sha="1" * 16 if r.pair else r.weights_sha).to_json()
            for r in read_run_rows(run)]  # fmt: skip
    write(run / "eval" / "rows.jsonl", rows)
    with pytest.raises(DatasetError, match="weights '1111"):
        read_run_rows(run)
