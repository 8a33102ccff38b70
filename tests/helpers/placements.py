"""Where a task has put its objects."""


def place_of(scene, start, name):
    at = scene.qpos_of(name)
    return start.qpos[..., at : at + 3]


def assert_fills(values, half):
    assert abs(values).max() <= half
    assert values.min() < -0.95 * half
    assert values.max() > 0.95 * half
