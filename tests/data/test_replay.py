"""Replaying demonstrations in every action space."""

from dataclasses import replace

import numpy as np

from jaxcam.data import replay as replay_module
from jaxcam.data.batches import demo_actions
from jaxcam.data.replay import replay, replay_all
from jaxcam.sim.actions import ACTION_SPACES, controller_of
from jaxcam.sim.mujoco.native import NativeEngine


def test_only_what_still_works_counts(lift, scene, spoilt):
    successes = replay_all(spoilt, lift, scene)
    assert tuple(successes) == ACTION_SPACES
    expected = np.arange(len(spoilt)) != 1
    for success in successes.values():
        np.testing.assert_array_equal(success, expected)


def test_demonstrations_beyond_a_batch_are_replayed_too(lift, scene, spoilt, monkeypatch):
    monkeypatch.setattr(replay_module, "BATCH", 2)
    success = replay_all(spoilt, lift, scene, ["eef_delta"])["eef_delta"]
    assert success.tolist() == [i != 1 for i in range(len(spoilt))]


def test_a_demonstration_is_given_no_more_steps_than_its_own(lift, scene, demos):
    """Cut before the lift, it must not succeed by being replayed beside a longer one."""
    demo = demos.train[0]
    cut = np.flatnonzero(demo.actions[:, 6] > 0)[0]
    short = replace(demo, states=demo.states[: cut + 1], actions=demo.actions[:cut])
    engine = NativeEngine(scene, varied=lift.varied)
    assert replay([short, demo], "eef_abs", lift, scene, engine).tolist() == [False, True]


def test_joint_targets_lead_to_where_the_joints_were(lift, scene, demos):
    """The arm is within 2 cm of the demonstration, at the same time as the gripper's commands."""
    demo = demos.train[0]
    targets = demo_actions(demo, "joint_abs", scene)[:, :7]
    reached = demo.states[1:, 1 + scene.arm]
    assert np.abs(targets - reached).max() > 0.02  # led, not only copied
    assert controller_of("joint_abs") == "joint_position"
    still = np.abs(demo.states[1:, 1 + scene.physics.nq + scene.arm]).max(-1) < 0.02
    if still.any():
        np.testing.assert_allclose(targets[still], reached[still], atol=0.01)
