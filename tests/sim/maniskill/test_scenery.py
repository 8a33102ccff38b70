"""What is drawn of robots looks as before, with fewer triangles."""

import numpy as np
import pytest


@pytest.fixture
def sapien(maniskill):
    import sapien

    return sapien


def ball(sapien, scale):
    import trimesh

    one = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    vertices, triangles = np.float32(one.vertices), np.uint32(one.faces)
    shape = sapien.render.RenderShapeTriangleMesh(
        vertices, triangles, vertices, vertices[:, :2], sapien.render.RenderMaterial()
    )
    shape.scale, shape.front_face, shape.name = scale, "clockwise", "ball"
    return shape


def lightened(sapien, *shapes, **settings):
    from jaxcam.sim.maniskill.scenery import lighten

    body, entity = sapien.render.RenderBodyComponent(), sapien.Entity()
    for shape in shapes:
        body.attach(shape)
    for name, value in settings.items():
        setattr(body, name, value)
    body.disable_render_id()
    entity.add_component(body)
    lighten(entity)
    return entity, entity.find_component_by_type(sapien.render.RenderBodyComponent)


def size(body):
    return np.ptp(body.compute_global_aabb_tight(), axis=0)


def test_a_scaled_mesh_keeps_its_size_and_its_side(sapien):
    _entity, body = lightened(sapien, ball(sapien, [2, 3, 0.5]), name="hand", visibility=0.5)
    (shape,) = body.render_shapes
    assert len(shape.parts[0].triangles) < 0.15 * 5120
    np.testing.assert_allclose(size(body), [0.4, 0.6, 0.1], rtol=0.02)
    assert (shape.front_face, shape.name) == ("clockwise", "ball")
    assert (body.name, body.visibility, body.is_render_id_disabled) == ("hand", 0.5, True)


def test_a_body_that_is_not_drawn_stays_so(sapien):
    body, entity = sapien.render.RenderBodyComponent(), sapien.Entity()
    body.attach(ball(sapien, [1, 1, 1]))
    body.disable()
    entity.add_component(body)
    from jaxcam.sim.maniskill.scenery import lighten

    lighten(entity)
    assert not entity.find_component_by_type(sapien.render.RenderBodyComponent).is_enabled


def test_boxes_and_balls_stay_what_they_are(sapien):
    """As the hands of some robots are; their parts are of a box of one metre."""
    render = sapien.render
    material = render.RenderMaterial()
    for shape, expected in (
        (render.RenderShapeBox([0.1, 0.2, 0.3], material), [0.2, 0.4, 0.6]),
        (render.RenderShapeSphere(0.3, material), [0.6, 0.6, 0.6]),
        (render.RenderShapeCylinder(0.1, 0.3, material), [0.6, 0.2, 0.2]),
    ):
        _entity, body = lightened(sapien, shape)
        assert [type(s) for s in body.render_shapes] == [type(shape)]
        np.testing.assert_allclose(size(body), expected, rtol=0.02)


def test_any_texture_keeps_its_places(sapien):
    shape = ball(sapien, [1, 1, 1])
    shape.parts[0].material.normal_texture = sapien.render.RenderTexture2D(
        np.zeros((4, 4, 4), np.uint8), "R8G8B8A8Unorm"
    )
    _entity, body = lightened(sapien, shape)
    (drawn,) = body.render_shapes
    np.testing.assert_array_equal(drawn.parts[0].get_vertex_uv(), shape.parts[0].get_vertex_uv())
