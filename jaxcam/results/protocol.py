"""How much is evaluated: the paper's 3 seeds x last 10 checkpoints x 50 pairs, and what counts."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jaxcam.results.rows import OUTCOMES, SEEN, Row
from jaxcam.results.stats import by_field

ATTEMPTS = 2
"""Times that a pair is run whose rollout ends in an error of the simulator."""
NOT_RECORDED = "not recorded"
"""What rows are of where nobody wrote it down."""
_SEEDS = {"act": 3, "diffusion": 3, "smolvla": 1, NOT_RECORDED: 3, "": 3}


@dataclass(frozen=True)
class Protocol:
    """Numbers of a protocol.

    Attributes:
        seeds: Runs of the same settings.
        checkpoints: Last checkpoints of each run.
        pairs: Held-out (initial state, camera pose) pairs each checkpoint is evaluated on.
    """

    seeds: int
    checkpoints: int
    pairs: int

    @property
    def rollouts(self) -> int:
        """Rollouts of one setting."""
        return self.seeds * self.checkpoints * self.pairs

    def __str__(self) -> str:
        return f"{self.seeds} × {self.checkpoints} × {self.pairs} = {self.rollouts}"

    def steps(self, last: int, save_every: int) -> list[int]:
        """Steps of the checkpoints a finished run is judged by, the newest first.

        A run that was interrupted also has checkpoints between these; they do not count, so that
        all seeds are judged at the same steps.

        Args:
            last: Updates of the run.
            save_every: Updates between its checkpoints.
        """
        before = range((last - 1) // save_every * save_every, 0, -save_every)
        return [last, *before][: self.checkpoints]


def is_foreign(policy: str) -> bool:
    """Whether a policy is somebody else's, which was not trained here.

    Args:
        policy: Its kind, such as "act", or the name that it was given.
    """
    return policy not in _SEEDS


def protocol_of(policy: str) -> Protocol:
    """The paper's protocol (section IV-C); SmolVLA has one seed there.

    Of somebody else's policy there is what was served: one set of weights.

    Args:
        policy: Kind of policy, such as "act".
    """
    if is_foreign(policy):
        return Protocol(seeds=1, checkpoints=1, pairs=50)
    return Protocol(seeds=_SEEDS[policy], checkpoints=10, pairs=50)


def counted(rows: Sequence[Row], protocol: Protocol) -> list[Row]:
    """The rows of one run that its success rate is taken over.

    These are the newest evaluated checkpoints. Where there are several, each counts with the
    protocol's pairs only, so that none weighs more; a single one counts with all its pairs.

    Args:
        rows: Evaluation rows of a run.
        protocol: How many checkpoints and pairs.
    """
    by_step = by_field(rows, "step")
    newest = sorted(by_step)[-protocol.checkpoints :]
    if len(newest) == 1:
        return list(by_step[newest[0]])
    return [row for step in newest for row in by_step[step] if row.pair < protocol.pairs]


def missing(rows: Sequence[Row], pairs: int) -> list[int]:
    """The pairs of a checkpoint that are to be run: those without an outcome, and not too often.

    Args:
        rows: Evaluation rows of the checkpoint.
        pairs: How many pairs there are.
    """
    tries = Counter(row.pair for row in rows)
    done = {row.pair for row in rows if row.status in OUTCOMES}
    return [p for p in range(pairs) if p not in done and tries[p] < ATTEMPTS]


def lacks(runs: Iterable[Sequence[Row]], protocol: Protocol, last: int | None) -> list[str]:
    """What a setting lacks to have been evaluated as the protocol asks; nothing if it is whole.

    Args:
        runs: Counted rows of each run (seed) of the setting.
        protocol: What is asked.
        last: Updates of a finished run, None if that is not known.

    Returns:
        Phrases such as "1 of 3 seeds".
    """
    judged = [rows for rows in runs if rows]
    if not judged:
        return ["not evaluated"]
    if any(row.split == SEEN for rows in judged for row in rows):
        return ["on cameras that training saw: no result"]
    shapes = [_shape(rows) for rows in judged]
    wanted = [
        (len(shapes), protocol.seeds, "seeds"),
        (min(checkpoints for checkpoints, _, _ in shapes), protocol.checkpoints, "checkpoints"),
        (min(pairs for _, pairs, _ in shapes), protocol.pairs, "pairs"),
    ]
    lacking = [f"{has} of {asked} {what}" for has, asked, what in wanted if has < asked]
    newest = min(step for _, _, step in shapes)
    if last is not None and newest < last:
        lacking.append(f"trained for {newest:,} of {last:,} updates")
    return lacking


def _shape(rows: Sequence[Row]) -> tuple[int, int, int]:
    """Checkpoints, finished pairs of the checkpoint that has fewest, and the newest step."""
    by_step = by_field(rows, "step")
    pairs = (len({r.pair for r in some if r.finished}) for some in by_step.values())
    return len(by_step), min(pairs), max(by_step)
