"""Whether policies would be evaluated on what is like their dataset, and on nothing in it."""

from dataclasses import replace

import numpy as np
import pytest
from many_cameras import seen_by_many, with_optics, with_poses

from jaxcam.checks.held_out import camera_numbers, check_field_of_view, check_held_out, check_ranges
from jaxcam.rays import POSE_RANGES, sample_poses
from jaxcam.sim.tasks.lift import Lift


@pytest.fixture(scope="module")
def many(demos):
    return seen_by_many(demos)


def test_cameras_and_episodes_of_the_evaluation_do_not_belong_in_a_dataset(many):
    assert check_held_out(many).mark == "good"
    poses = many.header.world_from_camera.copy()
    poses[:4] = sample_poses(POSE_RANGES["robosuite"], 9, 23)[5:]
    finding = check_held_out(with_poses(many, poses))
    assert finding.mark == "bad"
    assert "4 of test, 0 of validation" in finding.got
    leak = replace(many, train=[replace(many.train[0], seed=2_000_007), *many.train[1:]])
    assert "evaluation: 2000007" in check_held_out(leak).got


def test_cameras_from_elsewhere_than_those_of_the_evaluation(many):
    assert check_ranges(many).mark == "good"
    poses = many.header.world_from_camera.copy()
    poses[:3] = sample_poses(replace(POSE_RANGES["robosuite"], distance=(1.5, 2.0)), 3, 0)
    poses[3, :3, :3] = poses[4, :3, :3]  # looks past the table
    finding = check_ranges(with_poses(many, poses))
    assert (finding.mark, finding.where) == ("note", "0, 1, 2, 3")


@pytest.mark.parametrize("name", POSE_RANGES)
def test_the_papers_ranges_are_their_own(many, name, monkeypatch):
    monkeypatch.setattr(Lift, "cameras", POSE_RANGES[name])
    poses = sample_poses(POSE_RANGES[name], 200, 0)
    assert check_ranges(with_poses(many, poses)).mark == "good"


@pytest.mark.parametrize(("fovy", "hint"), [(60.0, "cameras' own"), (np.pi / 4, "like radians")])
def test_a_field_of_view_of_other_cameras(many, fovy, hint):
    assert check_field_of_view(many).mark == "good"
    finding = check_field_of_view(replace(many, header=replace(many.header, fovy_deg=fovy)))
    assert finding.mark == "bad"
    assert hint in finding.fix


def test_fields_of_view_of_cameras_that_have_their_own(many):
    """They are told as they are, and held against the ranges that the evaluation draws from."""
    varied = with_optics(many, fovy="20:70", lens="opencv:-0.3:0")
    finding = check_field_of_view(varied)
    fovy = 2 * np.rad2deg(np.arctan(0.5 / varied.header.K[:, 1, 1]))
    assert finding.mark == "good"
    assert finding.got.startswith(f"{fovy.min():.4g}° to {fovy.max():.4g}°")
    assert "fovy 20:70, lens opencv:-0.3:0" in finding.got
    assert "45" not in finding.got
    narrow = replace(varied.header, optics={"fovy": "20:60"})
    finding = check_field_of_view(replace(varied, header=narrow))
    assert finding.mark == "bad"
    assert str(np.flatnonzero(fovy > 60)[0]) in finding.where
    unknown = check_field_of_view(replace(varied, header=replace(varied.header, optics={})))
    assert unknown.mark == "note"
    assert "45°" in unknown.fix


def test_a_lens_alone_leaves_the_task_s_field_of_view(many):
    finding = check_field_of_view(with_optics(many, lens="opencv:-0.3:0"))
    assert finding.mark == "good"
    assert finding.got.startswith("45° to 45°")


def test_numbers_have_fields_of_view_where_cameras_have_their_own(many):
    assert "field of view (°)" not in camera_numbers(many)
    fovy = camera_numbers(with_optics(many, fovy="20:70"))["field of view (°)"]
    assert 20 < fovy.min() < fovy.max() < 70
