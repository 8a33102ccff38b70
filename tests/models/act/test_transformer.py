"""The transformer of ACT: its table of positions."""

import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxcam.models.act.transformer import Decoder, Encoder, LayerSizes, sine_table
from jaxcam.models.token_frames import TokenFrames, camera_projections
from jaxcam.rays.rotations import matrix_from_rotvec


def test_sine_table_matches_the_golden_values():
    table = sine_table(32, 512)
    expected = [0.84147098, 0.54030231, 0.82185619, 0.56969501, 0.8019618, 0.59737533]
    np.testing.assert_allclose(table[1, :6], expected, atol=1e-6)
    np.testing.assert_allclose(table[1, -2:], [1.03663e-4, 0.99999999], rtol=1e-4)


def test_frames_reach_every_attention_but_that_of_the_queries_among_themselves():
    """Tokens of pictures see each other as before where all cameras move; queries do not."""
    sizes, rngs = LayerSizes(16, 2, 24, 0.0, pre_norm=True), nnx.Rngs(0)
    encoder = Encoder(2, sizes, xavier=True, rngs=rngs, dtype=jnp.float32)
    decoder = Decoder(sizes, rngs=rngs, dtype=jnp.float32)
    rng = np.random.default_rng(0)
    x = jnp.asarray(rng.normal(size=(1, 6, 16)), jnp.float32)
    query = jnp.asarray(rng.normal(size=(3, 16)), jnp.float32)

    def read(*motions):
        poses = np.tile(np.eye(4, dtype=np.float32), (1, 2, 1, 1))
        poses[0, 1, :3, 3] = 0.3, 0.1, 0.5
        poses = np.stack(motions) @ poses
        framing = TokenFrames(6, camera_projections(None, poses, 1, 1))
        memory = encoder(x, jnp.zeros(16), key=None, framing=framing)
        return memory, decoder(query, memory, jnp.zeros(16), key=None, framing=framing)

    still, motion = np.eye(4, dtype=np.float32), np.eye(4, dtype=np.float32)
    motion[:3, :3], motion[:3, 3] = matrix_from_rotvec(np.array([0.5, 0.2, -1])), (0.2, 1, -0.4)
    here, together, apart = read(still, still), read(motion, motion), read(motion, still)
    np.testing.assert_allclose(together[0], here[0], atol=1e-5)
    assert np.abs(together[1] - here[1]).max() > 0.01
    assert np.abs(apart[0] - here[0]).max() > 0.01
