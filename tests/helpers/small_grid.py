"""A grid of four small runs, and what stands in for the commands that make them."""

import importlib.util

import pytest
from places import HELPERS, REPO

FAKE = HELPERS / "fake_jaxcam.py"
GRIDS = REPO / "grids"
SMALL = """
title: small
runs_dir: {folder}/runs
settings: {{preset: laptop, steps: 40, save_every: 10, log_every: 10, eval_every: 10, pairs: 4}}
runs:
  - {{task: lift, conditioning: [none, late], seed: [0, 1]}}
"""
needs_submitit = pytest.mark.skipif(
    importlib.util.find_spec("submitit") is None, reason="submitit is an extra"
)
