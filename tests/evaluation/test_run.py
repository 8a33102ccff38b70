"""What is run of an evaluation, and what is done about rollouts that end in an error."""

import os

import jax
import numpy as np
import pytest

from jaxcam.config.train import TrainConfig
from jaxcam.data.pairs import Pairs, make_pairs, store_pairs
from jaxcam.errors import CheckpointError, ConfigError, DatasetError
from jaxcam.evaluation.run import _steps, evaluate
from jaxcam.files.jsonl import append_jsonl, read_jsonl
from jaxcam.results.protocol import ATTEMPTS, Protocol, counted, lacks, protocol_of
from jaxcam.sim.rollout import Rollouts
from jaxcam.sim.types import Start


class FlakyEvaluator:
    """Pair 1 ends in an error the first time, pair 2 every time; the rest succeed."""

    width = 2
    engine_name = "native"
    ensemble = 0.0

    def __init__(self, lift):
        self.task = lift
        self.ran: list[int] = []

    def pairs(self, split, numbers):
        nothing = np.zeros((len(numbers), 1))
        start = Start(*[nothing + np.array(numbers)[:, None]] * len(Start._fields))
        return Pairs([*numbers], nothing, start)

    def run(self, policy, params, split, pairs, *, step, run, tick):
        ok = [p != 2 and not (p == 1 and 1 not in self.ran) for p in pairs]
        self.ran += pairs
        row = {"step": step, "split": split, "run": run, "width": self.width, "success": True}
        rows = [
            {**row, "pair": p, "status": "ok" if good else "error", "success": good}
            for p, good in zip(pairs, ok, strict=True)
        ]
        nothing = np.zeros(len(pairs))
        return rows, Rollouts(nothing > 0, nothing, nothing > 0, np.zeros((1, len(pairs), 1)))


def test_errors_are_run_once_more_and_then_told(lift, tmp_path):
    evaluator = FlakyEvaluator(lift)
    estimate = evaluate(evaluator, None, None, tmp_path, step=7, pairs=4)  # pyright: ignore
    assert sorted(evaluator.ran) == [0, 1, 1, 2, 2, 3]
    assert evaluator.ran.count(2) == ATTEMPTS
    assert (estimate.value, estimate.n, estimate.excluded) == (1.0, 3, 1)
    again = evaluate(evaluator, None, None, tmp_path, step=7, pairs=4)  # pyright: ignore
    assert again == estimate
    assert len(evaluator.ran) == 6


def test_only_what_is_missing_is_run(lift, tmp_path):
    evaluator = FlakyEvaluator(lift)
    evaluate(evaluator, None, None, tmp_path, step=7, pairs=1)  # pyright: ignore
    file = tmp_path / "eval" / "rows.jsonl"
    other = {**read_jsonl(file)[0], "pair": 3, "step": 6}
    append_jsonl(file, other)
    with open(file, "a") as torn:
        torn.write('{"step": 7, "pair"')
    evaluate(evaluator, None, None, tmp_path, step=7, pairs=4)  # pyright: ignore
    assert evaluator.ran[:1] == [0]
    assert sorted(set(evaluator.ran[1:])) == [1, 2, 3]


def test_memory_that_does_not_suffice_is_told_with_a_smaller_width(lift, tmp_path, monkeypatch):
    def too_large(*args, **given):
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 9 bytes.")

    monkeypatch.setattr(FlakyEvaluator, "run", too_large)
    with pytest.raises(ConfigError, match=r"A batch of 2 rollouts: does not fit .*Use --width 1"):
        evaluate(FlakyEvaluator(lift), None, None, tmp_path, step=7, pairs=4)  # pyright: ignore
    assert read_jsonl(tmp_path / "eval" / "rows.jsonl") == []


def test_a_disk_without_room_for_videos_keeps_the_rows(lift, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(FlakyEvaluator, "clips", lambda *args: [np.zeros((2, 8, 8, 3), np.uint8)],
                        raising=False)  # fmt: skip
    (tmp_path / "videos").mkdir()
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full")
    for name in ("test-000007", "failures-test-000007"):  # every write there finds the disk full
        (tmp_path / "videos" / f"{name}.mp4.part").symlink_to("/dev/full")
    estimate = evaluate(
        FlakyEvaluator(lift), None, None, tmp_path, step=7, pairs=2, videos=1,  # pyright: ignore
    )  # fmt: skip
    assert estimate.n == 2
    assert "could not be written: [Errno 28] No space left on device" in caplog.text
    assert not list((tmp_path / "videos").glob("*.mp4"))


def test_a_rollout_of_both_videos_is_drawn_once(lift, tmp_path, monkeypatch):
    drawn = []

    def clips(self, done, split, pairs):
        drawn.append(pairs)
        assert len(done.steps) == len(pairs)
        return [np.full((2, 8, 8, 3), 9 * p, np.uint8) for p in pairs]

    def run(self, policy, params, split, pairs, **_):
        row = {"step": 7, "split": split, "run": "", "width": 5, "status": "ok"}
        rows = [{**row, "pair": p, "success": p in (0, 2)} for p in pairs]
        nothing = np.zeros(len(pairs))
        return rows, Rollouts(nothing > 0, nothing, nothing == 0, np.zeros((1, len(pairs), 1)))

    monkeypatch.setattr(FlakyEvaluator, "width", 5)
    monkeypatch.setattr(FlakyEvaluator, "run", run)
    monkeypatch.setattr(FlakyEvaluator, "clips", clips, raising=False)
    evaluate(FlakyEvaluator(lift), None, None, tmp_path, step=7, pairs=5, videos=2)  # pyright: ignore
    assert drawn == [[0, 1, 3]]  # 0 and 1 come first, 1 and 3 fail first
    names = sorted(file.name for file in (tmp_path / "videos").iterdir())
    assert names == ["failures-test-000007.mp4", "test-000007.mp4"]


def test_pairs_follow_from_their_number_and_are_recognised(lift, scene, scenes):
    some = make_pairs(lift, scene, 1, "test", [0, 1, 2])
    again = make_pairs(lift, scene, 1, "test", [2, 0])
    assert again.digests() == [some.digests()[2], some.digests()[0]]
    assert len(set(some.digests())) == 3
    assert make_pairs(lift, scene, 1, "validation", [0]).digests()[0] not in some.digests()
    assert make_pairs(lift, scenes["fixed"], 1, "test", [0]).digests()[0] not in some.digests()
    both = make_pairs(lift, scene, 2, "test", [1])  # pair p of two views has cameras 2p and 2p + 1
    assert np.array_equal(both.cameras[0, 0], some.cameras[2, 0])
    moved = some._replace(start=some.start._replace(qpos=some.start.qpos + 2e-6))
    assert not set(moved.digests()) & set(some.digests())


def test_stored_pairs_are_compared_and_grow(lift, scene, tmp_path):
    file = tmp_path / "pairs-test.json"
    some = make_pairs(lift, scene, 1, "test", [0, 1, 2])
    store_pairs(file, make_pairs(lift, scene, 1, "test", [0]))
    store_pairs(file, some)
    before = file.read_text()
    assert before.count('"sha"') == 3
    store_pairs(file, make_pairs(lift, scene, 1, "test", [0, 1]))
    assert file.read_text() == before
    cameras = some.cameras.copy()
    cameras[1, 0, 0, 3] += 0.01
    with pytest.raises(DatasetError, match="pair 1 was"):
        store_pairs(file, some._replace(cameras=cameras))


def test_steps_of_the_protocol(tmp_path):
    protocol = protocol_of("act")
    assert protocol.rollouts == 1500
    assert protocol_of("smolvla").rollouts == 500
    assert protocol.steps(4000, 400) == [*range(4000, 0, -400)]
    assert protocol.steps(1000, 300) == [1000, 900, 600, 300]
    trained = TrainConfig(steps=1000, save_every=100, keep=3, steps_per_call=1)
    for step in (550, 700, 800, 900):  # 550: where a signal stopped the run
        (tmp_path / "checkpoints" / str(step)).mkdir(parents=True)
    with pytest.raises(CheckpointError, match="trained to step 900 of 1000"):
        _steps(tmp_path, trained)
    (tmp_path / "checkpoints" / "1000").mkdir()
    steps, lacking = _steps(tmp_path, trained)
    assert steps == [1000, 900, 800, 700]
    assert "600, 500, 400, 300, 200, 100" in lacking[0]


def test_what_counts_and_what_is_lacking():
    row = {"status": "ok", "success": True, "task": "lift"}
    one = [{**row, "step": 40, "pair": p} for p in range(5)]
    both = one + [{**row, "step": 20, "pair": p} for p in range(3)]
    small = Protocol(seeds=2, checkpoints=2, pairs=3)
    assert counted(one, small) == one  # a single checkpoint counts with all its pairs
    assert [(r["step"], r["pair"]) for r in counted(both, small)] == [
        (step, pair) for step in (20, 40) for pair in range(3)
    ]
    assert lacks([counted(both, small)] * 2, small, 40) == []
    assert lacks([counted(both, small)], small, 40) == ["1 of 2 seeds"]
    assert lacks([counted(both, small), one], small, 40) == ["1 of 2 checkpoints"]
    assert lacks([both[:-1]] * 2, small, 40) == ["2 of 3 pairs"]
    failed = [*both[:-1], {**both[-1], "status": "error"}]
    assert lacks([failed] * 2, small, 40) == ["2 of 3 pairs"]
    assert lacks([counted(both, small)] * 2, small, 80) == ["trained for 40 of 80 updates"]
    assert lacks([[]], small, 40) == ["not evaluated"]
