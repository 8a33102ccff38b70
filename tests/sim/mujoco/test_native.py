"""A batch of worlds is its worlds one by one, whatever the width, the threads and the past."""

import numpy as np
import pytest

from jaxcam.sim.mujoco import native
from jaxcam.sim.mujoco.native import NativeEngine
from jaxcam.sim.mujoco.table import TABLE_TOP
from jaxcam.sim.task import starts
from jaxcam.sim.types import Command, Start

STEPS = 12


def commands(lift, scene, state, steps=STEPS):
    """Targets that press the open fingers around the cube: contacts, not only free motion."""
    cube = state.qpos[:, scene.qpos_of("cube") :][:, :3]
    way = np.linspace(0, 1, steps)[:, None, None]
    position = state.grip_position + way * (cube - state.grip_position)
    rotvec = np.broadcast_to([np.pi, 0, 0], position.shape)
    gripper = np.where(np.arange(steps) < steps // 2, -1.0, 1.0)
    return np.concatenate([position, rotvec], -1), gripper


def run(engine, lift, scene, start, active=None, spoil=None, steps=STEPS):
    """All states on the way."""
    state = engine.reset(start)
    targets, gripper = commands(lift, scene, state, steps)
    states = [state]
    for t in range(steps):
        if spoil and spoil[0] == t:
            state.qvel[1, 3] = spoil[1]
        command = Command(targets[t], np.full(len(start.qpos), gripper[t]))
        state = engine.step(state, command, active)
        states.append(state)
    return states


def rows(start, which):
    return Start(*(x[which] for x in start))


def assert_same(a, b):
    for name, x, y in zip(a._fields, a, b, strict=True):
        np.testing.assert_array_equal(x, y, err_msg=name)


@pytest.fixture(scope="module")
def start(lift, scene):
    begun = starts(lift, scene, range(4))
    cube = scene.qpos_of("cube")
    begun.qpos[:, cube : cube + 2] = [[0, 0], [0.02, -0.1], [-0.05, 0.1], [0.05, 0.03]]
    return begun


@pytest.fixture(scope="module")
def batch(lift, scene, start):
    return run(NativeEngine(scene, varied=lift.varied), lift, scene, start)


@pytest.mark.parametrize("threads", [1, 3])
def test_any_number_of_threads_gives_the_same_bits(lift, scene, start, batch, threads, monkeypatch):
    monkeypatch.setattr(native, "LEAST", 1)  # else so few worlds stay in one thread
    engine = NativeEngine(scene, varied=lift.varied, threads=threads)
    for a, b in zip(run(engine, lift, scene, start), batch, strict=True):
        assert_same(a, b)
    assert len(engine.shares) == threads


def test_singles_equal_the_batch_bit_for_bit(lift, scene, start, batch):
    engine = NativeEngine(scene, varied=lift.varied, threads=1)
    for i in (0, 2):  # one engine for both: the second world comes after another one's past
        for alone, together in zip(run(engine, lift, scene, rows(start, [i])), batch, strict=True):
            assert_same(alone, type(together)(*(x[[i]] for x in together)))
    assert abs(batch[-1].qpos[0] - batch[0].qpos[0]).max() > 0.01


def test_a_reset_forgets_everything(lift, scene, start):
    engine = NativeEngine(scene, varied=lift.varied, threads=1)
    first = run(engine, lift, scene, start, steps=4)
    other = Start(start.qpos[::-1], start.geom_size[::-1], start.fixtures[::-1])
    run(engine, lift, scene, other, steps=4)
    for a, b in zip(run(engine, lift, scene, start, steps=4), first, strict=True):
        assert_same(a, b)


def test_worlds_begin_anew_without_a_trace_in_the_others(lift, scene, start, batch):
    """Not even where fingers touch the cube: a solver remembers contacts."""
    engine, again, done = NativeEngine(scene, varied=lift.varied), np.arange(4) == 1, 9
    states = run(engine, lift, scene, start)
    targets, gripper = commands(lift, scene, states[0])
    state = engine.restart(states[done], start, again)
    for now, before, first in zip(state, batch[done], batch[0], strict=True):
        np.testing.assert_array_equal(now[~again], before[~again])
        np.testing.assert_array_equal(now[again], first[again])
    after = engine.step(state, Command(targets[done], np.full(4, gripper[done])))
    for now, then in zip(after, batch[done + 1], strict=True):
        np.testing.assert_array_equal(now[~again], then[~again])


def test_a_step_before_the_first_reset_is_refused(lift, scene, batch):
    engine = NativeEngine(scene, varied=lift.varied)
    with pytest.raises(RuntimeError, match="call reset first"):
        engine.step(batch[0], Command(np.ones((4, 6)), np.ones(4)))


def test_inactive_worlds_stay_as_they_are(lift, scene, start, batch):
    engine = NativeEngine(scene, varied=lift.varied)
    active = np.array([True, False, True, False])
    states = run(engine, lift, scene, start, active)
    for part, whole in zip(states, batch, strict=True):
        for now, then, moving in zip(part, states[0], whole, strict=True):
            np.testing.assert_array_equal(now[~active], then[~active])
            np.testing.assert_array_equal(now[active], moving[active])


def test_step_leaves_its_input_alone(lift, scene, start):
    engine = NativeEngine(scene, varied=lift.varied)
    state = engine.reset(start)
    before = [np.copy(x) for x in state]
    engine.step(state, Command(np.ones((4, 6)), np.ones(4)))
    for a, b in zip(state, before, strict=True):
        np.testing.assert_array_equal(a, b)


def test_any_state_can_be_gone_on_from(lift, scene, start, batch):
    """Worlds that are somewhere else are computed anew, and then like those that were there."""
    engine = NativeEngine(scene, varied=lift.varied)
    states = run(engine, lift, scene, start)
    targets, gripper = commands(lift, scene, states[0])
    mixed = type(states[0])(*(np.copy(x) for x in states[-1]))
    for now, then in zip(mixed, states[7], strict=True):
        now[[0, 3]] = then[[0, 3]]
    after = engine.step(mixed, Command(targets[7], np.full(4, gripper[7])))
    for now, then in zip(after, batch[8], strict=True):
        np.testing.assert_array_equal(now[[0, 3]], then[[0, 3]])


@pytest.mark.parametrize("bad", [np.inf, np.nan, 1e12])
def test_a_diverging_world_is_flagged_and_the_others_go_on(
    lift, scene, start, batch, tmp_path, monkeypatch, caplog, bad
):
    monkeypatch.chdir(tmp_path)
    engine = NativeEngine(
        scene, varied=lift.varied, threads=1
    )  # so that they share what goes wrong
    states = run(engine, lift, scene, start, spoil=(5, bad))
    assert states[5].ok.all()
    others = [0, 2, 3]
    for t in range(6, STEPS + 1):
        assert states[t].ok.tolist() == [True, False, True, True]
        for now, then in zip(states[t], batch[t], strict=True):
            np.testing.assert_array_equal(now[others], then[others])
    np.testing.assert_array_equal(states[-1].closed[1], states[6].closed[1])
    assert np.isfinite(states[-1].grip_position).all()
    for again, before in zip(run(engine, lift, scene, start), batch, strict=True):
        assert_same(again, before)
    assert "QVEL at DOF 3" in caplog.text
    assert not list(tmp_path.iterdir())  # where MuJoCo would write its own log


def test_when_all_diverge_the_batch_is_still_there(lift, scene, start):
    engine = NativeEngine(scene, varied=lift.varied)
    states = run(engine, lift, scene, rows(start, [0, 1]))
    states[-1].qvel[:] = np.nan
    after = engine.step(states[-1], Command(np.ones((2, 6)), np.ones(2)))
    assert not after.ok.any()
    assert_same(engine.step(after, Command(np.ones((2, 6)), np.ones(2))), after)


def test_more_worlds_than_go_together(lift, scene, start, batch):
    """The same worlds again and again, in different company."""
    many = np.tile(np.arange(4), 20)[:75]
    engine = NativeEngine(scene, varied=lift.varied, threads=1)
    active = np.random.default_rng(0).random(75) < 0.8
    states = run(engine, lift, scene, rows(start, many), active)
    for part, four in zip(states, batch, strict=True):
        np.testing.assert_array_equal(part.qpos[active], four.qpos[many[active]])


def test_a_command_that_is_no_number_is_flagged(lift, scene, start, batch):
    engine = NativeEngine(scene, varied=lift.varied, threads=1)
    state = engine.reset(start)
    targets, gripper = commands(lift, scene, state)
    targets[0, 1, 2] = np.nan
    state = engine.step(state, Command(targets[0], np.full(4, gripper[0])))
    assert state.ok.tolist() == [True, False, True, True]
    np.testing.assert_array_equal(state.qpos[[0, 2, 3]], batch[1].qpos[[0, 2, 3]])


@pytest.mark.parametrize("controller", ["osc_pose", "joint_position"])
def test_an_unreachable_target_does_no_harm(lift, scene, start, controller):
    """The arm swings about at its limits and pushes down on the table, but stays sound."""
    engine = NativeEngine(scene, controller, varied=lift.varied)
    state = engine.reset(start)
    if controller == "osc_pose":
        far = state.grip_position + 3 * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]])
        target = np.concatenate([far, np.tile([np.pi, 0, 0], (4, 1))], -1)
    else:
        target = state.rest + np.array([[10.0], [-10.0], [3.0], [-3.0]])
    for _ in range(30):
        state = engine.step(state, Command(target, np.ones(4)))
    assert state.ok.all()
    joints = scene.physics.jnt_range[scene.arm]
    arm = state.qpos[:, scene.arm]
    assert (arm > joints[:, 0] - 0.02).all()
    assert (arm < joints[:, 1] + 0.02).all()


def test_cube_size_decides_mass_and_where_it_rests(lift, scene):
    start = starts(lift, scene, range(3))
    half = np.array([[0.020, 0.021, 0.022], [0.022, 0.022, 0.020], [0.02, 0.02, 0.0215]])
    start.geom_size[:, 0] = half
    start.qpos[:, scene.qpos_of("cube") + 2] = TABLE_TOP + half[:, 2] + 0.003
    engine = NativeEngine(scene, varied=lift.varied, threads=1)
    state = engine.reset(start)
    hover = Command(
        np.concatenate([state.grip_position, np.tile([np.pi, 0, 0], (3, 1))], -1), -np.ones(3)
    )
    for _ in range(8):
        state = engine.step(state, hover)
    rest = state.qpos[:, scene.qpos_of("cube") + 2] - TABLE_TOP
    np.testing.assert_allclose(rest, half[:, 2], atol=3e-4)
    for i, h in enumerate(half):
        cube = engine.shares[0].batch.get_model(i).body("cube_main")
        full = 2 * h
        mass = scene.physics.body("cube_main").mass[0] * full.prod() / 0.042**3
        np.testing.assert_allclose(cube.mass[0], mass, rtol=1e-6)
        inertia = mass / 12 * ((full**2).sum() - full**2)
        np.testing.assert_allclose(cube.inertia, inertia, rtol=1e-6)


def test_joint_controller_reaches_its_target(lift, scene, start):
    engine = NativeEngine(scene, "joint_position", varied=lift.varied)
    state = engine.reset(start)
    target = state.qpos[:, scene.arm] + 0.05
    for _ in range(30):
        state = engine.step(state, Command(target, -np.ones(4)))
    np.testing.assert_allclose(state.qpos[:, scene.arm], target, atol=5e-3)
