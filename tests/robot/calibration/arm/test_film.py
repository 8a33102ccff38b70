"""Films: their episodes, and some of their pictures."""

import numpy as np
from boxed_arm import CAMERA, SIDE, film


def test_episodes_and_some_pictures():
    both = film([CAMERA, CAMERA], count=3)
    assert [rows.tolist() for rows in both.by_episode()] == [[0, 1, 2], [3, 4, 5]]
    part = both.some(both.episodes == 1)
    assert part.size == (SIDE, SIDE)
    np.testing.assert_array_equal(part.steps, [0, 1, 2])
    np.testing.assert_array_equal(part.angles, both.angles[3:])
    assert part.masks is None
    assert (part.optics.width, part.optics.height) == (SIDE, SIDE)
