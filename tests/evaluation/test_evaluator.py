"""The evaluator itself, on Lift: what its rows say, what its videos and pictures show."""

import copy
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxcam.config.conditions import Conditions
from jaxcam.config.train import TrainConfig
from jaxcam.data.pairs import make_pairs
from jaxcam.evaluation.evaluator import VIDEO_PIXELS, Candidate, Evaluator
from jaxcam.models import Policy, PolicySpec
from jaxcam.rays import Camera
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.rays.lens import pack
from jaxcam.results.rows import Row
from jaxcam.results.stats import success_rate
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_painter
from jaxcam.sim.observing import observe
from jaxcam.sim.rollout import Rollouts
from jaxcam.sim.types import View

PIXELS, CHUNK, HORIZON, WIDTH = 24, 3, 5, 3


@pytest.fixture(scope="module")
def evaluator():
    """Of episodes of five steps."""
    config = resolve(TrainConfig(resolution=PIXELS, seed=4), accelerator=False)
    evaluator = Evaluator(config, WIDTH, "native")
    evaluator.task.horizon = HORIZON  # pyright: ignore
    return evaluator


@pytest.fixture
def candidate(tmp_path):
    """A policy that moves as its one parameter says."""
    spec = PolicySpec(7, 9, views=1, height=PIXELS, width=PIXELS, chunk=CHUNK)

    def act(params, obs, key):
        return jnp.zeros((len(obs["image"]), CHUNK, 7)) + params["move"]

    policy = Policy(lambda key: {}, lambda *_: (jnp.zeros(()), {}), act, None, spec, CHUNK)
    return Candidate(policy, {"move": jnp.float32(0.0)}, tmp_path / "a run", 40)


def test_a_row_says_what_was_run(evaluator, candidate):
    ticks = []
    rows, done = evaluator.run(candidate, "validation", [5, 2], lambda: ticks.append(1))
    expected = make_pairs(evaluator.task, evaluator.scene, 1, "validation", [5, 2])
    assert [row.pair for row in rows] == [5, 2]
    assert [row.pair_sha for row in rows] == expected.digests()
    assert [row.episode_seed for row in rows] == expected.seeds
    np.testing.assert_allclose([row.camera for row in rows], expected.cameras, rtol=1e-6)
    for row, pose in zip(rows, expected.cameras[:, 0], strict=True):
        away = pose[:3, 3] - np.array(evaluator.task.cameras.centre)
        distance = np.linalg.norm(away)
        assert row.distance == pytest.approx(distance, abs=1e-5)
        assert row.elevation_deg == pytest.approx(np.rad2deg(np.arcsin(away[2] / distance)), 1e-4)
        assert row.azimuth_deg == pytest.approx(np.rad2deg(np.arctan2(away[1], away[0])), 1e-4)
    said = Row(
        task="lift", scene="randomized", run="a run", policy="act", conditioning="keypoints",
        seed=4, step=40, split="validation", pair=5, success=False, status="ok", steps=HORIZON,
        weights_sha=candidate.weights_sha, renderer=evaluator.renderer.look(), engine="native",
        ensemble=0.0, width=WIDTH,
    )  # fmt: skip
    measured = ("pair_sha", "camera", "distance", "elevation_deg", "azimuth_deg", "episode_seed")
    assert replace(rows[0], **dict.fromkeys(measured)) == said
    assert len(ticks) == HORIZON
    assert done.qpos.shape[:2] == (HORIZON + 1, WIDTH)
    assert Row.from_json(rows[0].to_json()) == rows[0]


def test_actions_that_are_no_numbers_end_in_an_error(evaluator, candidate):
    broken = replace(candidate, params={"move": jnp.float32(np.nan)})
    rows, _ = evaluator.run(broken, "test", [0])
    assert [(row.status, row.success) for row in rows] == [("policy", False)]
    assert (success_rate(rows).n, success_rate(rows).broken) == (1, 1)


@pytest.mark.parametrize("number", [np.inf, -1e30])
def test_numbers_that_no_simulator_bears_are_the_policys_failure(evaluator, candidate, number):
    rows, _ = evaluator.run(replace(candidate, params={"move": jnp.float32(number)}), "test", [0])
    assert [row.status for row in rows] == ["policy"]


@pytest.mark.parametrize("shape", [(WIDTH, CHUNK, 6), (WIDTH, 0, 7), (WIDTH + 1, CHUNK, 7), (3,)])
def test_actions_of_another_shape_are_the_policys_failure(evaluator, candidate, shape):
    odd = replace(candidate.policy, act=lambda params, obs, key: jnp.zeros(shape))
    rows, _ = evaluator.run(replace(candidate, policy=odd), "test", [0])
    assert [(row.status, row.success) for row in rows] == [("policy", False)]


def test_a_simulator_that_fails_leaves_no_outcome(evaluator, candidate, monkeypatch):
    step = evaluator.engine.step

    def failing(state, command, active=None):
        return step(state, command, active)._replace(ok=np.zeros(len(state.ok), bool))

    monkeypatch.setattr(evaluator.engine, "step", failing)
    rows, _ = evaluator.run(candidate, "test", [0])
    assert [(row.status, row.success) for row in rows] == [("simulator", None)]
    assert success_rate(rows).excluded == 1


def test_rows_say_whose_weights_acted(evaluator, candidate):
    rows, _ = evaluator.run(candidate, "test", [0])
    again, _ = evaluator.run(replace(candidate, params={"move": jnp.float32(0.0)}), "test", [0])
    other, _ = evaluator.run(replace(candidate, params={"move": jnp.float32(1e-6)}), "test", [0])
    assert rows[0].weights_sha == again[0].weights_sha != other[0].weights_sha


@pytest.mark.parametrize(
    ("rotations", "space"), [("nominal", "eef_abs"), ("world", "eef_abs_world")]
)
def test_actions_are_read_as_the_run_learned_them(
    evaluator, candidate, monkeypatch, rotations, space
):
    """A run of version 0.1.0 has `rotations` world."""
    agents = []

    def stop(agent, *rest):
        agents.append(agent)
        raise StopIteration

    monkeypatch.setattr("jaxcam.evaluation.evaluator.rollout", stop)
    other = copy.copy(evaluator)
    other.config = replace(evaluator.config, action_space="eef_abs", rotations=rotations)
    with pytest.raises(StopIteration):
        other.run(candidate, "test", [0])
    assert [agent.space for agent in agents] == [space]


def test_the_settings_of_an_evaluation_come_before_those_of_the_run(evaluator):
    config = replace(evaluator.config, ensemble=0.2)
    assert Evaluator(config, WIDTH, "native").ensemble == 0.2
    assert Evaluator(config, WIDTH, "native", ensemble=0.0).ensemble == 0.0


def clips(evaluator, pairs):
    """Of episodes in which nothing moves."""
    qpos = np.asarray(evaluator.pairs("test", pairs).start.qpos)
    still = np.tile(qpos, (HORIZON + 1, 1, 1))
    nothing, steps = np.zeros(len(pairs), bool), np.full(len(pairs), HORIZON)
    return evaluator.clips(Rollouts(nothing, steps, ~nothing, still, ~nothing), "test", pairs)


def test_each_clip_is_seen_by_the_camera_of_its_pair(evaluator):
    both, (alone,) = clips(evaluator, [0, 1]), clips(evaluator, [1])
    assert both[0].shape == (HORIZON // 2 + 1, VIDEO_PIXELS, VIDEO_PIXELS, 3)
    np.testing.assert_array_equal(both[1], alone)
    assert np.mean(np.abs(both[0].astype(int) - both[1])) > 5


def under(evaluator, conditions, **settings):
    """The evaluator of the same episodes under conditions."""
    config = replace(evaluator.config, **settings)
    return Evaluator(config, WIDTH, "native", conditions=conditions)


def test_a_clip_is_seen_through_the_lens_that_the_policy_sees_through(evaluator):
    """And with its field of view: the picture is what a painter draws of such a camera."""
    (clip,) = clips(under(evaluator, Conditions(fovy="70", lens="opencv:-0.2")), [1])
    _, cameras, start = evaluator.pairs("test", [1])
    painter = make_painter(evaluator.scene, VIDEO_PIXELS, varied=evaluator.task.varied, lenses=True)
    K = intrinsics(70, VIDEO_PIXELS)[None]
    lens = np.asarray(pack(np.array([[-0.2, 0, 0, 0]])))
    view = View(start.qpos, start.geom_size, start.fixtures, K, cameras[:, 0], lens)
    np.testing.assert_array_equal(clip[0], painter.rgb(view)[0])


@pytest.mark.parametrize(
    "settings",
    [{"ray_frame": "base"}, {"ray_frame": "grip"}, {"rays_from": "nominal"}],
)
def test_under_conditions_a_sight_is_what_a_policy_is_told(
    evaluator, candidate, monkeypatch, settings
):
    """Lens, error of the pose, frame of the rays: all that comes to a policy, and nothing else."""
    conditions = Conditions(pose_noise="3,5", fovy="25:70", lens="opencv:-0.3:-0.1")
    other, shown = under(evaluator, conditions, **settings), []

    def first(*args):
        shown.append(observe(*args))
        raise StopIteration

    monkeypatch.setattr("jaxcam.sim.rollout.observe", first)
    with pytest.raises(StopIteration):
        other.run(candidate, "test", [3])
    picture, rays = other.sight("test", 3)
    (obs,) = shown
    np.testing.assert_array_equal(picture, obs["image"][0, 0])
    assert ("distortion" in obs) == ("rays_from" not in settings)
    lens = obs["distortion"][0, 0] if "distortion" in obs else None
    camera = Camera(obs["K"][0, 0], obs["base_from_camera"][0, 0], PIXELS, PIXELS, lens)
    np.testing.assert_allclose(rays, camera.plucker(), atol=1e-6)


def test_the_rays_that_are_shown_are_those_that_a_policy_gets(evaluator):
    picture, rays = evaluator.sight("test", 3)
    assert picture.shape == (PIXELS, PIXELS, 3)
    assert np.ptp(picture) > 50
    pose = evaluator.pairs("test", [3]).cameras[0, 0].astype(np.float64)
    base_from_camera = np.linalg.inv(evaluator.scene.world_from_base) @ pose
    focal = PIXELS / 2 / np.tan(np.deg2rad(evaluator.task.fovy_deg) / 2)
    for row, column in ((0, 0), (7, 20)):
        ray = np.array([column + 0.5 - PIXELS / 2, row + 0.5 - PIXELS / 2, focal])
        direction = base_from_camera[:3, :3] @ (ray / np.linalg.norm(ray))
        moment = np.cross(base_from_camera[:3, 3], direction)
        np.testing.assert_allclose(rays[row, column], [*direction, *moment], atol=1e-5)
    assert np.abs(evaluator.scene.world_from_base - np.eye(4)).max() > 0.1  # another frame
