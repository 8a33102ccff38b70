"""Bodies of MuJoCo's worlds."""

import mujoco
import numpy as np
import pytest
import trimesh

from jaxcam.rays import invert
from jaxcam.sim.tasks.square import Square
from jaxcam.viewer import bodies as bodies_module
from jaxcam.viewer.bodies import COARSE, bodies_of, grip_places


@pytest.fixture(scope="module")
def moved(lift, scene):
    """Lift's start, then the arm elsewhere and the cube in the air."""
    start = lift.start(scene, 3)
    qpos = np.tile(start.qpos, (2, 1))
    qpos[1, scene.arm] += 0.2
    qpos[1, scene.qpos_of("cube") : scene.qpos_of("cube") + 3] = 0.1, -0.1, 1.1
    return start, qpos, bodies_of(scene, lift.varied, qpos, start)


def test_bodies_are_where_physics_has_them(moved, scene):
    _, qpos, bodies = moved
    data = mujoco.MjData(scene.physics)
    for t, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(scene.physics, data)
        for name in ("robot0_link7", "gripper0_right_leftfinger", "cube_main"):
            (pose, *_) = [b.base_from_body for b in bodies if b.name.startswith(f"{name} ")]
            place = invert(scene.world_from_base) @ np.array([*data.body(name).xpos, 1])
            np.testing.assert_allclose(pose[t, :3, 3], place[:3], atol=1e-6)
            rotation = data.body(name).xmat.reshape(3, 3)
            expected = np.asarray(scene.world_from_base)[:3, :3].T @ rotation
            np.testing.assert_allclose(pose[t, :3, :3], expected, atol=1e-6)


def test_a_varied_object_has_its_size_and_what_stands_has_one_pose(moved, scene):
    start, _, bodies = moved
    (cube,) = [b for b in bodies if b.name.startswith("cube_main ")]
    np.testing.assert_allclose(np.ptp(cube.vertices, axis=0) / 2, start.geom_size[0], atol=1e-6)
    (table,) = [b for b in bodies if b.name.startswith("table ")]
    assert table.base_from_body.shape == (4, 4)
    assert not any(b.name.startswith(("room", "world")) for b in bodies)


def test_meshes_are_coarse_and_keep_their_shape(moved, scene):
    _, _, bodies = moved
    model = scene.visual
    triangles = sum(len(b.faces) for b in bodies)
    assert 5_000 < triangles < 0.6 * model.mesh_facenum.sum()
    link = model.body("robot0_link1").id
    (geom,) = np.flatnonzero(model.geom_bodyid == link)
    vertices, faces = bodies_module._stored(model, int(model.geom_dataid[geom]))
    fine, coarse = trimesh.Trimesh(vertices, faces), bodies_module._coarse(vertices, faces)
    np.testing.assert_allclose(fine.bounds, coarse.bounds, atol=COARSE)
    assert coarse.area == pytest.approx(fine.area, rel=0.03)


def test_triangles_of_coarse_meshes_face_outwards(moved):
    for body in moved[2]:
        if body.name.startswith(("cube_main", "robot0_link7")):
            mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
            assert mesh.volume > 0


def test_the_grip_is_where_the_task_measures_it(demos):
    demo = demos.episodes[0]
    places = grip_places(demos.world, demo.qpos[::10])
    np.testing.assert_allclose(places, demo.eef_pos[::10], atol=1e-5)


def test_all_kinds_of_shapes_have_a_surface():
    """The peg is a cylinder; what the models have not is made here."""
    world = Square().scene("fixed")
    start = Square().start(world, 0)
    peg = [b for b in bodies_of(world, (), start.qpos[None], start) if b.name.startswith("peg")]
    assert len(peg) == 1
    kinds = {"box": (1, 2, 3), "sphere": (1,), "ellipsoid": (1, 2, 3), "cylinder": (1, 2),
             "capsule": (1, 2)}  # fmt: skip
    extents = {"box": (2, 4, 6), "sphere": (2, 2, 2), "ellipsoid": (2, 4, 6),
               "cylinder": (2, 2, 4), "capsule": (2, 2, 6)}  # fmt: skip
    for kind, size in kinds.items():
        text = f'<geom type="{kind}" size="{" ".join(map(str, size))}"/>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
        mesh = bodies_module._mesh(model, 0, model.geom_size[0])
        np.testing.assert_allclose(mesh.extents, extents[kind], rtol=0.02)
        np.testing.assert_allclose(mesh.bounds.sum(0), 0, atol=1e-6)
