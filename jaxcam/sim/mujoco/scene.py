"""Arena, robot and objects from robosuite's models, as a physics and a visual MjModel.

robosuite's model classes write the MJCF (arena, Panda, gripper, objects) and its assets stay in its
package; nothing of robosuite runs at simulation time. From that one MJCF two models are made:

* physics: only what carries mass or collides with an object or the table (fingers, pads, hand,
  objects, table, floor), meshes of objects by hulls of a few vertices;
* visual: only what is seen, with the table and the room (floor, walls) as mocap bodies, so that a
  scene can move them against the robot from plain arrays.

Both have the same joints in the same order, so one `qpos` serves both.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import mujoco
import numpy as np

from jaxcam.sim.controllers import JOINT_LAG
from jaxcam.sim.mujoco.mjcf import TABLE_SIZE, assemble
from jaxcam.sim.mujoco.objects import Object
from jaxcam.sim.mujoco.table import TABLE_TOP, TableTask
from jaxcam.sim.simulators import SimulatorName
from jaxcam.sim.world import World, scene_name

SHEET_HALF_SIZE = 1.0
"""Half-size (m) of the wide table top of the randomised scene: it reaches under the robot wherever
the draw puts it, so its edges tell nothing of the robot's pose."""
WORLD_MEMORY = 2**24
"""Bytes that a world's data reserves for contacts and scratch. robosuite's models ask for 1.3 GB
and use a few hundred kB: a batch of worlds would not fit where memory cannot be promised."""
FIXTURES = ("table", "room")
"""Mocap bodies of the visual model, in the order of `fixtures` arrays."""
GRIP_SITE = "gripper0_right_grip_site"
_COLLIDES = ("table_collision", "floor", "gripper0_right_")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene(World):
    """One task's world in MuJoCo: the two models and where the robot is in their arrays."""

    simulator: ClassVar[SimulatorName] = "mujoco"
    table_top: ClassVar[float] = TABLE_TOP
    table_middle: ClassVar[float] = TABLE_TOP - TABLE_SIZE[2] / 2
    base_from_grip: ClassVar[np.ndarray] = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])

    physics: mujoco.MjModel
    """Slim model that engines step."""
    visual: mujoco.MjModel
    """Model that the renderer draws; one camera, table and room as mocap bodies."""
    grip_site: int
    """Site that the controllers move: between the finger tips."""
    fixtures: np.ndarray = field(repr=False)
    """Indices of table, room and markers among the visual model's mocap bodies."""
    joint_lag: float = JOINT_LAG

    def qpos_of(self, body: str) -> int:
        """Address in qpos of the free joint (xyz, wxyz) of an object's body."""
        return int(self.physics.joint(f"{body}_joint0").qposadr[0])

    def size_of(self, geom: str) -> np.ndarray:
        """Usual size (m) [3] of a geom of the physics model; `<geom>_vis` is drawn."""
        return self.physics.geom(geom).size


def scene_of(task: TableTask, name: str) -> Scene:
    """A task's world; made once a process, see `build_scene`."""
    return _scene_of(type(task), name)


@functools.cache
def _scene_of(task: type[TableTask], name: str) -> Scene:
    return build_scene(task().objects(), name, task.markers, task.hulls)


def build_scene(
    objects: Sequence[Object],
    name: str,
    markers: Sequence[str] = (),
    hulls: Mapping[str, np.ndarray] | None = None,
) -> Scene:
    """Puts objects on robosuite's table before its Panda.

    Args:
        objects: What stands on the table.
        name: `fixed` shows robosuite's table and room where they stand; `randomized` shows a wide
            table top and a floor, to be moved per episode (paper, section IV-A; the authors'
            `LiftRand` shows a visual sheet and hides the real table).
        markers: Names of the objects, made without joints, that are seen and never touched; they
            become mocap bodies of the visual model.
        hulls: Corners (m) [n, 3] of the convex hulls that geoms collide with, by the geom's name;
            masses and inertias stay the objects' own.

    Returns:
        The scene with both models compiled.

    Raises:
        ConfigError: If there is no such scene.
    """
    known_name = scene_name(name)
    xml, home = assemble(objects, TABLE_TOP)
    full = mujoco.MjModel.from_xml_string(xml)
    names = tuple(o.name for o in objects if o.name not in markers)
    physics = _physics_model(xml, full, names, markers, hulls or {})
    visual = _visual_model(xml, full, name, markers)
    data = mujoco.MjData(physics)
    mujoco.mj_kinematics(physics, data)
    world_from_base = np.eye(4)
    world_from_base[:3, 3] = data.body("robot0_base").xpos
    world_from_base[:3, :3] = data.body("robot0_base").xmat.reshape(3, 3)
    joints = [f"robot0_joint{i}" for i in range(1, 8)]
    fingers = [f"gripper0_right_finger_joint{i}" for i in (1, 2)]
    return Scene(
        physics=physics,
        visual=visual,
        name=known_name,
        nq=physics.nq,
        nv=physics.nv,
        qpos0=physics.qpos0.copy(),
        arm=np.array([physics.joint(j).qposadr[0] for j in joints]),
        fingers=np.array([physics.joint(j).qposadr[0] for j in fingers]),
        grip_site=int(physics.site(GRIP_SITE).id),
        home=home,
        fixtures=np.array(
            [int(visual.body(b).mocapid[0]) for b in (*FIXTURES, *(f"{m}_main" for m in markers))]
        ),
        world_from_base=world_from_base,
    )


def _physics_model(
    xml: str,
    full: mujoco.MjModel,
    objects: Sequence[str],
    markers: Sequence[str],
    hulls: Mapping[str, np.ndarray],
) -> mujoco.MjModel:
    """Keeps colliders of gripper, objects, table and floor, and the full model's inertias."""
    spec = _open(xml, full)
    for marker in markers:
        spec.delete(spec.body(f"{marker}_main"))
    for geom in list(spec.geoms):
        keep = geom.name.startswith((*_COLLIDES, *(f"{o}_" for o in objects)))
        if not keep or (geom.contype == 0 and geom.conaffinity == 0):
            spec.delete(geom)
    for name, corners in hulls.items():
        spec.add_mesh(name=f"{name}_hull", uservert=corners.ravel())
        spec.geom(name).meshname = f"{name}_hull"
    hand = spec.geom("gripper0_right_hand_collision")
    hand.type = mujoco.mjtGeom.mjGEOM_BOX  # fitted to the mesh: eight vertices, not a hundred
    for group in (spec.sensors, spec.cameras, spec.lights, spec.excludes):
        for element in list(group):
            spec.delete(element)
    _drop_unused_assets(spec)
    spec.memory = WORLD_MEMORY
    return spec.compile()


def _visual_model(
    xml: str, full: mujoco.MjModel, name: str, markers: Sequence[str]
) -> mujoco.MjModel:
    spec = _open(xml, full)
    hidden = ("wall_", "table_leg") if name == "randomized" else ()
    for geom in list(spec.geoms):
        if geom.group != 1 or geom.name.startswith(hidden):
            spec.delete(geom)
    for group in (spec.sensors, spec.cameras, spec.lights, spec.actuators, spec.sites):
        for element in list(group):
            spec.delete(element)
    _paint(spec, name)
    for fixture in ("table", *(f"{marker}_main" for marker in markers)):
        spec.body(fixture).mocap = True
    room = spec.worldbody.add_body(name="room", mocap=True)
    for geom in list(spec.worldbody.geoms):
        room.add_geom(
            name=f"room_{geom.name}",
            type=geom.type,
            size=geom.size if geom.type != mujoco.mjtGeom.mjGEOM_PLANE else [0, 0, 1],  # endless
            pos=geom.pos,
            quat=geom.quat,
            material=geom.material,
            group=1,
            contype=0,
            conaffinity=0,
        )
        spec.delete(geom)
    _light(room)
    # Pose and intrinsics come from arrays; a sensor size switches MuJoCo to intrinsics.
    spec.worldbody.add_camera(name="camera", sensor_size=[1, 1], focal_length=[1, 1])
    _drop_unused_assets(spec)
    return spec.compile()


def _open(xml: str, full: mujoco.MjModel) -> mujoco.MjSpec:
    """Reads the MJCF with its compiled inertias written in: deleting geoms then changes no mass."""
    spec = mujoco.MjSpec.from_string(xml)
    for marker in ("left_eef_target", "right_eef_target"):
        spec.delete(spec.body(marker))
    for body in spec.bodies[1:]:
        compiled = full.body(body.name)
        if compiled.mass[0] > 0:
            body.mass, body.inertia = compiled.mass[0], compiled.inertia
            body.ipos, body.iquat = compiled.ipos, compiled.iquat
            body.explicitinertial = True
    return spec


def _paint(spec: mujoco.MjSpec, name: str) -> None:
    """Even materials: the ray tracer has no mip-maps, and fine textures turn to speckle."""
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        width=256,
        height=256,
        rgb1=[0.52, 0.47, 0.42],
        rgb2=[0.60, 0.55, 0.50],
    )
    floor = spec.material("floorplane")
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    floor.texrepeat, floor.texuniform = [1.5, 1.5], True
    colours = {
        "table_ceramic": [0.80, 0.78, 0.74, 1] if name == "randomized" else [0.72, 0.60, 0.47, 1],
        "walls_mat": [0.62, 0.66, 0.70, 1],
        "table_legs_metal": [0.45, 0.46, 0.48, 1],
        "can_coke": [0.78, 0.10, 0.12, 1],
        "nut_bmetal": [0.86, 0.60, 0.16, 1],
    }
    for material in spec.materials:
        if material.name in colours:
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = ""
            material.rgba = colours[material.name]
    spec.visual.headlight.ambient = [0.28, 0.28, 0.28]  # with the lights: no clipped whites
    spec.visual.headlight.diffuse = [0.12, 0.12, 0.12]
    spec.visual.headlight.specular = [0, 0, 0]
    for material in spec.materials:
        material.reflectance = 0
        material.specular, material.shininess = 0.2, 0.3
    if name == "randomized":
        top = spec.geom("table_visual")
        top.size = [SHEET_HALF_SIZE, SHEET_HALF_SIZE, top.size[2]]


def _light(room: mujoco.MjsBody) -> None:
    """A key and a fill light, far away, that turn with the room: shadows tell nothing either."""
    for direction, diffuse in (((-0.35, -0.45, -1.0), 0.50), ((0.55, 0.35, -0.8), 0.18)):
        room.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            dir=direction,
            pos=[0, 0, 4],
            diffuse=[diffuse] * 3,
            specular=[0.15] * 3,
            castshadow=diffuse > 0.3,
        )


def _drop_unused_assets(spec: mujoco.MjSpec) -> None:
    meshes = {g.meshname for g in spec.geoms}
    materials = {g.material for g in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in meshes:
            spec.delete(mesh)
    for material in list(spec.materials):
        if material.name not in materials:
            spec.delete(material)
    textures = {t for m in spec.materials for t in m.textures if t}
    for texture in list(spec.textures):
        if texture.name not in textures:
            spec.delete(texture)
