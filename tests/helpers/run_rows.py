"""Metrics and evaluation rows of a run, made up."""

import numpy as np

from jaxcam.results.rows import Row


def evaluation(outcomes, **fields):
    """One row a pair, the cameras spread over the sphere patch."""
    angles = np.random.default_rng(0).uniform((-90, 30), (90, 60), (len(outcomes), 2))
    common = {"task": "lift", "seed": 0, "step": 6000, "steps": 80, "distance": 1.0}
    return [
        Row(pair=i, status="ok", success=bool(won), azimuth_deg=az, elevation_deg=el,
            **{**common, **fields})
        for i, (won, (az, el)) in enumerate(zip(outcomes, angles.tolist(), strict=True))
    ]  # fmt: skip


def training(steps=6000):
    rows = [{"step": s, "loss": 30 / s, "seconds": s / 10} for s in range(50, steps + 1, 50)]
    rows += [{"step": s, "val_loss": 40 / s} for s in range(500, steps + 1, 500)]
    return [*rows, {"step": steps, "success_rate": 0.4, "low": 0.3, "high": 0.5, "pairs": 50}]


def texts(axes):
    return [text.get_text() for text in axes.texts]
