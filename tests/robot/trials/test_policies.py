"""The policy servers of a sheet: there, and comparable."""

import contextlib
from types import SimpleNamespace

import pytest
from policy_servers import answering, socket_server
from rehearsal import rester

from jaxcam.errors import ConfigError, PortError
from jaxcam.robot.trials.policies import Served, ask_policies, check_robot
from jaxcam.robot.trials.sheet import CamerasEntry, PolicyEntry, Sheet

METADATA = {"views": ["a", "b"], "action_names": ["x"], "action_space": "eef_abs", "execute": 5}


def sheet(urls, **changes):
    entries = tuple(PolicyEntry(f"p{i}", url) for i, url in enumerate(urls))
    entries = changes.pop("policies", entries)
    values = {"cameras": CamerasEntry(("l", "r", "t"), 2)} | changes
    return Sheet("t", "s", "h", entries, ("start",), **values)


def asked(tmp_path, *metadata, **changes):
    with contextlib.ExitStack() as servers:
        urls = [servers.enter_context(socket_server(answering(m, rester))) for m in metadata]
        return ask_policies(sheet(urls, **changes), tmp_path)


def test_what_servers_say_of_themselves(tmp_path):
    one, two = asked(tmp_path, METADATA, {})  # another's server may say nothing
    assert (one.views, one.views_at_once, one.execute) == (("a", "b"), 2, 5)
    assert (two.views, two.views_at_once, two.execute, two.weights_sha) == ((), 0, None, "")
    [odd] = asked(tmp_path, {"views": 2, "views_at_once": "2", "execute": [5]})
    assert (odd.views, odd.views_at_once, odd.execute) == ((), 0, None)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"action_names": ["y"]}, r"action_names of 'p0' is \['x'\], of 'p1' it is \['y'\]"),
        ({"action_space": "joint_abs"}, "action_space of 'p0' is eef_abs"),
        ({"views": ["a", "c"]}, r"views of 'p0' is \['a', 'b'\]"),
        ({"views_at_once": 1}, "'p1' sees 1 views at once, of a, b; the sheet uses 2"),
        ({"needs_cameras": True}, "'p1' is told where its cameras are, and the sheet has no cal"),
    ],
)
def test_policies_that_do_not_go_together(tmp_path, other, words):
    with pytest.raises(ConfigError, match=words):
        asked(tmp_path, METADATA, METADATA | other)


def test_cameras_of_a_server_s_own_file_would_not_be_the_sheet_s(tmp_path):
    cameras = CamerasEntry(("l", "r"), 2, "cameras.json")
    metadata = METADATA | {"needs_cameras": True, "cameras_given": True}
    with pytest.raises(ConfigError, match="Start the server without --cameras"):
        asked(tmp_path, metadata, cameras=cameras)


def test_a_server_that_wants_a_key(tmp_path):
    def admit(connection, handshake):
        if handshake.headers.get("Authorization") != "Api-Key secret":
            return connection.respond(401, "no\n")
        return None

    (tmp_path / "key").write_text("secret\nof the second server\n")
    with socket_server(answering(METADATA, rester), process_request=admit) as url:
        with pytest.raises(PortError, match=r"'p0' of the sheet: .*401.* give key_file"):
            ask_policies(sheet([url]), tmp_path)
        entry = PolicyEntry("p0", url, key_file="key")
        [one] = ask_policies(sheet([], policies=(entry,)), tmp_path)
        with one.connect() as client:
            assert client.metadata == METADATA
        entry = PolicyEntry("p0", url, key_file="none")
        with pytest.raises(ConfigError, match=r"key_file .*none cannot be read"):
            ask_policies(sheet([], policies=(entry,)), tmp_path)
        (tmp_path / "none").write_text("two words")
        with pytest.raises(ConfigError, match="one word of ASCII"):
            ask_policies(sheet([], policies=(entry,)), tmp_path)


def test_a_robot_that_takes_something_else():
    entry = PolicyEntry("p0", "ws://x")
    robot = SimpleNamespace(rate=20.0, action_space="eef_delta")
    good = {"rate": 20, "action_space": "eef_delta", "rotations": "world"}
    check_robot(robot, [Served(entry, None, good), Served(entry, None, {})])
    with pytest.raises(ConfigError, match=r"its rate is 10\.0, and the robot's is 20"):
        check_robot(robot, [Served(entry, None, good | {"rate": 10.0})])
    with pytest.raises(ConfigError, match="its action_space is eef_abs, and the robot's is eef_d"):
        check_robot(robot, [Served(entry, None, good | {"action_space": "eef_abs"})])
