"""ACT and Diffusion Policy against the public PyTorch networks, through our weight converter.

See `golden/make_act_public.py` and `golden/make_diffusion_torch.py`.
"""

import json
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from places import GOLDEN
from policy_inputs import jit, shapes

from jaxcam.models import ACT_PRESETS, PolicySpec, make_policy
from jaxcam.models.diffusion.config import DIFFUSION_PRESETS
from jaxcam.models.diffusion.network import Diffusion
from jaxcam.models.diffusion.samplers import add_noise, cosine_alphas
from jaxcam.models.policy import pure
from jaxcam.models.weights.load import Weights, load
from jaxcam.models.weights.names import name_map_of

CASES = ("paper", "lerobot", "original")


def golden(file, case):
    arrays = np.load(GOLDEN / file)
    return {k.split("/")[1]: arrays[k] for k in arrays.files if k.startswith(f"{case}/")}


def weight(name, shape):
    """The network's array of a name; the same rule as in the golden script."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if name.endswith("running_var"):
        return (1 + 0.5 * np.abs(values)).astype(np.float32)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + name.endswith("weight")).astype(np.float32)


def converted(names, prefix, params):
    """Our parameters, from a checkpoint of a network with these names and shapes."""
    arrays = {prefix + n: weight(n, tuple(s)) for n, s in json.loads(str(names)).items()}
    return load(Weights(Path("golden.safetensors"), arrays, name_map_of(list(arrays)), ""), params)


def assert_close(ours, theirs, tolerance=1e-4):
    """Within a relative error of the largest value, which is what a float32 sum can promise."""
    error = np.abs(np.asarray(ours) - theirs).max() / np.abs(theirs).max()
    assert error < tolerance, error


@cache
def diffusion(case, **changes):
    """A preset with a narrow U-Net, its parameters and the golden arrays."""
    given = golden("diffusion_torch.npz", case)
    sizes = {"chunk": 8, "execute": 0, "channels": (16, 32), "sample_steps": 10}
    config = replace(DIFFUSION_PRESETS[case], **sizes | changes)
    size = given["image"].shape[-2]
    spec = PolicySpec(3, 5, 2, size, size, 8, config.obs_steps)
    stats = given | {"action_mean": np.zeros(3), "proprio_mean": np.zeros(5)}
    policy = make_policy(config, spec, stats)
    return policy, converted(given.pop("names"), "diffusion.", shapes(policy)), given


def as_batch(policy, given):
    """The golden observation; a policy of one step has no axis for steps."""
    if policy.spec.obs_steps > 1:
        return given
    observed = ("image", "K", "base_from_camera", "proprio")
    return given | {k: given[k][:, 0] for k in observed}


@pytest.fixture
def draws(monkeypatch):
    """Makes the policy draw what the golden script did."""

    def use(*normals, t=None):
        waiting = list(normals)
        monkeypatch.setattr(jax.random, "normal", lambda key, shape: waiting.pop(0).reshape(shape))
        monkeypatch.setattr(jax.random, "randint", lambda key, shape, low, high: jnp.asarray(t))

    return use


@pytest.mark.parametrize("case", ["paper", "lerobot"])
def test_noise_prediction_of_diffusion_policy(case):
    policy, params, given = diffusion(case)
    _, network = pure(lambda rngs: Diffusion(policy.config, policy.spec, rngs=rngs))
    obs = {k: given[k] for k in ("image", "K", "base_from_camera")}
    raw = {"action": given["action"], "proprio": given["proprio"]}
    if case == "paper":  # drops proprioception, and pads by zeros
        raw = {"action": np.where(given["is_pad"][..., None], 0, raw["action"]), "proprio": 0}
    action, proprio = (
        np.broadcast_to((2 * raw[k] - high - low) / (high - low), given[k].shape).copy()
        for k in raw
        for high, low in [(given[f"{k}_max"], given[f"{k}_min"])]
    )
    if case == "lerobot":
        action[1, 5:] = action[1, 4]
    noisy = add_noise(cosine_alphas(100), jnp.asarray(action), given["noise"], given["t"])
    net = network(params)
    features = jit(net.condition)(obs, jnp.asarray(proprio))
    assert_close(features[0], given["out_condition"])
    assert_close(jit(net.unet)(noisy, given["t"], *features), given["out_predicted"])


@pytest.mark.parametrize(("case", "padding"), [
    ("paper", "sample"), ("lerobot", "counted"), ("lerobot", "zeroed"),
    ("original", "counted"),
])  # fmt: skip
def test_loss_of_diffusion_policy(case, padding, draws):
    policy, params, given = diffusion(case, padding=padding)
    draws(given["noise"], t=given["t"])
    _, metrics = jit(policy.loss)(params, as_batch(policy, given), None)
    assert_close(metrics["mse"], given[f"out_loss_{padding}"])


@pytest.mark.parametrize("sampler", ["ddpm", "ddim"])
@pytest.mark.parametrize("case", CASES)
def test_ten_steps_of_sampling(case, sampler, draws):
    policy, params, given = diffusion(case, sampler=sampler)
    draws(given["noise"], given["fresh"])
    actions = jit(policy.act)(params, as_batch(policy, given), jax.random.key(0))
    assert_close(actions, given[f"out_{sampler}"])


@cache
def act(case, **changes):
    """A preset with a narrow transformer, its parameters and the golden arrays."""
    given = golden("act_public.npz", case)
    sizes = {"chunk": 6, "width": 16, "encoder_width": 16, "heads": 2, "hidden": 24, "layers": 2}
    sizes |= {"latent_layers": 2, "latent_dim": 4 if case == "lerobot" else 32}
    config = replace(ACT_PRESETS[case], **sizes | changes)
    spec = PolicySpec(given["action"].shape[-1], given["proprio"].shape[-1], 2, 64, 64, 6)
    policy = make_policy(config, spec, given)
    names = given.pop("names")
    batch = given | {"K": np.tile(np.eye(3, dtype=np.float32), (2, 2, 1, 1))}
    batch["base_from_camera"] = np.tile(np.eye(4, dtype=np.float32), (2, 2, 1, 1))
    return policy, converted(names, "model.", shapes(policy)), batch


@pytest.mark.parametrize("case", ["lerobot", "original"])
def test_action_chunk_of_act(case):
    policy, params, batch = act(case)
    assert_close(jit(policy.act)(params, batch, None), batch["out_action"])


@pytest.mark.parametrize(("case", "padding"), [("lerobot", "zeroed"), ("lerobot", "valid"),
                                               ("original", "zeroed")])  # fmt: skip
def test_loss_of_act(case, padding):
    policy, params, batch = act(case, padding=padding)
    loss, metrics = jit(policy.loss)(params, batch, None)
    assert_close(metrics["l1"], batch[f"out_l1_{padding}"])
    assert_close(metrics["kl"], batch["out_kl"])
    assert_close(loss, batch[f"out_l1_{padding}"] + 10 * batch["out_kl"])
