"""What is run of an evaluation, and what is done about rollouts that end in an error."""

import numpy as np

from jaxcam.evaluate import ATTEMPTS, evaluate
from jaxcam.rundir import append_jsonl, read_jsonl
from jaxcam.sim.rollout import Rollouts


class FlakyEvaluator:
    """Pair 1 ends in an error the first time, pair 2 every time; the rest succeed."""

    width = 2
    engine_name = "native"
    ensemble = 0.0

    def __init__(self, lift):
        self.task = lift
        self.ran: list[int] = []

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
