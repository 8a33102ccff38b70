"""The doctor on pictures of a simulated robot that pretends to be recorded, good and spoilt."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from filmed import about, filmed, sight, with_calibrations, with_pictures, with_sights, with_state
from robots import recording as robot

from jaxcam.checks.findings import worst
from jaxcam.checks.page import write_page
from jaxcam.checks.recorded.report import check_recorded
from jaxcam.data.pictures import views_of
from jaxcam.data.recorded.recording import Calibration, Episode, Recording
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.rays import invert, look_at
from jaxcam.rays.intrinsics import intrinsics
from jaxcam.sim import make_painter

PIXELS, PICTURES, EPISODES = 96, 8, 4
EYES = {"front": (0.9, 0.2, 0.7), "left": (0.25, 0.95, 0.6), "right": (0.35, -0.85, 0.75)}
"""Where cameras stand, from the middle of the table (m)."""
FIRST = 2
"""The episode from which on a camera is bumped."""


class Studio:
    """Demonstrations of Lift that three cameras film, which stand where they stand."""

    def __init__(self, demos):
        self._demos, task, self._world = demos, demos.task, demos.world
        self._painter = make_painter(self._world, PIXELS, varied=task.varied)
        self._neutral = demos.episodes[0].fixtures.copy()  # the room stays where it is
        self._neutral[:2] = task.start(task.scene("fixed"), 0).fixtures[:2]
        centre = np.array(task.cameras.centre)
        self.K = intrinsics(demos.header.fovy_deg, PIXELS)
        self.poses = {
            view: np.asarray(look_at(centre + eye, centre), float) for view, eye in EYES.items()
        }
        self.base_from_world = invert(self._world.world_from_base)

    def film(self, number, pose):
        """Pictures of an episode from a pose in the world."""
        demo = self._demos.episodes[number]
        steps = self._steps(demo)
        view = views_of(demo, self._demos, PIXELS, steps * len(demo.cameras))
        same = (len(steps), *self._neutral.shape)
        return self._painter.rgb(
            view._replace(
                fixtures=np.broadcast_to(self._neutral, same),
                world_from_camera=np.broadcast_to(pose, (len(steps), 4, 4)),
            )
        ).copy()

    def record(self):
        """The good dataset."""
        episodes = []
        for number in range(EPISODES):
            demo = self._demos.episodes[number]
            steps = self._steps(demo)
            grip = demo.eef_pos[steps] @ self.base_from_world[:3, :3].T
            grip = grip + self.base_from_world[:3, 3]
            state = np.concatenate([grip, demo.gripper[steps, None]], 1).astype(np.float32)
            sights = {
                view: sight(
                    self.film(number, pose),
                    Calibration(self.K, self.base_from_world @ pose, source="a test"),
                )
                for view, pose in self.poses.items()
            }
            action = demo.actions[steps].astype(np.float32)
            episodes.append(Episode(str(number), state, action, "Lift.", sights))
        names = ("eef_x", "eef_y", "eef_z", "gripper")
        actions = ("x", "y", "z", "turn_x", "turn_y", "turn_z", "gripper")
        return Recording(Path("lift"), tuple(EYES), names, actions, 2.0, episodes, "fingerprint")

    def _steps(self, demo):
        return np.linspace(0, demo.length - 1, PICTURES).astype(int)


@pytest.fixture(scope="module")
def studio(demos):
    return Studio(demos)


@pytest.fixture(scope="module")
def lifted(studio):
    return studio.record()


def test_a_good_dataset_has_nothing_to_mend(lifted):
    report = check_recorded(lifted)
    odd = [f"{f.what}, {f.where}: {f.got}" for f in report.findings if f.mark != "good"]
    assert len(odd) == 1  # eight pictures an episode are few
    assert odd[0].startswith("lengths")
    assert len(about(report.findings, "motion", "good")) == len(EYES)
    assert len(about(report.findings, "standing still", "good")) == len(EYES)
    assert report.overlays.shape[0] > len(EYES) * 320 / 2


def bump(rotation=None, position=(0, 0, 0)):
    pose = np.eye(4)
    if rotation is not None:
        pose[:3, :3] = cv2.Rodrigues(np.deg2rad(rotation))[0]
    pose[:3, 3] = position
    return pose


@pytest.mark.parametrize(
    ("view", "moved"),
    [
        ("front", bump(np.array([0, 3.0, 0]))),
        ("left", bump(np.array([0, 0, 3.0]))),
        ("right", bump(position=(0.03, 0, 0))),
    ],
)
def test_a_camera_that_is_bumped_by_3_degrees_or_3_cm(studio, lifted, view, moved):
    def bumped(number, name, pictures):
        if name != view or number < FIRST:
            return pictures
        return studio.film(number, studio.poses[view] @ moved)

    report = check_recorded(with_pictures(lifted, bumped))
    (finding,) = [f for f in report.findings if f.mark == "bad"]
    assert finding.what == "standing still"
    assert finding.where == f"view {view}, from episode {FIRST} on"
    (ranking,) = about(report.findings, "suspicious episodes", "note")
    assert ranking.got.startswith(f"worst first: {FIRST} (")


def test_two_cameras_that_are_swapped(lifted, studio):
    names = {"front": "right", "right": "front"}
    poses = {view: studio.base_from_world @ pose for view, pose in studio.poses.items()}
    report = check_recorded(
        with_calibrations(
            lifted,
            lambda i, view, c: replace(c, base_from_camera=poses[names.get(view, view)]),
        )
    )
    (finding,) = about(report.findings, "motion", "bad")
    assert finding.where == "views front and right"
    assert finding.got.startswith("front and right are swapped")


def test_poses_of_another_base(lifted, studio):
    world = invert(studio.base_from_world)
    report = check_recorded(
        with_calibrations(
            lifted, lambda i, view, c: replace(c, base_from_camera=world @ c.base_from_camera)
        )
    )
    findings = about(report.findings, "motion", "bad")
    assert len(findings) == len(EYES)
    place = re.search(r"at about \((.+), (.+), (.+)\) m", findings[0].fix).groups()
    off = np.array(place, float) - studio.base_from_world[:3, 3]
    assert np.linalg.norm(off) < 0.35


def test_intrinsics_for_another_size(lifted):
    half = np.diag([0.5, 0.5, 1])
    report = check_recorded(
        with_calibrations(
            lifted, lambda i, view, c: replace(c, K=half @ c.K) if view == "left" else c
        )
    )
    (finding,) = [f for f in report.findings if f.mark == "bad"]
    assert finding.what == "K"
    assert finding.where.startswith("view left")
    assert "K is for pictures of 48 x 48, 0.5 times these" in finding.fix


def test_robots_that_never_were_have_nothing_to_mend(tmp_path):
    for data in (
        robot(tmp_path, views=("front", "side", "wrist"), moving=("wrist",)),
        robot(tmp_path, views=("front",), actions=14),
    ):
        assert worst(check_recorded(data).findings) != "bad"


def test_without_a_known_grip_it_says_what_was_not_looked_at(tmp_path):
    data = replace(filmed(3, 12), state_names=("a", "b", "c", "d", "e"))
    report = check_recorded(data)
    (finding,) = about(report.findings, "cameras", "note")
    assert "--grip observation.state[0:3]" in finding.fix
    assert not about(report.findings, "motion", "good")
    named = check_recorded(data, "observation.state[0:3]")
    assert len(about(named.findings, "motion", "good")) == len(data.views)
    with pytest.raises(ConfigError, match="--grip names three columns"):
        check_recorded(data, "state[3:6]")


def test_pictures_that_are_none_are_named():
    data = filmed(4, 12)

    def broken():
        yield from ()
        raise DatasetError("film.mp4, episode e1: cut short.")

    def spoil(i, view, one):
        if (i, view) == (1, "front"):
            return replace(one, decode=broken)
        if (i, view) == (2, "left"):
            return sight(np.full((12, 72, 96, 3), 40, np.uint8), one.calibration)
        if (i, view) == (3, "right"):
            first = next(one.decode())
            return sight(np.tile(first, (12, 1, 1, 1)), one.calibration)
        if (i, view) == (0, "front"):
            return sight(np.stack(list(one.decode()))[:-2], one.calibration)
        return one

    findings = about(check_recorded(with_sights(data, spoil)).findings, "pictures")
    text = "\n".join(f"{f.where}: {f.got}" for f in findings)
    assert "view front, episode e1: film.mp4" in text
    assert "view front, episode e0: 10 pictures of 12 steps." in text
    assert "view left, episode e2: pictures are of one colour" in text
    assert "view right, episode e3: pictures are all the same" in text


def test_numbers_that_are_none_do_not_stop_it():
    data = filmed(3, 12)
    holes = with_state(data, 1, 3, 0, np.nan)
    report = check_recorded(holes)
    assert about(report.findings, "numbers")
    assert about(report.findings, "standing still", "good")
    no_numbers = with_calibrations(
        data, lambda i, view, c: replace(c, K=c.K * np.nan) if view == "left" else c
    )
    report = check_recorded(no_numbers)
    assert [f.what for f in report.findings if f.mark == "bad"] == ["K"]


def test_the_page_has_pictures_figures_and_numbers(tmp_path):
    page = write_page(check_recorded(filmed(3, 12)), tmp_path / "cups.check.html")
    text = page.read_text("utf-8")
    assert text.count("<img") == 2
    assert "the axes of the base" in text
    assert "state, ee_x" in text
    assert (tmp_path / "cups.check.png").exists()
