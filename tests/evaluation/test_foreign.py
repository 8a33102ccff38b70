"""Somebody else's policy on our pairs, the whole command: rows, causes, page, going on."""

import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from policy_servers import HANG_UP, policy_server
from running import exit_code
from served_runs import serving

import jaxcam.client
from jaxcam.config.commands import EvaluateConfig
from jaxcam.config.foreign import ForeignConfig, ObsMap
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, NoServerError
from jaxcam.evaluation.evaluator import Candidate, Evaluator
from jaxcam.evaluation.foreign import ForeignPolicy, evaluate_foreign, policy_source
from jaxcam.evaluation.mapping import read_map
from jaxcam.evaluation.sources import PolicyServer
from jaxcam.evaluation.terms import names_sent, settled
from jaxcam.models import Policy, PolicySpec
from jaxcam.reports.arms import group
from jaxcam.reports.reading import read_runs
from jaxcam.robot.asked import AskedPolicy
from jaxcam.robot.rig import Rig
from jaxcam.robot.serving import Service
from jaxcam.runs.identity import resolve
from jaxcam.runs.interface import simulated_interface
from jaxcam.runs.rollouts import read_run_rows
from jaxcam.sim.tasks.lift import Lift

HORIZON, WIDTH = 5, 3


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    monkeypatch.setattr(Lift, "horizon", HORIZON)
    monkeypatch.setattr("jaxcam.evaluation.foreign.write_plots", lambda *args: None)


def network(torch):
    """A policy that nobody trained, in PyTorch: from the picture and where the camera is."""
    torch.manual_seed(0)
    layers = torch.nn.Sequential(
        torch.nn.Conv2d(3, 4, 5, 4), torch.nn.Flatten(), torch.nn.LazyLinear(3 * 7)
    )

    @torch.no_grad()
    def act(observation):
        picture = torch.tensor(observation["observation.images.view_0"]).permute(2, 0, 1) / 255
        pose = torch.tensor(observation["camera.view_0.base_from_camera"])
        actions = layers(picture[None]).reshape(3, 7) + pose[:3, 3].mean()
        return 0.01 * actions.numpy()

    return act


def evaluated(policy, folder, **changes):
    foreign = {"policy": policy, "resolution": 16, "run_dir": str(folder), "timeout": 5.0}
    flags = {name: changes.pop(name) for name in list(changes) if name in vars(ForeignConfig())}
    settings = {"pairs": WIDTH, "width": WIDTH, "videos": 0, **changes}
    evaluate_foreign(EvaluateConfig(foreign=ForeignConfig(**foreign | flags), **settings), None)
    return read_run_rows(folder)


def function(monkeypatch, value):
    module = type(sys)("their_policy")
    module.policy = value
    monkeypatch.setitem(sys.modules, "their_policy", module)
    return "their_policy:policy"


def without(rows, *names):
    return [{k: v for k, v in row.to_json().items() if k not in names} for row in rows]


def test_a_server_in_pytorch_and_the_same_in_python_give_the_same_rows(
    tmp_path, monkeypatch, pytorch
):
    policy = network(pytorch)
    with policy_server(policy, {"run": "theirs"}) as address:
        served = evaluated(address, tmp_path / "served")
    local = evaluated(function(monkeypatch, policy), tmp_path / "local", name="theirs")
    apart = ("run", "weights_sha")
    assert without(served, *apart) == without(local, *apart)
    assert [(row.policy, row.conditioning, row.step, row.seed) for row in served[:1]] == [
        ("theirs", "not said", 0, None)
    ]
    assert [row.steps for row in served] == [HORIZON] * WIDTH
    page = (tmp_path / "served" / "report.html").read_text("utf-8")
    assert "theirs on lift, randomized scene" in page
    assert f"--policy</span> <span>{address}" in page
    arms = group(read_runs([tmp_path]))
    # One name, and who was asked is not the same: a report does not take them for one.
    assert [arm.settings["policy"] for arm in arms] == ["theirs"] * 2
    assert arms[0].estimate.n == WIDTH  # what is the same run counts once


def test_failures_are_told_with_their_causes_and_the_rest_counts(tmp_path, capsys):
    asked, folder = [], tmp_path / "theirs[/red]"

    def policy(observation):
        asked.append(observation)
        if len(asked) == 2:
            return np.full((2, 7), np.nan)
        return HANG_UP if len(asked) == 3 else np.zeros((2, 7))

    with policy_server(policy) as address:
        code = exit_code(
            "evaluate", "--policy", address, "--pairs", WIDTH, "--width", WIDTH, "--videos", 0,
            "--resolution", 16, "--name", "theirs", "--run-dir", folder,
        )  # fmt: skip
    assert code == 0
    # 5 steps, 2 at a time; the lost question is asked once more, and then no more.
    assert len(asked) == WIDTH + 1 + 2
    rows = read_run_rows(folder)
    assert [(row.status, row.success) for row in rows] == [
        ("ok", False), ("policy", False), ("policy", False)
    ]  # fmt: skip
    assert [row.cause for row in rows] == [
        None, "actions have nan at step 0, number 0",
        f"The connection to {address} was lost, and made again.",
    ]  # fmt: skip
    shown = " ".join(capsys.readouterr().out.split())
    page = (folder / "report.html").read_text("utf-8")
    for row in rows[1:]:
        assert f"No actions in 1 rollout: {row.cause}" in shown
        assert f"failure: {row.cause}" in page
    assert "2 without actions" in shown


def test_the_same_command_goes_on_and_a_server_that_is_gone_ends_it(tmp_path, monkeypatch, pytorch):
    connections = []

    def failing(*args, **kwargs):
        connections.append(args)
        if len(connections) > 3:  # one that asks who it is, and those of the first batch
            raise ConnectionRefusedError
        return connect(*args, **kwargs)

    monkeypatch.setattr(
        "jaxcam.evaluation.foreign.PolicyServer", partial(PolicyServer, patience=0.1)
    )
    how = {"pairs": 4, "width": 2, "name": "theirs"}
    with policy_server(network(pytorch), {"run": "theirs"}) as address:
        connect = jaxcam.client.connect
        monkeypatch.setattr("jaxcam.client.connect", failing)
        with pytest.raises(NoServerError, match="the same command goes on"):
            evaluated(address, tmp_path / "theirs", **how)
        monkeypatch.setattr("jaxcam.client.connect", connect)
    first = read_run_rows(tmp_path / "theirs")
    assert [row.pair for row in first] == [0, 1]
    with policy_server(network(pytorch), {"run": "theirs"}) as address:  # at another port
        rows = evaluated(address, tmp_path / "theirs", **how)
    assert rows[:2] == first
    assert [row.pair for row in rows] == [0, 1, 2, 3]


def test_rows_of_another_policy_or_way_are_not_mixed(tmp_path, monkeypatch):
    policy = function(monkeypatch, lambda o: np.zeros((2, 7)))
    rows = evaluated(policy, tmp_path / "a", name="a")
    for changes, words in (({"execute": 1}, "execute: None -> 1"), ({"name": "b"}, "name: 'a'")):
        with pytest.raises(ConfigError, match=words):
            evaluated(policy, tmp_path / "a", **{"name": "a", **changes})
    monkeypatch.setattr(sys.modules["their_policy"].policy, "metadata", {"step": 2}, raising=False)
    with pytest.raises(ConfigError, match=r"metadata step: None -> 2.*another --name"):
        evaluated(policy, tmp_path / "a", name="a")
    assert read_run_rows(tmp_path / "a") == rows


def test_a_map_is_obeyed_and_kept(tmp_path, monkeypatch):
    shown = []

    def policy(observation):
        shown.append(observation)
        return {"chunk": np.zeros((2, 8))}

    file = tmp_path / "map.yaml"
    file.write_text(
        "keys: {image: observation.images.view_0, joints: 'observation.state[0:7]'}\n"
        "action_space: joint_delta\nanswer: chunk\nobservation_steps: 2\nresolution: 16x24\n"
    )
    address = function(monkeypatch, policy)
    how = {"name": "a", "obs": str(file), "resolution": None}
    rows = evaluated(address, tmp_path / "a", **how)
    assert [row.status for row in rows] == ["ok"] * WIDTH
    assert {name: value.shape for name, value in shown[0].items()} == {
        "image": (2, 16, 24, 3), "joints": (2, 7)
    }  # fmt: skip
    assert read_map(str(tmp_path / "a" / "obs.yaml")).keys == read_map(str(file)).keys


def test_one_object_cannot_remember_several_episodes(monkeypatch):
    class Remembering:
        def reset(self):
            pass

        def infer(self, observation):
            return np.zeros((1, 7))

    flags = ForeignConfig(policy=function(monkeypatch, Remembering()))
    with pytest.raises(ConfigError, match="has reset"):
        policy_source(flags, 2)
    assert policy_source(flags, 1).remembers


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["--task", "lift"], "--task goes with --policy only"),
        (["run", "--policy", "ws://a"], "runs or --policy, not both"),
        (["--policy", "ws://a", "--protocol", "paper"], "leave out --protocol"),
        (["--policy", "ws://a", "--engine", "mjx-warp"], "use native, or auto"),
        (["--policy", "ws://a", "--step", "3"], "--step is for runs"),
        (["--policy", "ws://a", "--task", "lfit"], "did you mean 'lift'"),
        (["--policy", "a:b", "--key", "x"], "--key is for servers"),
        (["--policy", "ws://a", "--timeout", "0"], "timeout must be"),
        ([], "No run is given. Name one run folder"),
    ],
)
def test_flags_that_do_not_go_together(argv, message, capsys):
    assert exit_code("evaluate", *argv) == 2
    shown = capsys.readouterr()
    assert message in " ".join((shown.out + shown.err).replace("│", " ").split())


def drawing(params, obs, key):
    """A policy that depends on all that it is shown, now and before, and on chance."""
    picture = obs["image"].astype(jnp.float32).mean((1, 2, 3, 4)) / 255  # [B, 3]
    where = obs["proprio"][:, 0, 7:10] - obs["base_from_camera"][:, -1, 0, :3, 3]
    move = 0.01 * (picture + where + obs["K"][:, -1, 0, :1, 2] / 100)
    noise = 0.01 * jax.random.normal(key, (len(move), 3, 7))
    return params["gain"] * (noise + jnp.pad(move, ((0, 0), (0, 4)))[:, None])


def test_a_run_behind_our_server_moves_as_it_does_here_bit_for_bit(tmp_path):
    config = resolve(TrainConfig(resolution=16, seed=3), accelerator=False)
    spec = PolicySpec(7, 11, views=1, height=16, width=16, chunk=4, obs_steps=2)
    policy = Policy(lambda key: {}, lambda *_: (jnp.zeros(()), {}), drawing, None, spec, 2)
    candidate = Candidate(policy, {"gain": jnp.float32(1.0)}, tmp_path / "run", 7)
    evaluator = Evaluator(config, WIDTH, "native")
    asked = AskedPolicy(candidate, config.seed, WIDTH)
    service = Service(config, simulated_interface(config), asked, Rig({}))
    with serving(service) as address:
        flags = ForeignConfig(policy=address)
        source = policy_source(flags, WIDTH)
        record = settled(flags, ObsMap(), source)
        foreign = ForeignPolicy(record, source, names_sent(record, WIDTH), tmp_path / "foreign")
        there, moved = evaluator.run(foreign, "test", [0, 1])
    here, moves = evaluator.run(candidate, "test", [0, 1])
    np.testing.assert_array_equal(moved.qpos[:, :2], moves.qpos[:, :2])
    assert np.ptp(moves.qpos[:, :2], axis=0).max() > 0.01
    assert [(row.success, row.steps) for row in there] == [(row.success, row.steps) for row in here]
    assert source.at_once == WIDTH
