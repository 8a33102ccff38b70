"""ACT's network: its size is the authors', its weights start as PyTorch's."""

import zlib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest
from policy_inputs import (
    jit,
    make,
    shapes,
    tiny,
)

from jaxcam.models import ACT_PRESETS, PolicySpec, make_policy
from jaxcam.models.fusion import scale_images
from jaxcam.models.policy import pure
from jaxcam.models.resnet import ResNet18


def count(tree):
    return sum(x.size for x in jax.tree.leaves(tree))


def test_paper_has_the_parameters_of_the_authors_network():
    spec = PolicySpec(7, 7, 1, 256, 256, 30)
    stats = {f"action_{k}": np.ones(7) for k in ("mean", "std")}
    stats |= {f"proprio_{k}": np.ones(7) for k in ("mean", "std")}
    late = ACT_PRESETS["paper"]
    plain = replace(late, conditioning="none", twin_of="none")
    late, plain = (shapes(make_policy(c, spec, stats)) for c in (late, plain))
    assert count(late["vision"]["image"]) == 11_166_912
    assert count(late["vision"]["rays"]) == 3_926_400
    assert count(late) == 45_169_288
    assert count(plain) == 40_980_744
    assert count(late) - count(plain) == 3_926_400 + 512 * 512
    assert {x.dtype for x in jax.tree.leaves(late)} == {jnp.dtype("float32")}


def test_laptop_is_small():
    spec = PolicySpec(7, 7, 1, 84, 84, 16)
    stats = {f"{a}_{k}": np.ones(7) for a in ("action", "proprio") for k in ("mean", "std")}
    assert count(shapes(make_policy(ACT_PRESETS["laptop"], spec, stats))) < 1_000_000


def test_weights_start_as_in_pytorch():
    policy = make(tiny("paper", "late"))
    params = policy.init(jax.random.key(0))
    head, latent = params["head"], params["latent"]

    def largest(layer):
        return float(jnp.abs(layer["kernel"]).max())

    def near(bound):
        return pytest.approx(bound, rel=0.15)

    assert largest(head["action"]) == near(16**-0.5)  # PyTorch's default.
    attention = head["encoder"]["layers"]["0"]["attention"]
    assert largest(attention["query"]) == near((6 / (4 * 16)) ** 0.5)  # Packed Xavier.
    assert largest(attention["out"]) == near((6 / (2 * 16)) ** 0.5)
    assert largest(latent["encoder"]["layers"]["0"]["attention"]["out"]) == near(16**-0.5)
    convs = params["vision"]["image"]["convs"]
    assert largest(convs["0"]) == near((9 * 8) ** -0.5)
    assert float(head["image_position"].std()) == near(1.0)


GOLDEN = dict(np.load(places.GOLDEN / "act_torch.npz"))
WIDTH = 16


def torch_weight(name, shape):
    """The twin's weight of a name, in PyTorch's layout; the same rule as in the golden script."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + ("norm" in name and name.endswith("weight"))).astype(np.float32)


def from_torch(path, leaf):
    """Our parameter at a path, filled with the twin's."""
    names = [step.key for step in path]
    module, kind = names[:-1], names[-1]
    if module[0] in ("vision", "head"):
        module = module[1:]
    elif module[1] == "encoder":
        module = ["latent_encoder", *module[2:]]
    else:
        module = [f"latent_{module[1]}"]
    module = [name for name in module if name != "feed_forward"]
    if kind in ("image_position", "position", "query"):
        return torch_weight(f"{kind}.weight", leaf.shape)
    suffix = "bias" if kind == "bias" else "weight"
    if module[-1] in ("query", "key", "value"):
        part = ("query", "key", "value").index(module[-1])
        name = ".".join([*module[:-1], f"in_proj_{suffix}"])
        packed = torch_weight(name, (3 * leaf.shape[0], *leaf.shape[1:]))
        return np.split(packed, 3)[part].T
    if module[-1] == "out" and module[-2:-1] != ["latent"] and "attention" in module[-2]:
        module[-1] = "out_proj"
    name = ".".join([*module, suffix])
    if kind != "kernel":
        return torch_weight(name, leaf.shape)
    if leaf.ndim == 4:  # OIHW to HWIO.
        height, width, d_in, d_out = leaf.shape
        return torch_weight(name, (d_out, d_in, height, width)).transpose(2, 3, 1, 0)
    if name == "mix.weight":  # A 1×1 convolution there; the same numbers.
        return torch_weight(name, (*leaf.shape[::-1], 1, 1))[..., 0, 0].T
    return torch_weight(name, leaf.shape[::-1]).T


@pytest.fixture(scope="module")
def policy():
    config = replace(
        ACT_PRESETS["paper"],
        encoder_width=WIDTH,
        width=WIDTH,
        heads=2,
        hidden=24,
        layers=2,
        latent_layers=2,
        latent_dim=4,
        chunk=6,
    )
    return make_policy(config, PolicySpec(3, 5, 2, 64, 64, 6), GOLDEN)


@pytest.fixture(scope="module")
def params(policy):
    shapes = jax.eval_shape(policy.init, jax.random.key(0))
    return jax.tree_util.tree_map_with_path(from_torch, shapes)


def test_image_trunk_equals_the_torch_twin(policy, params):
    _, network = pure(lambda rngs: ResNet18(3, "identity", rngs=rngs, dtype=np.float32))
    trunk = network(params["vision"]["image"])
    features = jit(trunk)(scale_images(policy.config, GOLDEN["image"][:1, 0]))
    expected = GOLDEN["out_features"].transpose(1, 2, 0)
    np.testing.assert_allclose(features[0, ..., :64], expected, rtol=1e-4, atol=1e-5)


def test_actions_equal_the_torch_twin(policy, params):
    actions = jit(policy.act)(params, GOLDEN, None)
    np.testing.assert_allclose(actions, GOLDEN["out_action"], rtol=1e-4, atol=2e-5)


def test_loss_equals_the_torch_twin(policy, params):
    _, metrics = jit(policy.loss)(params, GOLDEN, None)
    for name in ("l1", "kl", "loss"):
        assert float(metrics[name]) == pytest.approx(float(GOLDEN[f"out_{name}"]), rel=1e-4)
