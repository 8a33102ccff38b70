"""Which samples a run takes: a pure function of its seed and step."""

import numpy as np
import pytest

from jaxcam.data.batches import make_dataset
from jaxcam.data.samples import Layout, Samples
from jaxcam.errors import DatasetError


@pytest.fixture(scope="module")
def dataset(demos, pictures, scene):
    return make_dataset(demos, pictures, "eef_delta", scene)


def test_index_is_a_function_of_seed_and_step(dataset):
    later = [dataset.samples.index(0, step, 3, 2) for step in range(6)]
    for step in (5, 0, 3):
        for a, b in zip(dataset.samples.index(0, step, 3, 2), later[step], strict=True):
            np.testing.assert_array_equal(a, b)
    index = dataset.samples.index
    others = [np.concatenate([index(s, k, 3, 2)[1] for k in range(6)]) for s in (0, 1)]
    assert (others[0] != others[1]).any()


@pytest.mark.parametrize("batch", [1, 3, 4, 11])
def test_every_epoch_takes_each_demonstration_once(dataset, batch):
    order = np.concatenate([dataset.samples.index(0, step, batch, 1)[0] for step in range(44)])
    epochs = order[: len(order) // 4 * 4].reshape(-1, 4)
    assert (np.sort(epochs, 1) == np.arange(4)).all()
    assert len({tuple(e) for e in epochs}) > 5
    # The batch size only cuts the same sequence elsewhere.
    np.testing.assert_array_equal(order[:44], _sequence(dataset, 44))


def _sequence(dataset, count):
    return np.concatenate([dataset.samples.index(0, step, 1, 1)[0] for step in range(count)])


def test_time_steps_are_inside_and_cover_the_demonstration(dataset):
    demo, t, _ = (np.concatenate(x) for x in zip(
        *(dataset.samples.index(0, s, 40, 1) for s in range(60)), strict=True
    ))  # fmt: skip
    assert (t >= 0).all()
    assert (t < dataset.lengths[demo]).all()
    for i in range(4):
        assert len(np.unique(t[demo == i])) > 0.95 * dataset.lengths[i]


def test_views_of_a_sample_are_distinct_and_from_its_window(dataset):
    _, _, views = dataset.samples.index(0, 0, 200, 2)
    assert (views[:, 0] != views[:, 1]).all()
    assert set(views.ravel()) == {0, 1, 2}


def samples(cameras, train):
    return Samples(Layout(np.arange(10, 10 + len(cameras)), np.array(cameras)), train)


def test_no_sample_of_training_begins_at_an_error():
    layout, errors = Layout(np.array([4, 3, 5]), np.array([1, 1, 1])), np.zeros((3, 5), bool)
    errors[0, 1:3] = errors[1, 0] = True  # the last one is for validation
    some = Samples(layout, train=2, errors=errors)
    demo, t, _ = some.index(seed=0, step=0, batch=400, views=1)
    assert set(zip(demo.tolist(), t.tolist(), strict=True)) == {(0, 0), (0, 3), (1, 1), (1, 2)}
    share = np.mean(t[demo == 0] == 3)
    assert share == pytest.approx(0.5, abs=0.15)
    wanted = some.wanted([0], steps=1, batch=400, views=1, obs_steps=1)
    assert wanted is None or not wanted[[1, 2, 4]].any()
    none = Samples(layout, train=2, errors=np.zeros((3, 5), bool)).index(0, 0, 400, 1)
    for a, b in zip(none, Samples(layout, train=2).index(0, 0, 400, 1), strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_sample_of_validation_begins_at_an_error():
    layout, errors = Layout(np.array([4, 9]), np.array([1, 1])), np.zeros((2, 9), bool)
    errors[1, 2:6] = True
    demos, t, _ = Samples(layout, train=1, errors=errors).validation(views=1, per_demo=5)
    assert demos.tolist() == [1] * 5
    assert t.tolist() == [0, 1, 6, 7, 8]
    _, usual, _ = Samples(layout, train=1).validation(views=1, per_demo=5)
    assert usual.tolist() == [0, 2, 4, 6, 8]


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
