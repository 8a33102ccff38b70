"""The scripted expert: success, bounded commands, and an interrupted collection's seeds."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from jaxcam.config.datasets import CollectConfig
from jaxcam.data import collection as collect_module
from jaxcam.data.collection import collect, dataset_path, run_expert
from jaxcam.data.splits import FIRST_SEED, SPLITS, episode_seeds
from jaxcam.errors import SimError
from jaxcam.sim.experts import STEP
from jaxcam.sim.mujoco.native import NativeEngine


@pytest.fixture(scope="module")
def engine(lift, scene):
    return NativeEngine(scene, varied=lift.varied)


def run(lift, scene, engine, seeds):
    return run_expert(lift, scene, engine, list(seeds))


def test_expert_succeeds_and_moves_its_set_point_gently(lift, scene, engine):
    episodes = run(lift, scene, engine, range(5_000_000, 5_000_060))
    good = [d for d in episodes if d is not None]
    assert len(good) >= 0.98 * len(episodes)
    for demo in good:
        moves = np.diff(demo.actions[:, :3], axis=0)
        moves = np.linalg.norm(moves, axis=-1)
        # Only from one move of the expert to the next may the set-point jump, to where the grip is.
        assert (moves > STEP + 1e-9).sum() <= 2
        first = demo.actions[0, :3] - demo.eef_pos[0]
        assert np.linalg.norm(first) <= STEP + 1e-9
        assert demo.length <= lift.horizon
        assert set(demo.actions[:, 6]) == {-1.0, 1.0}


def test_set_point_never_jumps(lift, scene, engine):
    for demo in run(lift, scene, engine, range(5_000_000, 5_000_012)):
        assert demo is not None
        moves = np.linalg.norm(np.diff(demo.actions[:, :3], axis=0), axis=-1)
        assert moves.max() <= STEP + 1e-9


@pytest.mark.slow
def test_expert_succeeds_over_200_seeds(lift, scene, engine):
    episodes = run(lift, scene, engine, range(6_000_000, 6_000_200))
    assert sum(d is not None for d in episodes) >= 196


def test_an_episode_does_not_depend_on_its_neighbours(lift, scene, engine):
    together = run(lift, scene, engine, [11, 12, 13])
    (alone,) = run(lift, scene, engine, [12])
    assert together[1] is not None
    assert alone is not None
    for name in ("states", "actions", "eef_pos", "eef_quat", "gripper"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(together[1], name))


def test_recorded_states_are_those_of_the_commands(demos, scene):
    """The last state is lifted, the grip moves where it was told, time runs at 20 Hz."""
    cube = scene.qpos_of("cube")
    for demo in demos.train:
        qpos = demo.qpos
        assert qpos[-1, cube + 2] > 0.84
        assert demo.gripper[0] == 0
        assert demo.gripper[-1] == 1
        late = np.linalg.norm(demo.eef_pos[1:] - demo.actions[:, :3], axis=-1)
        assert np.median(late) < 0.04


class Sometimes:
    """Stands in for the expert: given attempts fail."""

    def __init__(self, template, fails):
        self.template, self.fails, self.asked = template, fails, []

    def __call__(self, task, scene, engine, seeds):
        self.asked += [s - FIRST_SEED for s in seeds]
        return [
            None if s - FIRST_SEED in self.fails else type(self.template)(
                **{**self.template.__dict__, "seed": s}
            )
            for s in seeds
        ]  # fmt: skip


def test_failed_episodes_are_replaced_whatever_was_interrupted(demos, tmp_path, monkeypatch):
    fails = {1, 3, 9}  # slots 1 and 3 fail once, slot 3 twice: 3 + 6
    monkeypatch.setattr(collect_module, "BATCH", 2)
    seeds = []
    for stop_after in (None, 3):
        config = CollectConfig(demos=4, validation=2, data_dir=str(tmp_path / str(stop_after)))
        expert = Sometimes(demos.train[0], fails)
        monkeypatch.setattr(collect_module, "run_expert", expert)
        if stop_after:
            append = collect_module.DemoWriter.append

            def stop(self, index, demo, append=append, stop_after=stop_after):
                if len(self.done) == stop_after:
                    raise KeyboardInterrupt
                append(self, index, demo)

            with monkeypatch.context() as patch:
                patch.setattr(collect_module.DemoWriter, "append", stop)
                with pytest.raises(KeyboardInterrupt):
                    collect(config)
            assert not dataset_path(config).exists()
        collected = collect(config)
        seeds.append([d.seed - FIRST_SEED for d in collected.episodes])
    assert seeds[0] == [0, 7, 2, 15, 4, 5]
    assert seeds[1] == seeds[0]


def test_a_broken_expert_stops_collection_and_keeps_what_there_is(demos, tmp_path, monkeypatch):
    expert = Sometimes(demos.train[0], set(range(5, 10_000)))
    monkeypatch.setattr(collect_module, "run_expert", expert)
    config = CollectConfig(demos=20, validation=2, data_dir=str(tmp_path))
    with pytest.raises(SimError, match=r"succeeded in 5 of 22 episodes\. At least 90% of lift"):
        collect(config)
    assert not dataset_path(config).exists()
    monkeypatch.setattr(collect_module, "run_expert", Sometimes(demos.train[0], set()))
    assert len(collect(config).train) == 20


def test_what_does_not_replay_is_replaced_and_told(demos, scene, tmp_path, monkeypatch):
    class Unsteady(Sometimes):
        def __call__(self, task, scene, engine, seeds):
            collected = super().__call__(task, scene, engine, seeds)
            states = self.template.states.copy()
            states[:, 1 + scene.qpos_of("cube")] += 0.1  # not where its commands reach
            return [replace(d, states=states) if d.seed == FIRST_SEED + 1 else d for d in collected]

    monkeypatch.setattr(collect_module, "run_expert", Unsteady(demos.train[0], set()))
    console = Console(record=True)
    config = CollectConfig(demos=3, validation=0, data_dir=str(tmp_path))
    collected = collect(config, console)
    assert [d.seed - FIRST_SEED for d in collected.train] == [0, 4, 2]
    assert f"those of seeds [{FIRST_SEED + 1}] do not replay" in " ".join(
        console.export_text().split()
    )


def test_a_dataset_without_validation_demonstrations(tmp_path, demos, monkeypatch):
    monkeypatch.setattr(collect_module, "run_expert", Sometimes(demos.train[0], set()))
    collected = collect(CollectConfig(demos=2, validation=0, data_dir=str(tmp_path)))
    assert (len(collected.train), collected.valid) == (2, [])


def test_no_dataset_has_episodes_of_the_evaluation():
    pairs = [set(range(first, first + 2000)) for first, _ in SPLITS.values()]
    for seed in range(20):
        assert all(not some.intersection(episode_seeds(seed)) for some in pairs)
        assert set(episode_seeds(seed)).isdisjoint(episode_seeds(seed + 1))
