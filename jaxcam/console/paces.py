"""How long long jobs took on this machine, so that the next one can say what it will take.

Seconds a step of each kind of job stand in a small file of the user's caches. Nothing depends on
it: one that is missing, damaged or cannot be written is as one that says nothing.
"""

import contextlib
import json
import os
import platform
from pathlib import Path

from jaxcam.config.train import TrainConfig
from jaxcam.errors import JaxcamError
from jaxcam.files.json import read_json
from jaxcam.files.whole import whole

MOST = 200
"""Kinds of jobs that are kept, the newest ones."""
LEAST_SECONDS = 5.0
"""A job that was over sooner says nothing: most of it was its start."""


def paces_file() -> Path:
    """Where the paces of this machine are; `JAXCAM_CACHE` moves the folder."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    folder = Path(os.environ.get("JAXCAM_CACHE") or caches / "jaxcam")
    return folder / f"paces-{platform.node() or 'machine'}.json"


def paces() -> dict[str, float]:
    """Seconds a step by the kind of job."""
    try:
        known = read_json(paces_file())
    except (JaxcamError, OSError):
        return {}
    known = known if isinstance(known, dict) else {}
    return {job: float(s) for job, s in known.items() if isinstance(s, int | float) and s > 0}


def keep_pace(job: str, steps: int, seconds: float) -> None:
    """Keeps how long a job took, if it was long enough to tell.

    Args:
        job: Its kind, in words.
        steps: That were done.
        seconds: That they took.
    """
    if not job or steps < 2 or seconds < LEAST_SECONDS:
        return
    known = paces()
    known.pop(job, None)
    newest = dict([*known.items(), (job, seconds / steps)][-MOST:])
    with contextlib.suppress(JaxcamError, OSError), whole(paces_file()) as part:
        part.write_text(json.dumps(newest, indent=1) + "\n", encoding="utf-8")


def expected_seconds(job: str, steps: float) -> float | None:
    """What a job will take here by the last one of its kind; None where none is known."""
    pace = paces().get(job)
    return None if pace is None else pace * steps


def in_words(seconds: float | None) -> str:
    """An expected time for people."""
    if seconds is None:
        return "no such work was timed on this machine yet"
    if seconds < 90:
        return f"about {max(round(seconds), 1)} s, as the last time on this machine"
    if seconds < 5400:
        return f"about {round(seconds / 60)} min, as the last time on this machine"
    return f"about {seconds / 3600:.1f} h, as the last time on this machine"


def collecting_job(task: str, scene: str) -> str:
    """The kind of a collection; a step is a demonstration."""
    return f"collecting {task} {scene}"


def training_job(config: TrainConfig, seeds: int) -> str:
    """The kind of a training of so many seeds side by side; a step is an update."""
    network = f"{config.policy} {config.preset} {config.conditioning} {' '.join(config.model)}"
    sizes = f"{config.batch} {config.views} {config.resolution} {config.precision}"
    return f"training {network.strip()} {sizes} x{seeds}"


def rollouts_job(task: str, engine: str, width: int) -> str:
    """The kind of an evaluation; a step is one of all `width` rollouts at once."""
    return f"rollouts {task} {engine} {width}"
