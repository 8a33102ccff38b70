"""What a policy loses that is told poses as `calibrate arm` finds them, instead of the true ones.

Called by `benchmarks/calibration.py`. Each held-out pair of start and camera is rolled out twice by
a trained policy: told the camera's true pose, and told it with one of the errors that
`calibrate arm` made on films, drawn at random.
"""

from pathlib import Path

import numpy as np

from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.rays import invert
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.results.differences import studentised
from jaxcam.results.stats import wilson
from jaxcam.robot.asked import load_run
from jaxcam.sim.observing import Told
from jaxcam.sim.rollout import Episodes, rollout

SEED = 0


def policy(run: Path, errors: Path, count: int) -> None:
    """Success of a run's newest checkpoint with true poses, and with the arm's errors.

    Args:
        run: Folder of the run.
        errors: Poses of found cameras in the axes of the true ones [N, 4, 4], which the form `arm`
            leaves beside its films.
        count: Held-out pairs.
    """
    config, candidate = load_run(run)
    evaluator = Evaluator(config)
    known = np.load(errors)
    wrong = known[np.random.default_rng(SEED).integers(len(known), size=count)]
    told_true = outcomes(evaluator, candidate, np.broadcast_to(np.eye(4), wrong.shape))
    told_found = outcomes(evaluator, candidate, wrong)
    for words, outcome in (("true poses", told_true), ("found poses", told_found)):
        low, high = wilson(outcome.sum(), count)
        print(f"{words}: {outcome.mean():.1%} [{low:.1%}, {high:.1%}] of {count} pairs")
    deltas = told_found.astype(float) - told_true
    low, high, p_value = studentised(deltas)
    print(f"lost by {len(known)} errors of `arm`: {-100 * deltas.mean():.1f} points "
          f"[{-100 * high:.1f}, {-100 * low:.1f}], p = {p_value:.3f}")  # fmt: skip


def outcomes(evaluator: Evaluator, candidate: Candidate, errors: np.ndarray) -> np.ndarray:
    """Successes [N] of the first N held-out pairs, told poses with these errors [N, 4, 4]."""
    width, result = evaluator.width, []
    for first in range(0, len(errors), width):
        numbers = np.arange(first, min(first + width, len(errors)))
        filled = np.r_[numbers, np.repeat(numbers[-1], width - len(numbers))]
        pairs = evaluator.pairs("test", filled.tolist())
        K = intrinsics(evaluator.task.fovy_deg, *evaluator.size)
        poses = invert(evaluator.scene.world_from_base) @ pairs.cameras @ errors[filled, None]
        episodes = Episodes(
            pairs.start,
            K=np.broadcast_to(K, (*pairs.cameras.shape[:2], 3, 3)),
            world_from_camera=pairs.cameras,
            alive=np.arange(width) < len(numbers),
            claimed=Told(base_from_camera=poses.astype(np.float32)),
        )
        with candidate.acting(evaluator) as agent:
            done = rollout(agent, evaluator.task, evaluator.engine, evaluator.renderer, episodes)
        result.append(done.success[: len(numbers)])
    return np.concatenate(result)
