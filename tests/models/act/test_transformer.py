"""The transformer of ACT: its table of positions."""

import numpy as np

from jaxcam.models.act.transformer import sine_table


def test_sine_table_matches_the_golden_values():
    table = sine_table(32, 512)
    expected = [0.84147098, 0.54030231, 0.82185619, 0.56969501, 0.8019618, 0.59737533]
    np.testing.assert_allclose(table[1, :6], expected, atol=1e-6)
    np.testing.assert_allclose(table[1, -2:], [1.03663e-4, 0.99999999], rtol=1e-4)
