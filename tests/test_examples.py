"""The worked examples: what they write is what they say it is."""

import dataclasses
import importlib.util
import sys
import time

import cv2
import numpy as np
import pytest
from places import REPO
from policy_servers import answering, socket_server
from rich.console import Console
from test_import_hygiene import loaded

from jaxcam.client import Client
from jaxcam.interop.recordings import read_recording
from jaxcam.rays import Camera
from jaxcam.sim import make_painter

FILE = REPO / "examples/recorded/make_dataset.py"
LOOP = REPO / "examples/robot/loop.py"
ROWS = 60


def module_of(file):
    """A script, as a module."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # as dataclasses want it
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def example():
    """The script that makes a dataset."""
    yield from module_of(FILE)


@pytest.fixture(scope="module")
def loop():
    """The robot's loop."""
    yield from module_of(LOOP)


def shortened(demo, steps=4):
    """A demonstration of its first few steps."""
    states = {
        k: getattr(demo, k)[: steps + 1] for k in ("states", "eef_pos", "eef_quat", "gripper")
    }
    return dataclasses.replace(demo, actions=demo.actions[:steps], **states)


@pytest.fixture(scope="module")
def written(example, demos, tmp_path_factory):
    """Two short episodes: their demonstrations, and the dataset that was written and read."""
    out = tmp_path_factory.mktemp("example")
    few = dataclasses.replace(demos, train=[shortened(d) for d in demos.train[:2]], valid=[])
    example.record(few, out, example.eyes_of(ROWS), Console(quiet=True))
    return few, read_recording(out / example.ROBOT, out / "cameras.json"), out


def test_the_dataset_has_what_it_says(example, written):
    demos, recording, out = written
    assert recording.views == ("front", "side", "wrist")
    assert (recording.state_names, recording.action_names) == (example.STATE, example.ACTION)
    for demo, episode in zip(demos.episodes, recording.episodes, strict=True):
        grip = episode.state[:, -3:] @ demos.world.world_from_base[:3, :3].T
        grip += demos.world.world_from_base[:3, 3]
        np.testing.assert_allclose(grip, demo.eef_pos[:-1], atol=1e-6)
        for view, eye in example.eyes_of(ROWS).items():
            sight = episode.sights[view]
            assert (sight.height, sight.width) == (eye.height, eye.width)
            np.testing.assert_allclose(sight.calibration.K, eye.K, atol=1e-12)
            np.testing.assert_array_equal(sight.calibration.distortion[:5], eye.lens)
            assert sight.calibration.base_from_camera.ndim == (3 if view == "wrist" else 2)
    assert cv2.imread(str(out / "overlays.png")).shape[0] == 240


def test_a_lens_that_is_undone_gives_the_pinhole_picture(example, written):
    demos, _, _ = written
    demo, eye = demos.episodes[0], example.eyes_of(ROWS)["front"]
    pose, task = example.tripod("front", 0), demos.task
    K, height, width = example.pinhole(eye)
    painter = make_painter(demos.world, height, width, varied=task.varied)
    bent = example.film(demo, demos, painter, eye, pose)[0]
    plain = example.Eye(K, height, width, np.zeros(5))
    straight = example.film(demo, demos, painter, plain, pose)[0].astype(float)
    middles = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    maps = cv2.initUndistortRectifyMap(
        eye.K - middles, eye.lens, np.eye(3), K - middles, (width, height), cv2.CV_32FC1
    )
    undone = cv2.remap(bent, *maps, cv2.INTER_LINEAR).astype(float)
    middle = np.s_[height // 6 : -height // 6, width // 6 : -width // 6]
    # drawn, looked up twice between pixels: compared as coarsely as that is
    undone, straight = (cv2.GaussianBlur(picture, (0, 0), 1.5) for picture in (undone, straight))
    error = np.abs(undone - straight)[middle].mean()
    assert error < 1.5
    for axis in (0, 1):  # a pixel aside is worse by far
        assert np.abs(np.roll(undone, 1, axis) - straight)[middle].mean() > 2.5 * error


def test_calibrations_say_where_the_cube_is_in_pictures(example, written):
    demos, recording, _ = written
    where, compared = demos.world.qpos_of("cube"), 0
    world_from_base = demos.world.world_from_base
    for demo, episode in zip(demos.episodes, recording.episodes, strict=True):
        cube = (demo.qpos[0, where : where + 3] - world_from_base[:3, 3]) @ world_from_base[:3, :3]
        for view in ("front", "side"):
            sight = episode.sights[view]
            camera = Camera(
                sight.calibration.K, sight.calibration.base_from_camera, sight.height, sight.width,
                sight.calibration.distortion,
            )  # fmt: skip
            red, green, blue = np.moveaxis(next(iter(sight.decode())).astype(int), -1, 0)
            rows, columns = np.nonzero(green > 1.5 * np.maximum(red, blue))
            if len(rows) < 12:
                continue  # out of the picture
            compared += 1
            seen_at = np.array([columns.mean(), rows.mean()]) + 0.5
            pixel, depth = camera.project(cube)
            assert depth > 0
            assert np.abs(pixel - seen_at).max() < 1
    assert compared >= 3


def test_a_robot_s_loop_moves_while_it_thinks(loop):
    """Answers take two steps and a half, in which it executes what it has."""

    def act(observation):
        assert observation["observation.images.side"].shape == (84, 84, 3)
        time.sleep(0.12)
        return np.tile(np.float32([0.05, 0, 0, 0, 0, 0, 1]), (12, 1))  # faster than it may move

    metadata = {"views": ["side"], "execute": 8, "action_space": "eef_delta"}
    with socket_server(answering(metadata, act)) as url, Client(url) as policy:
        robot = loop.MyRobot(["side"], 11)
        numbers = loop.run(robot, policy, seconds=1.2)
    assert numbers.startswith(f"{robot.steps} actions, ")
    assert robot.steps >= 8  # of 24; about 20 where nothing else runs
    assert robot.position[0] == pytest.approx(0.02 * robot.steps)


def test_a_robot_s_loop_without_a_server_says_so(loop, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["loop.py", "127.0.0.1:8000"])
    with pytest.raises(SystemExit, match="no address of a policy server"):
        loop.main()


def test_a_robot_s_loop_needs_no_jax():
    program = f"import runpy; runpy.run_path({str(LOOP)!r})"
    modules, _ = loaded(program)
    assert not modules & {"jax", "scipy", "rich", "tyro", "mujoco"}
