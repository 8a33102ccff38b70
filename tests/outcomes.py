"""Rows of made-up outcomes, for tests of statistics."""

import functools

import numpy as np

from jaxcam.results.rows import Row


@functools.cache
def row_of(pair, seed, success, **fields):
    """Simulations ask for the same rows hundreds of times."""
    return Row(pair=pair, seed=seed, success=success, status="ok", **fields)


def rows_of(outcomes, **fields):
    """Finished rows; outcomes[pair, seed]."""
    return [
        row_of(pair, seed, bool(value), **fields)
        for pair, of_pair in enumerate(np.atleast_2d(outcomes))
        for seed, value in enumerate(of_pair)
    ]


def column(outcomes, **fields):
    """One row a pair."""
    return rows_of(np.asarray(outcomes)[:, None], **fields)
