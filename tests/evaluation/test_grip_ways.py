"""Ways of the grip in pictures: recorded ones, and where actions lead."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import robots

from jaxcam.data.recorded.fitting import fit
from jaxcam.data.recorded.parts import HeldOut, Meaning, make_recorded, parts_of
from jaxcam.data.recorded.pictures import load_recorded_pictures
from jaxcam.evaluation.grip_ways import grip_ways
from jaxcam.models import Policy, PolicySpec
from jaxcam.rays import Camera
from jaxcam.reports.camera_figures import ways_picture
from jaxcam.reports.style import save

SIZE = (24, 32)
GRIP = (0, 1, 2)


def ways(folder, meaning, act, held_out=HeldOut(episodes=(1,)), offset=0.0, obs_steps=1):  # noqa: B008
    """Ways of a robot that is told to stay, its base off from the commands' by `offset` (m).

    One of two things is asked of it.
    """
    recording = robots.recording(folder)
    for episode in recording.episodes:
        episode.action[:, :3] = episode.state[:, :3] + offset
    parts = parts_of(recording, held_out, 1)
    pictures = load_recorded_pictures(recording, parts, SIZE, folder)
    data = make_recorded(recording, parts, pictures, Meaning())
    data = replace(data, instruction=np.ones(len(parts.all), np.int32))
    spec = PolicySpec(5, 5, 1, *SIZE, chunk=3, obs_steps=obs_steps)
    policy = Policy(lambda key: {}, lambda *_: None, act, None, spec, 3)
    return recording, grip_ways(policy, {}, data, parts, GRIP, meaning)


def still(params, obs, key):
    return np.zeros((len(obs["proprio"]), 3, 5), np.float32)


def test_recorded_ways_are_where_the_camera_sees_them(tmp_path):
    recording, shown = ways(tmp_path, "unknown", still)
    episode = recording.episodes[1]
    sight, calibration = episode.sights["front"], episode.sights["front"].calibration
    K = fit((sight.height, sight.width), SIZE).intrinsics(calibration.K)
    camera = Camera(K, calibration.base_from_camera, *SIZE, calibration.distortion)
    step = int(0.1 * (episode.length - 1))
    expected, _ = camera.project(episode.state[step : step + 4, :3].astype(float))
    np.testing.assert_allclose(shown[0].recorded, expected, atol=1e-3)
    assert all(way.predicted is None for way in shown)


@pytest.mark.parametrize("meaning", ["eef_abs", "eef_delta"])
def test_actions_lead_from_where_the_grip_is(tmp_path, meaning):
    """A grip that stays: deltas of nothing, or targets where it is."""

    def stay(params, obs, key):
        moves = obs["proprio"][:, None] * (meaning == "eef_abs")
        return jnp.tile(moves, (1, 3, 1))

    _, shown = ways(tmp_path, meaning, stay)
    for way in shown:
        np.testing.assert_allclose(way.predicted, np.tile(way.recorded[:1], (4, 1)), atol=1e-3)
    file = save(ways_picture(shown), tmp_path / "ways.png")
    assert file.stat().st_size > 5000


def test_targets_in_another_frame_than_the_state_are_not_drawn(tmp_path):
    _, shown = ways(tmp_path, "eef_abs", still, offset=0.2)
    assert all(way.predicted is None for way in shown)


def test_of_several_observations_the_newest_is_drawn(tmp_path):
    one, two = (ways(tmp_path, "unknown", still, obs_steps=steps)[1] for steps in (1, 2))
    for way, other in zip(one, two, strict=True):
        np.testing.assert_array_equal(way.picture, other.picture)
        np.testing.assert_array_equal(way.recorded, other.recorded)


def test_without_held_out_episodes_there_is_nothing(tmp_path):
    assert ways(tmp_path, "eef_abs", still, HeldOut(count=0))[1] == []
