"""Trees hold every triangle once, inside of all boxes above it, and divide well."""

import numpy as np
import pytest

from jaxcam.sim.mujoco.tracer.hierarchy import LEAF, plant


def walk(trees, node, inside, leaves):
    """Collects the triangles below a node, with the boxes that hold them; the greatest depth."""
    deepest = 0
    for side in range(2):
        box, child = trees.boxes[node, side], trees.children[node, side]
        if child >= 0:
            deepest = max(deepest, walk(trees, child, [*inside, box], leaves))
        else:
            first, count = divmod(-1 - int(child), 8)
            assert count <= LEAF
            leaves += [(i, [*inside, box]) for i in range(first, first + count)]
    return 1 + deepest


@pytest.mark.parametrize("counts", [[1], [3, 1, 700], [4, 5, 64]])
def test_every_triangle_is_in_one_leaf_and_its_boxes(counts):
    rng = np.random.default_rng(len(counts))
    size = sum(counts)
    corners = rng.normal(size=(size, 1, 3)) + rng.normal(scale=0.1, size=(size, 3, 3))
    corners = corners.astype(np.float32)
    trees = plant(corners, np.array(counts))
    assert sorted(trees.order) == list(range(size))
    begin = 0
    for root, count in zip(trees.roots, counts, strict=True):
        leaves = []
        depth = walk(trees, root, [], leaves)
        assert depth <= 3 + 2 * np.log2(count)
        places = [place for place, _ in leaves]
        assert sorted(places) == list(range(begin, begin + count))
        for place, boxes in leaves:
            assert begin <= trees.order[place] < begin + count
            for lower, upper in boxes:
                assert (lower <= corners[trees.order[place]]).all()
                assert (upper >= corners[trees.order[place]]).all()
        begin += count


def test_triangles_in_one_place_end_in_leaves_too():
    corners = np.zeros((100, 3, 3), np.float32)
    leaves = []
    walk(trees := plant(corners, np.array([100])), trees.roots[0], [], leaves)
    assert len(leaves) == 100
