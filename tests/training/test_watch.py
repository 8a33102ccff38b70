"""Gradients that explode while they are finite."""

import logging
import math

from jaxcam.training.watch import EXPLODED, GradientWatch


def warned(caplog, norms):
    watch = GradientWatch(seed=3)
    with caplog.at_level(logging.WARNING):
        for step, norm in enumerate(norms):
            watch.look({"step": step, "grad_norm": norm})
    return caplog.text


def test_a_norm_far_above_the_usual_is_warned_of_with_its_seed_and_step(caplog):
    text = warned(caplog, [1, 2, 2, 2, 3, 2 * EXPLODED + 1, 2])
    assert "Seed 3: around update 5" in text
    assert "the usual 2" in text
    assert text.count("around update") == 1


def test_what_is_usual_takes_five_updates_and_no_number_that_is_none(caplog):
    assert warned(caplog, [1, 1, 1, 1, 1e6]) == ""
    assert warned(caplog, [1] * 5 + [math.nan, math.inf, float(EXPLODED)]).count("update 6") == 1
