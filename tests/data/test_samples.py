"""Samples of demonstrations that are not all seen by as many cameras."""

import numpy as np
import pytest

from jaxcam.data.samples import Layout, Samples
from jaxcam.errors import DatasetError


def samples(cameras, train):
    return Samples(Layout(np.arange(10, 10 + len(cameras)), np.array(cameras)), train)


def test_validation_shows_each_demonstration_by_its_own_cameras():
    some = samples([3, 3, 1, 2, 3], train=2)
    demos, t, cameras = some.validation(views=2, per_demo=4)
    np.testing.assert_array_equal(demos, np.repeat([2, 3, 4], 4))
    np.testing.assert_array_equal(cameras, np.repeat([[0, 0], [0, 1], [0, 1]], 4, 0))
    pictures = some.layout.at(demos[:, None], t[:, None], cameras)
    np.testing.assert_array_equal(some.layout.owner(pictures), np.stack([demos, demos], -1))


def test_demonstrations_that_too_few_cameras_see_are_not_trained_on():
    some = samples([3, 1, 2, 1], train=3)
    some.check_views(1)
    with pytest.raises(DatasetError, match=r"demo_1 .* by 1 of the 2 cameras .*; 1 of 3 demon"):
        some.check_views(2)
