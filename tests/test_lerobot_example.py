"""The server of LeRobot's policies, with another policy in LeRobot's place."""

import importlib.util

import numpy as np
import pytest
from places import REPO
from policy_servers import socket_server

from jaxcam.client import Client
from jaxcam.errors import RefusedError

VIEWS = ["observation.images.view_0", "observation.images.view_1"]


@pytest.fixture(scope="module")
def example(pytorch):
    """The script, as a module."""
    file = REPO / "examples/lerobot_policy/serve.py"
    spec = importlib.util.spec_from_file_location("lerobot_policy_serve", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def observation(*steps):
    rng = np.random.default_rng(0)
    return {
        "observation.state": rng.random((*steps, 11), np.float32),
        **{name: rng.integers(0, 256, (*steps, 16, 24, 3), np.uint8) for name in VIEWS},
        "camera.view_0.intrinsics": np.eye(3, dtype=np.float32),
        "prompt": "Lift the cube",
    }


@pytest.mark.parametrize("steps", [(), (2,)])
def test_observations_become_lerobots_batches(example, steps):
    obs = observation(*steps)
    batch = example.as_batch(obs, VIEWS)
    assert sorted(batch) == [*VIEWS, "observation.state"]
    assert batch[VIEWS[1]].shape == (1, *steps, 3, 16, 24)
    picture = batch[VIEWS[1]][0].movedim(-3, -1).numpy()
    np.testing.assert_allclose(picture * 255, obs[VIEWS[1]], atol=1e-4)
    np.testing.assert_array_equal(batch["observation.state"][0], obs["observation.state"])


def test_it_answers_and_goes_on_after_an_error(example, pytorch):
    def infer(obs):
        batch = example.as_batch(obs, VIEWS)
        return pytorch.ones(8, 7).mul(batch["observation.state"].sum()).numpy()

    with socket_server(example.handler_of(infer, {"policy": "act"})) as url, Client(url) as client:
        assert client.metadata == {"policy": "act"}
        with pytest.raises(RefusedError, match=r"KeyError: 'observation\.images\.view_0'"):
            client.infer({"observation.state": np.zeros(11)})
        actions = client.infer(observation())["actions"]
    assert actions.shape == (8, 7)
    np.testing.assert_allclose(actions, observation()["observation.state"].sum(), rtol=1e-6)
    assert client.reconnects == 0
