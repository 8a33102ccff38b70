"""What is run of a checkpoint, and what is done about rollouts that end in an error."""

import os
from dataclasses import replace

import av
import jax
import numpy as np
import pytest
from tiny_training import PairsEvaluator

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.evaluation.checkpoint import Wanted, evaluate
from jaxcam.evaluation.evaluator import Candidate
from jaxcam.files.jsonl import append_jsonl, read_jsonl
from jaxcam.results.protocol import ATTEMPTS
from jaxcam.runs.rollouts import read_rows, rows_file


class FlakyEvaluator(PairsEvaluator):
    """Pair 1 ends in an error the first time, pair 2 every time; the rest succeed."""

    def success(self, pair):
        return True


def candidate(folder):
    return Candidate(None, None, folder, 7)  # pyright: ignore


def test_errors_are_run_once_more_and_then_told(tmp_path):
    evaluator = FlakyEvaluator()
    estimate = evaluate(evaluator, candidate(tmp_path), Wanted(pairs=4))
    assert sorted(evaluator.ran) == [0, 1, 1, 2, 2, 3]
    assert evaluator.ran.count(2) == ATTEMPTS
    assert (estimate.value, estimate.n, estimate.excluded) == (1.0, 3, 1)
    again = evaluate(evaluator, candidate(tmp_path), Wanted(pairs=4))
    assert again == estimate
    assert len(evaluator.ran) == 6


def test_only_what_is_missing_is_run(tmp_path):
    evaluator = FlakyEvaluator()
    evaluate(evaluator, candidate(tmp_path), Wanted(pairs=1))
    file = tmp_path / "eval" / "rows.jsonl"
    other = {**read_jsonl(file)[0], "pair": 3, "step": 6}
    append_jsonl(file, other)
    with open(file, "a") as torn:
        torn.write('{"step": 7, "pair"')
    evaluate(evaluator, candidate(tmp_path), Wanted(pairs=4))
    assert evaluator.ran[:1] == [0]
    assert sorted(set(evaluator.ran[1:])) == [1, 2, 3]


def test_memory_that_does_not_suffice_is_told_with_a_smaller_width(tmp_path, monkeypatch):
    def too_large(*args, **given):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.")

    monkeypatch.setattr(FlakyEvaluator, "run", too_large)
    with pytest.raises(ConfigError, match=r"A batch of 2 rollouts: does not fit .*Use --width 1"):
        evaluate(FlakyEvaluator(), candidate(tmp_path), Wanted(pairs=4))
    assert read_jsonl(tmp_path / "eval" / "rows.jsonl") == []


def test_a_disk_without_room_for_videos_keeps_the_rows(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(FlakyEvaluator, "clips", lambda *args: [np.zeros((2, 8, 8, 3), np.uint8)],
                        raising=False)  # fmt: skip
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    opened = av.open
    # Every write finds the disk full.
    monkeypatch.setattr(av, "open", lambda path, *args, **kw: opened("/dev/full", *args, **kw))
    estimate = evaluate(FlakyEvaluator(), candidate(tmp_path), Wanted(pairs=2, videos=1))
    assert estimate.n == 2
    assert "could not be written: [Errno 28] No space left on device" in caplog.text
    assert not list((tmp_path / "videos").glob("*.mp4"))


def test_a_rollout_of_both_videos_is_drawn_once(tmp_path, monkeypatch):
    drawn = []

    def clips(self, done, split, pairs):
        drawn.append(pairs)
        assert len(done.steps) == len(pairs)
        return [np.full((2, 8, 8, 3), 9 * p, np.uint8) for p in pairs]

    monkeypatch.setattr(FlakyEvaluator, "width", 5)
    monkeypatch.setattr(FlakyEvaluator, "finishes", lambda self, pair: True)
    monkeypatch.setattr(FlakyEvaluator, "success", lambda self, pair: pair in (0, 2))
    monkeypatch.setattr(FlakyEvaluator, "clips", clips, raising=False)
    evaluate(FlakyEvaluator(), candidate(tmp_path), Wanted(pairs=5, videos=2))
    assert drawn == [[0, 1, 3]]  # 0 and 1 come first, 1 and 3 fail first
    names = sorted(file.name for file in (tmp_path / "videos").iterdir())
    assert names == ["failures-test-000007.mp4", "test-000007.mp4"]


@pytest.mark.parametrize("other", [{"width": 3}, {"engine": "mjx"}, {"ensemble": 0.1},
                                   {"step": 6}, {"split": "validation"},
                                   {"eval_pose_noise": "1,1"}])  # fmt: skip
def test_rows_that_were_made_in_another_way_do_not_count(tmp_path, other):
    evaluator = FlakyEvaluator()
    evaluate(evaluator, candidate(tmp_path), Wanted(pairs=1))
    (row,) = read_rows(rows_file(tmp_path))
    append_jsonl(rows_file(tmp_path), replace(row, pair=3, **other).to_json())
    evaluate(evaluator, candidate(tmp_path), Wanted(pairs=4))
    assert sorted(set(evaluator.ran)) == [0, 1, 2, 3]


def test_rows_of_another_run_are_not_taken_for_this_ones(tmp_path):
    """They were once: nothing was run, and 100 % was said."""
    for name, changes in (
        ("weights", {"weights_sha": "0" * 16}),
        ("pairs", {"pair_sha": "f" * 16}),
    ):
        folder = tmp_path / name
        folder.mkdir()
        evaluate(FlakyEvaluator(), candidate(folder), Wanted(pairs=1))
        (row,) = read_rows(rows_file(folder))
        append_jsonl(rows_file(folder), replace(row, pair=3, **changes).to_json())
        with pytest.raises(DatasetError, match=r"other weights|not of this run"):
            evaluate(FlakyEvaluator(), candidate(folder), Wanted(pairs=4))
