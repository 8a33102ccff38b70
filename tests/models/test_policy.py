"""Policies as functions of dicts of arrays."""

import jax
from policy_inputs import (
    make,
    shapes,
    tiny,
)


def test_parameters_are_nested_dicts_with_string_keys():
    params = shapes(make(tiny("paper", "late")))
    for path, _ in jax.tree_util.tree_flatten_with_path(params)[0]:
        assert all(isinstance(step, jax.tree_util.DictKey) for step in path)
        assert all(isinstance(step.key, str) for step in path)
