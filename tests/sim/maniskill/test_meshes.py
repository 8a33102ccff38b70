"""Fewer triangles look like many."""

import numpy as np
import pytest


@pytest.fixture
def meshes(maniskill):
    from jaxcam.sim.maniskill import meshes

    return meshes


def sheet(meshes, height):
    """20 x 30 squares of a decimetre, and where they are in a texture."""
    y, x = np.meshgrid(np.arange(31) / 10, np.arange(21) / 10, indexing="ij")
    xyz = np.stack([x, y, height(x, y)], -1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(30)[:, None] * 21 + np.arange(20)).reshape(-1, 1)
    triangles = (first + np.array([0, 1, 22, 0, 22, 21])).reshape(-1, 3)
    normals = np.tile(np.float32([0, 0, 1]), (len(xyz), 1))
    return meshes.Mesh(xyz, triangles, normals, xyz[:, :2] * np.float32([4, 5]) + 1)


def test_a_floor_has_two_triangles_and_its_texture(meshes):
    floor = sheet(meshes, lambda x, y: 0.5 + 0 * x)
    light = meshes.fewer(floor, has_texture=True)
    assert len(light.triangles) == 2
    assert sorted(map(tuple, light.vertices.tolist())) == [(0, 0, 0.5), (0, 3, 0.5), (2, 0, 0.5),
                                                           (2, 3, 0.5)]  # fmt: skip
    np.testing.assert_allclose(light.uvs, light.vertices[:, :2] * [4, 5] + 1, atol=1e-5)
    sides = np.diff(light.vertices[light.triangles], axis=1)
    np.testing.assert_allclose(np.cross(sides[:, 0], sides[:, 1]), [[0, 0, 6]] * 2, atol=1e-5)


def test_a_floor_is_seen_from_the_side_that_it_was_seen_from(meshes):
    floor = sheet(meshes, lambda x, y: 0 * x)
    light = meshes.fewer(floor._replace(triangles=floor.triangles[:, ::-1]), has_texture=True)
    assert len(light.triangles) == 2
    sides = np.diff(light.vertices[light.triangles], axis=1)
    np.testing.assert_allclose(np.cross(sides[:, 0], sides[:, 1]), [[0, 0, -6]] * 2, atol=1e-5)
    half = np.tile(floor.triangles[:600], (2, 1))
    for triangles in (half, half[:0], np.r_[half[:600], floor.triangles[600:, ::-1]]):
        other = floor._replace(triangles=triangles)
        assert meshes.fewer(other, has_texture=True) is other


def test_triangles_that_overlap_or_are_lit_as_if_bent_are_no_rectangle(meshes):
    square = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    up = np.tile(np.float32([0, 0, 1]), (4, 1))
    half_twice = meshes.Mesh(square, np.array([[0, 1, 2], [0, 1, 3]]), up, square[:, :2])
    bent = half_twice._replace(triangles=np.array([[0, 1, 2], [0, 2, 3]]), normals=square + 0.1)
    for other in (half_twice, bent):
        assert meshes.fewer(other, has_texture=True) is other


def test_what_has_a_texture_a_hole_or_few_triangles_stays(meshes):
    bumpy = sheet(meshes, lambda x, y: np.sin(9 * x) * y)
    assert meshes.fewer(bumpy, has_texture=True) is bumpy
    small = bumpy._replace(triangles=bumpy.triangles[:300])
    assert meshes.fewer(small, has_texture=False) is small
    flat = sheet(meshes, lambda x, y: 0 * x)
    for other in (
        flat._replace(triangles=np.delete(flat.triangles, [300, 301], 0)),
        flat._replace(uvs=flat.uvs**2),
    ):
        assert meshes.fewer(other, has_texture=True) is other


def test_a_body_keeps_its_shape_its_round_side_and_its_edge(meshes):
    """A dome whose triangles have their corners for themselves, as those of ManiSkill's robot."""
    import trimesh

    from jaxcam.sim.maniskill import studio

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    dome = np.maximum(ball.vertices, [-1, -1, -0.03])[ball.faces].reshape(-1, 3).astype(np.float32)
    triangles = np.arange(len(dome)).reshape(-1, 3)
    light = meshes.fewer(meshes.Mesh(dome, triangles, dome, dome[:, :2]), has_texture=False)
    assert 0.05 < len(light.triangles) / len(triangles) < 0.15
    # Other numbers mean other pictures: give `LIGHT` of the studio, their name, another one too.
    sum_of_all = round(float(abs(light.vertices).sum()), 1)
    assert (studio.LIGHT, len(light.triangles), sum_of_all) == (2, 512, 42.9)
    radius, above = np.linalg.norm(light.vertices, axis=1), light.vertices[:, 2] + 0.03
    assert max(radius.max() - 0.1, -above.min()) < 1e-3
    assert np.minimum(abs(radius - 0.1), above).max() < 1e-3
    # Normals point away from the middle or down, also where both meet.
    is_down = light.normals[:, 2] < -0.95
    assert is_down.sum() > 20
    assert above[is_down].max() < 1e-3
    away = (light.normals * light.vertices).sum(1) / radius
    assert away[~is_down].min() > 0.95


def test_an_open_shell_that_would_change_stays(meshes):
    """As parts of ManiSkill's wrist, of which a disc went and whose holes were closed."""
    y, x = np.meshgrid(np.arange(41) / 40, np.arange(41) / 40, indexing="ij")
    discs = [np.stack([x + 2 * i, y, 0.3 * np.sin(40 * x) * np.sin(40 * y)], -1) for i in range(3)]
    vertices = np.concatenate([d.reshape(-1, 3) for d in discs]).astype(np.float32)
    first = (np.arange(40)[:, None] * 41 + np.arange(40)).reshape(-1, 1)
    one = (first + np.array([0, 1, 42, 0, 42, 41])).reshape(-1, 3)
    triangles = np.concatenate([one + 1681 * i for i in range(3)])
    shell = meshes.Mesh(vertices, triangles, vertices, vertices[:, :2])
    assert meshes.fewer(shell, has_texture=False) is shell
