"""Experts show their task nearly always, by small steps and turns, and let go at the end."""

import numpy as np
import pytest

from jaxcam.data.collection import run_expert
from jaxcam.rays.rotations import matrix_from_rotvec, rotvec_from_matrix
from jaxcam.sim import make_task
from jaxcam.sim.experts import LEVEL, SPIN, STEP, TURN, Hand, easy_grip, funnel
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.tasks.pick_place_can import NEAR
from jaxcam.sim.tasks.square import BASE_HALF_SIZE, GRIP, NUT_HALF_HEIGHT, WELL_HELD
from jaxcam.sim.types import ExpertSight

SEEDS = range(42, 62)
LONGEST = {"lift": 100, "pick_place_can": 150, "square": 280}


@pytest.fixture(scope="module", params=sorted(LONGEST))
def shown(request):
    """A task and its expert's episodes."""
    task = make_task(request.param)
    scene = task.scene("randomized")
    engine = NativeEngine(scene, varied=task.varied)
    return task, scene, run_expert(task, scene, engine, list(SEEDS))


def test_the_expert_succeeds(shown):
    task, _, demos = shown
    assert sum(demo is not None for demo in demos) >= len(SEEDS) - 1
    assert max(demo.length for demo in demos if demo) <= LONGEST[task.name]


def test_set_points_move_and_turn_by_small_steps(shown):
    task, _, demos = shown
    most = 0.0
    for demo in filter(None, demos):
        first = np.concatenate([demo.eef_pos[:1], demo.actions[:, :3]])
        assert np.linalg.norm(np.diff(first, axis=0), axis=-1).max() <= STEP * (1 + 1e-9)
        rotations = matrix_from_rotvec(demo.actions[:, 3:6])
        turns = rotvec_from_matrix(rotations[1:] @ rotations[:-1].swapaxes(-1, -2))
        most = max(most, np.linalg.norm(turns, axis=-1).max())
    assert most <= (SPIN if task.name == "square" else TURN) * (1 + 1e-6)
    assert (most > TURN / 2) == (task.name != "lift")


def test_what_is_placed_stands_where_it_belongs(shown):
    task, scene, demos = shown
    for demo in filter(None, demos):
        qpos = demo.qpos[-1]
        if task.name == "pick_place_can":
            at = scene.qpos_of("can")
            assert np.linalg.norm(qpos[at : at + 2] - demo.fixtures[2, :2]) < NEAR / 2
            assert abs(qpos[at + 4 : at + 6]).max() < 0.02  # upright
        elif task.name == "square":
            nut, peg = (qpos[scene.qpos_of(n) :][:3] for n in ("nut", "peg"))
            assert nut[2] - peg[2] == pytest.approx(BASE_HALF_SIZE[2] + NUT_HALF_HEIGHT, abs=2e-3)
        assert (demo.actions[-1, 6] < 0) == (task.name != "lift")


def grip_changes(demo):
    """The steps at which the gripper's command changes."""
    return np.flatnonzero(np.diff(np.sign(demo.actions[:, 6]))) + 1


def test_half_of_squares_experts_grip_badly_first_and_none_goes_on_so(shown):
    task, scene, demos = shown
    changes = [grip_changes(demo) for demo in filter(None, demos)]
    counts = {"lift": {1}, "pick_place_can": {2}, "square": {2, 4}}  # close, open; or twice
    assert {len(steps) for steps in changes} == counts[task.name]
    if task.name == "square":
        assert 0.2 < np.mean([len(steps) > 2 for steps in changes]) < 0.8
        nut = scene.qpos_of("nut")
        for demo, steps in zip(filter(None, demos), changes, strict=True):
            before = steps[-1] - 10
            off = np.linalg.norm((demo.eef_pos[before] - demo.qpos[before, nut : nut + 3])[:2])
            assert off == pytest.approx(GRIP, abs=WELL_HELD + 0.005)  # it slips a little


def test_what_square_grips_badly_is_said_to_be_an_error(shown):
    task, _, demos = shown
    for demo in filter(None, demos):
        changes = grip_changes(demo)
        if demo.errors is None:
            assert len(changes) <= 2
            continue
        assert task.name == "square"
        bad = np.flatnonzero(demo.errors)
        close, let_go = changes[0], changes[1]
        assert (np.diff(bad) == 1).all()
        assert 0 < bad[0] < close < bad[-1] < let_go  # the way there and the hold; not the mending


def make_sight(rotation=None):
    rotation = np.diag([1.0, -1.0, -1.0]) if rotation is None else rotation
    rng = np.random.default_rng(0)
    return ExpertSight(np.array([0.0, 0, 1]), rotation, np.zeros(16), rng, start=None)  # type: ignore[arg-type]


def test_a_turn_is_bounded_and_arrives():
    sight = make_sight()
    goal = matrix_from_rotvec(np.array([0.0, 0, 2.0])) @ sight.grip_rotation
    way, before = [], sight.grip_rotation
    for aim in Hand(sight).reach(lambda: sight.grip_position, 1, tolerance=1, turn=lambda: goal):
        way.append(np.linalg.norm(rotvec_from_matrix(aim.rotation @ before.T)))
        sight.grip_rotation = before = aim.rotation  # an arm that follows at once
    assert max(way) <= TURN * (1 + 1e-9)
    assert np.linalg.norm(rotvec_from_matrix(goal @ before.T)) < 0.1
    assert len(way) == pytest.approx(1.9 / TURN, abs=2)


def test_a_hand_that_strays_turns_the_wrong_way_too_and_comes_back():
    def aims(spin):
        sight = make_sight()
        goal = matrix_from_rotvec(np.array([0.0, 0, -1.5])) @ sight.grip_rotation
        left, before = [], sight.grip_rotation
        reach = Hand(sight).reach(
            lambda: sight.grip_position, 1, tolerance=1, turn=lambda: goal, stray=0.1, spin=spin
        )
        for aim in reach:
            turned = rotvec_from_matrix(aim.rotation @ before.T)
            assert np.linalg.norm(turned) <= max(TURN, spin) * (1 + 1e-9)
            np.testing.assert_allclose(turned[:2], 0, atol=1e-9)  # about the vertical
            sight.grip_rotation = before = aim.rotation
            left.append(np.linalg.norm(rotvec_from_matrix(goal @ before.T)))
        return np.array(left)

    assert (np.diff(aims(0.0)) <= 1e-9).all()  # nearer all the time
    spun = aims(SPIN)
    assert (np.diff(spun) > 0.01).any()
    assert spun[-1] < 0.1


def test_trim_makes_up_for_an_arm_that_sticks():
    def end(trim):
        sight, goal = make_sight(), np.array([0.05, 0, 1])
        for aim in Hand(sight).reach(lambda: goal, 1, tolerance=1e-3, trim=trim):
            sight.grip_position = aim.position - [0.004, 0, 0]
        return np.linalg.norm(goal - sight.grip_position)

    assert end(0.0) == pytest.approx(0.004, abs=1e-6)
    assert end(0.05) < 1e-3


def test_a_funnel_is_high_outside_and_low_inside():
    def at(aside):
        return funnel(np.array([aside, 0, 9]), 0.01, 0.1, inside=0.02, slope=2)

    assert (at(0), at(0.019), at(1)) == (0.01, 0.01, 0.1)
    assert at(0.03) == pytest.approx(0.03)


@pytest.mark.parametrize("close", [[0, 1, 0], [0.5, 0.5, 0], [0, -2, 0]])
def test_an_easy_grip_leans_out_when_far_and_in_when_near(close):
    close = np.array(close, float)
    for distance in (0.4, LEVEL, 0.7, 0.8):
        axes = easy_grip(np.zeros(3), np.array([distance, 0, 0]), close)
        np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)
        np.testing.assert_allclose(axes[:, 0], close / np.linalg.norm(close))
        assert axes[2, 2] < -0.8
        assert np.sign(np.round(axes[0, 2], 9)) == np.sign(distance - LEVEL)
