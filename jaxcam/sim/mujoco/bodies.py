"""What both engines derive of a scene's model."""

import mujoco
import numpy as np

from jaxcam.rays.rotations import Array


def box_inertia(model: mujoco.MjModel, geom: int, half: Array) -> tuple[int, Array, Array]:
    """What a box of other size weighs, its density being that of the model.

    Args:
        model: In which the box has its usual size, alone on its body.
        geom: The box.
        half: Half-sizes (m) [B, 3].

    Returns:
        Its body, masses (kg) [B] and principal inertias (kg m²) [B, 3].
    """
    body = int(model.geom_bodyid[geom])
    density = model.body_mass[body] / (8 * model.geom_size[geom].prod())
    mass, squared = 8 * half.prod(-1) * density, half**2
    return body, mass, mass[:, None] / 3 * (squared.sum(-1, keepdims=True) - squared)


def full_from_sparse(model: mujoco.MjModel) -> np.ndarray:
    """Where the entries of the full inertia matrix [nv, nv] are in the sparse one.

    Zeros of the matrix point anywhere: all joints of an arm move each other.
    """
    data, full = mujoco.MjData(model), np.empty((model.nv, model.nv))
    data.M[:] = np.arange(len(data.M))
    mujoco.mj_fullM(model, data, full)
    return full.astype(int)
