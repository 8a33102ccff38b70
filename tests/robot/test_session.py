"""What is remembered of a client."""

from dataclasses import replace

import numpy as np
import pytest
from port_requests import NAMES, SPEC, request

from jaxcam.errors import PortError
from jaxcam.robot.requests import RequestReader
from jaxcam.robot.session import Session


def session(steps=1, **how):
    return Session(RequestReader(NAMES, replace(SPEC, obs_steps=steps), width=3), steps, **how)


def numbered(number, **changes):
    return request(observation__state=np.float32([number, 0, 0]), **changes)


def seen_states(asked):
    return asked.obs["proprio"][..., 0].tolist()


def test_one_observation_has_no_axis_of_its_own():
    asked = session().ask(request())
    assert asked.obs["image"].shape == (2, 16, 24, 3)
    assert asked.obs["proprio"].shape == (3,)


def test_the_last_observations_are_kept_and_the_first_stands_for_those_before():
    one = session(steps=3)
    states = [seen_states(one.ask(numbered(n))) for n in range(1, 5)]
    assert states == [[1, 1, 1], [1, 1, 2], [1, 2, 3], [2, 3, 4]]
    assert one.control({"__ctrl__": "episode_start"}) == "episode_start"
    assert seen_states(one.ask(numbered(9))) == [9, 9, 9]


def test_a_request_that_brings_all_observations_replaces_what_is_kept():
    one = session(steps=2)
    one.ask(numbered(1))
    message = numbered(2)
    for name in ("observation.images.front", "observation.images.wrist"):
        message[name] = np.stack([message[name]] * 2)
    message["observation.state"] = np.float32([[5, 0, 0], [6, 0, 0]])
    assert seen_states(one.ask(message)) == [5, 6]
    assert seen_states(one.ask(numbered(7))) == [6, 7]


def test_a_bad_request_changes_nothing():
    one = session(steps=2)
    one.ask(numbered(1))
    with pytest.raises(PortError):
        one.ask(numbered(2, prompt=3))
    asked = one.ask(numbered(3))
    assert (seen_states(asked), asked.call) == ([1, 3], 1)


def test_calls_are_counted_from_the_start_or_as_the_client_says():
    one = session(row=2)
    assert [(a.call, a.row) for a in (one.ask(request()), one.ask(request()))] == [(0, 2), (1, 2)]
    asked = one.ask(request(call=7, row=1))
    assert (asked.call, asked.row) == (7, 1)
    assert one.ask(request()).call == 8
    one.control({"__ctrl__": "episode_end"})
    assert one.ask(request()).call == 0


def test_lenses_that_come_late_are_pinholes_before():
    one = session(steps=2)
    one.ask(request())
    lens = np.float32([-0.2, 0, 0, 0, 0, 0, 0, 0, 0])
    asked = one.ask(request(camera__front__distortion=lens))
    assert asked.obs["distortion"].shape == (2, 2, 9)
    assert not asked.obs["distortion"][0].any()


def test_controls():
    assert session().control(request()) is None
    for word in ("episode_sart", 3, None, ["episode_start"]):
        with pytest.raises(PortError, match=r"Unknown __ctrl__ .*Known: episode_start, episode_e"):
            session().control({"__ctrl__": word})


def test_actions_that_are_no_numbers_are_told():
    chunk = np.ones((4, 2), np.float32)
    np.testing.assert_array_equal(session().actions(chunk), chunk)
    chunk[3, 1] = np.nan
    with pytest.raises(PortError, match="no numbers"):
        session().actions(chunk)
