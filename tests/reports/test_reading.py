"""Which runs make an arm, and which of their rows count."""

import shutil

import pytest
from made_runs import arms_of, make_run
from places import REPO

from jaxcam.errors import ConfigError
from jaxcam.reports.reading import read_runs


def test_a_whole_protocol_counts_and_anything_less_is_told(tmp_path):
    for seed in range(3):
        make_run(tmp_path / f"w{seed}", seed=seed, checkpoints=10, pairs=50, save_every=100)
        make_run(tmp_path / f"l{seed}", seed=seed, checkpoints=9 + (seed > 0), pairs=50,
                 save_every=100, conditioning="late")  # fmt: skip
    whole, less = arms_of(tmp_path)[::-1]
    assert (whole.lacks, whole.count(), whole.estimate.n) == ([], "1500", 1500)
    assert (less.lacks, less.count()) == (["9 of 10 checkpoints"], "1450 of 1500")
    assert whole.estimate.clusters == 50


def test_the_newest_checkpoints_count_with_the_protocols_pairs(tmp_path):
    make_run(tmp_path / "a", checkpoints=12, pairs=60, save_every=100)
    (arm,) = arms_of(tmp_path)
    assert sorted({row.step for row in arm.rows}) == [*range(3100, 4001, 100)]
    assert max(row.pair for row in arm.rows) == 49


def test_runs_that_cannot_be_compared_are_refused(runs, tmp_path):
    with pytest.raises(ConfigError, match="No run in"):
        read_runs([tmp_path / "nothing"])
    make_run(tmp_path / "other" / "late", rate=0.5, conditioning="late")
    with pytest.raises(ConfigError, match="same settings and the same seed"):
        read_runs([runs, tmp_path / "other"])
    make_run(tmp_path / "new" / "late", conditioning="late", seed=1)
    file = tmp_path / "new" / "late" / "eval" / "rows.jsonl"
    file.write_text(file.read_text().replace('"pair_sha": "00', '"pair_sha": "0f'))
    with pytest.raises(ConfigError, match="different pairs of the same number"):
        read_runs([runs, tmp_path / "new"])


def test_links_that_lead_back_are_followed_once(tmp_path):
    shutil.copytree(REPO / "results" / "lift", tmp_path / "results" / "lift")
    for name in ("a", "b"):
        (tmp_path / "results" / name).symlink_to(tmp_path / "results")
    assert len(read_runs([tmp_path])) == len(read_runs([tmp_path / "results" / "lift"]))
