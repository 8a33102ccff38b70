"""Write `prope.npz`: what the reference code of PRoPE computes on random inputs.

Run where the authors' `prope/jax.py` (github.com/liruilong940607/prope) lies; it is not kept:

    PROPE_REFERENCE=path/to/prope/jax.py python tests/golden/make_prope.py

Inputs are drawn again by the test from their seed (`inputs`), and are not stored.
"""

import importlib.util
import os
from pathlib import Path

import jax
import numpy as np

BATCH, VIEWS, ROWS, COLUMNS, HEADS, CHANNELS = 2, 3, 3, 4, 2, 16
HEIGHT, WIDTH = 96, 160


def inputs(seed: int = 0) -> dict[str, np.ndarray]:
    """Queries, keys, values, poses and intrinsics of random cameras."""
    rng = np.random.default_rng(seed)
    shape = (BATCH, VIEWS * ROWS * COLUMNS, HEADS, CHANNELS)
    turn, _ = np.linalg.qr(rng.normal(size=(BATCH, VIEWS, 3, 3)))
    turn *= np.sign(np.linalg.det(turn))[..., None, None]
    poses = np.tile(np.eye(4), (BATCH, VIEWS, 1, 1))
    poses[..., :3, :3], poses[..., :3, 3] = turn, rng.uniform(-1, 1, (BATCH, VIEWS, 3))
    K = np.tile(np.eye(3), (BATCH, VIEWS, 1, 1))
    K[..., 0, 0], K[..., 1, 1] = rng.uniform(90, 200, (2, BATCH, VIEWS))
    K[..., 0, 2], K[..., 1, 2] = rng.uniform(60, 100, (BATCH, VIEWS)), rng.uniform(40, 60)
    made = {name: rng.normal(size=shape) for name in "qkv"}
    made |= {"base_from_camera": poses, "K": K}
    return {name: values.astype(np.float32) for name, values in made.items()}


def reference(path: str) -> dict[str, np.ndarray]:
    """Outputs of attention by the code at a path, with K (prope) and without (gta)."""
    spec = importlib.util.spec_from_file_location("prope_reference", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = inputs()
    views = np.linalg.inv(made["base_from_camera"].astype(np.float64)).astype(np.float32)
    sizes = {"patches_x": COLUMNS, "patches_y": ROWS, "image_width": WIDTH, "image_height": HEIGHT}
    with jax.default_matmul_precision("highest"):
        return {
            name: np.asarray(
                module.prope_dot_product_attention(
                    *(made[n] for n in "qkv"), viewmats=views, Ks=K, **sizes
                )
            )
            for name, K in (("prope", made["K"]), ("gta", None))
        }


if __name__ == "__main__":
    np.savez_compressed(
        Path(__file__).with_name("prope.npz"), **reference(os.environ["PROPE_REFERENCE"])
    )
