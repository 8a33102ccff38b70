"""SmolVLA against LeRobot's modules; see `golden/make_smolvla_torch.py`."""

import json
import zlib
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import places
import pytest
from policy_inputs import jit, shapes

from jaxcam.models import make_policy
from jaxcam.models.policy import PolicySpec, pure
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS
from jaxcam.models.smolvla.flow import integrate, line
from jaxcam.models.smolvla.network import SmolVla
from jaxcam.models.smolvla.policy import make_smolvla, velocity_loss
from jaxcam.models.weights.load import Weights, load
from jaxcam.models.weights.names import name_map_of

GOLDEN = dict(np.load(places.GOLDEN / "smolvla_torch.npz"))
RAYS = "model.vlm_with_expert.fusion."
SIZES = {
    "chunk": 6,
    "tokens": (3, 7, 1),
    "image_size": 128,
    "patch": 16,
    "vision_width": 32,
    "vision_layers": 1,
    "vision_heads": 2,
    "vision_hidden": 40,
    "vocabulary": 11,
    "width": 48,
    "layers": 2,
    "heads": 6,
    "kv_heads": 2,
    "head_dim": 8,
    "hidden": 56,
    "expert_width": 36,
    "expert_hidden": 256,
    "state_width": 8,
    "remat": False,
}


def torch_weight(name, shape):
    """The golden script's weight of a name."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + ("norm" in name and name.endswith("weight"))).astype(np.float32)


def fusion_weight(path, leaf):
    """A weight of the ray fusion, which LeRobot does not have."""
    *module, kind = (step.key for step in path)
    if module[0] != "fusion":
        return leaf
    name = ".".join(module[1:]).replace("rays.convs", "convs").replace("project", "out")
    if kind == "bias":
        return torch_weight(f"{RAYS}{name}.bias", leaf.shape)
    name = f"{RAYS}{name}.weight"
    if leaf.ndim == 4:
        height, width, d_in, d_out = leaf.shape
        return torch_weight(name, (d_out, d_in, height, width)).transpose(2, 3, 1, 0)
    extra = (1, 1) if "out" in name else ()
    return torch_weight(name, (*leaf.shape[::-1], *extra)).reshape(leaf.shape[::-1]).T


class Case:
    """One form of the policy with the golden script's weights, inputs and outputs."""

    def __init__(self, preset):
        changes = SIZES | ({"action_width": 8} if preset == "lerobot" else {})
        cells = 12 if preset == "lerobot" else 8
        self.config = replace(SMOLVLA_PRESETS[preset], **changes)
        spec = PolicySpec(3, 5, 2, 8 * cells, 8 * cells, 6)
        self.policy = make_smolvla(self.config, spec, GOLDEN)
        names = json.loads(str(GOLDEN[f"{preset}_shapes"]))
        arrays = {n: torch_weight(n, s) for n, s in names.items() if not n.startswith(RAYS)}
        weights = Weights(Path("golden"), arrays, name_map_of(list(arrays)), "")
        self.params = load(weights, shapes(self.policy))
        self.params = jax.tree_util.tree_map_with_path(fusion_weight, self.params)
        images = GOLDEN["coarse"][:, :, :cells, :cells].repeat(8, 2).repeat(8, 3)
        self.obs = {k: GOLDEN[k] for k in ("K", "base_from_camera", "proprio")} | {"image": images}
        network = pure(lambda rngs: SmolVla(self.config, spec, rngs=rngs))[1]
        self.width = self.config.actions(spec)
        self.out = {k.removeprefix(f"{preset}_"): v for k, v in GOLDEN.items()}

        def run(params):
            net = network(params)
            proprio = jnp.zeros((2, 5)) if self.config.drop_proprio else GOLDEN["proprio"]
            state = (proprio - GOLDEN["proprio_mean"]) / GOLDEN["proprio_std"]
            prefix = net.prefix(self.obs, jnp.pad(state, ((0, 0), (0, 3))))
            noise = jnp.asarray(GOLDEN["noise"][..., : self.width])
            x, target = line(self.actions(), noise, GOLDEN["time"])
            velocity = net.velocity(prefix, x, GOLDEN["time"])
            sample = integrate(lambda x, t: net.velocity(prefix, x, t), noise, self.config.steps)
            return velocity, target, sample

        self.velocity, self.target, self.sample = jit(run)(self.params)

    def actions(self):
        action = (GOLDEN["action"] - GOLDEN["action_mean"]) / GOLDEN["action_std"]
        return np.pad(action, ((0, 0), (0, 0), (0, self.width - 3)))


@pytest.fixture(scope="module", params=["lerobot", "paper"])
def case(request):
    return Case(request.param)


def assert_same(got, expected):
    """Equal to 1e-4 of the largest number."""
    assert np.abs(got - expected).max() < 1e-4 * np.abs(expected).max()


def test_velocity(case):
    # The paper hides padded actions from each other, and here they do not matter: they come last.
    real = ~GOLDEN["is_pad"] if case.config.padding == "valid" else np.ones((2, 6), bool)
    assert_same(case.velocity[real], case.out["velocity"][real])


def test_whole_sample(case):
    assert_same(case.sample, case.out["sample"])


def test_actions_of_the_policy_from_no_noise(case):
    assert_same(jit(case.policy.act)(case.params, case.obs, None), case.out["still"])


def test_loss_with_padding(case):
    # Not everything counted in the paper's form: there padded actions are hidden from attention.
    rules = {"loss_valid": "valid"}
    if case.config.padding == "counted":
        rules["loss_all"] = "counted"
    for name, rule in rules.items():
        config = replace(case.config, padding=rule)
        loss = velocity_loss(config, case.velocity, case.target, GOLDEN["is_pad"], 3)
        assert float(loss) == pytest.approx(float(case.out[name]), rel=1e-4)


def test_paper_size_is_that_of_the_published_model():
    config = replace(SMOLVLA_PRESETS["lerobot"], tokens=(1,))
    spec = PolicySpec(7, 8, 1, 256, 256, 50)
    stats = {f"action_{k}": np.ones(7) for k in ("mean", "std")}
    stats |= {f"proprio_{k}": np.ones(8) for k in ("mean", "std")}
    parts = shapes(make_policy(config, spec, stats))
    count = {k: sum(x.size for x in jax.tree.leaves(v)) for k, v in parts.items()}
    # Published with a head over words and a last norm, which nothing here asks for.
    assert sum(count.values()) + 49280 * 960 + 960 == pytest.approx(450.05e6, abs=5e3)
    assert count["vision"] == pytest.approx(86.43e6, abs=5e3)
    assert count["connector"] == 12288 * 960
