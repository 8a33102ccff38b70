"""What MJX needs of a scene's model: fewer pairs of geoms, fields that differ between worlds."""

import copy
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from mujoco.mjx._src import collision_driver

from jaxcam.errors import ConfigError
from jaxcam.rays.rotations import Array
from jaxcam.sim.mujoco.bodies import box_inertia

Bodies = dict[str, jax.Array]
"""Fields of the model that differ between worlds [B, ...]."""


def resized(model: mujoco.MjModel, geoms: Sequence[int], sizes: Array) -> Bodies:
    """Fields of the model that follow from boxes' half-sizes, for each world.

    As MuJoCo's compiler and `mj_setConst` derive them for a free body of uniform density.

    Args:
        model: In which the boxes have their usual sizes.
        geoms: The boxes; none give no fields.
        sizes: Half-sizes (m) [B, v, 3].
    """
    if not geoms:
        return {}
    count = len(sizes)
    names = ("geom_size", "geom_rbound", "geom_aabb", "body_mass", "body_inertia")
    names += ("body_subtreemass", "body_invweight0", "dof_invweight0")
    field = {n: jnp.asarray(getattr(model, n), jnp.float32) for n in names}
    field = {n: jnp.tile(x, (count, *[1] * x.ndim)) for n, x in field.items()}

    def put(name: str, where: Any, value: jax.Array) -> None:
        field[name] = field[name].at[:, *where].set(value)

    for i, geom in enumerate(geoms):
        half = jnp.asarray(sizes, jnp.float32)[:, i]
        body, mass, inertia = box_inertia(model, geom, half)
        dof = int(model.body_dofadr[body])
        slow, spin = 1 / mass, (1 / inertia).mean(-1)
        put("geom_size", (geom,), half)
        put("geom_rbound", (geom,), jnp.linalg.norm(half, axis=-1))
        put("geom_aabb", (geom, slice(3, 6)), half)
        put("body_mass", (body,), mass)
        put("body_subtreemass", (body,), mass)
        put("body_inertia", (body,), inertia)
        put("body_invweight0", (body,), jnp.stack([slow, spin], -1))
        put("dof_invweight0", (slice(dof, dof + 3),), slow[:, None])
        put("dof_invweight0", (slice(dof + 3, dof + 6),), spin[:, None])
    return field


def filtered(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model in which the floor meets nothing but free bodies.

    The gripper cannot reach the floor, and every pair of geoms costs MJX time whether they touch or
    not: MJX-JAX computes all of them, always.
    """
    model = copy.copy(model)
    free = model.body_dofnum[model.body_rootid] == 6
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    lowest = 1 << 16  # a bit of contype and conaffinity that robosuite leaves alone
    model.geom_contype[planes], model.geom_conaffinity[planes] = lowest, 0
    model.geom_conaffinity[free[model.geom_bodyid]] |= lowest
    return model


def suit_warp(model: mujoco.MjModel) -> None:
    """Sets what MuJoCo Warp should do as the C library does, and what is fast on a CPU.

    Without native convex collisions it computes boxes' contacts by the C library's own method. By
    the other, in float32, an edge on a face often has one contact, where it should have two.
    """
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    if jax.default_backend() == "cpu":
        # Contacts concern few of the joints: one thread gains by leaving the zeros out.
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE


def check_pairs(model: mujoco.MjModel) -> None:
    """Refuses pairs of geoms that MJX-JAX cannot collide, all at once and by name."""
    bad = [
        (model.geom(a).name, model.geom(b).name)
        for a, b, _ in collision_driver.geom_pairs(model)
        if not collision_driver.has_collision_fn(model.geom_type[a], model.geom_type[b])
    ]
    if bad:
        pairs = ", ".join(f"{a} with {b}" for a, b in bad)
        raise ConfigError(
            f"Engine mjx-jax cannot collide {pairs}. Engines that can: mjx-warp, native."
        )


def bare(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model without contacts and constraints."""
    model = copy.copy(model)
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    return model


def pair_count(model: mujoco.MjModel) -> int:
    """Number of pairs of geoms that may meet."""
    return len(list(collision_driver.geom_pairs(model)))
