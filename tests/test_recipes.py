"""The recipes of CONTRIBUTING.md, followed to the letter in a copy of jaxcam."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pages import blocks_of
from places import REPO

import jaxcam

SCRIPT = """
import json, sys
from pathlib import Path

import jax
import numpy as np
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.train import TrainConfig
from jaxcam.data.collection import collect
from jaxcam.interop.recordings import read_recording
from jaxcam.models import PolicySpec, make_policy, policy_settings
from jaxcam.models.policy import blank_stats
from jaxcam.runs.identity import resolve

out, shown = Path(sys.argv[1]), {}


def policy_for(**settings):
    config = resolve(TrainConfig(preset="laptop", resolution=24, **settings), accelerator=False)
    settings = policy_settings(config, ["Lift"])
    spec = PolicySpec(7, 11, 1, 24, 24, settings.chunk)
    return make_policy(settings, spec, blank_stats(spec))


demos = collect(CollectConfig("lift_high", demos=1, validation=0, n=1, m=0, data_dir=str(out)))
(demo,) = demos.train
cube = demos.world.qpos_of("cube") + 2
shown["task"] = float(demo.qpos[:, cube].max() - demo.qpos[0, cube])

rng, pose = np.random.default_rng(0), np.diag([1.0, -1, -1, 1])
pose[2, 3] = 1
obs = {
    "image": rng.integers(0, 256, (1, 1, 24, 24, 3), np.uint8),
    "K": np.float32([[[[30, 0, 12], [0, 30, 12], [0, 0, 1]]]]),
    "base_from_camera": np.float32(pose)[None, None],
    "proprio": rng.normal(size=(1, 11)).astype(np.float32),
}
plain = policy_for(policy="plain")
batch = obs | {"action": rng.normal(size=(1, 8, 7)), "is_pad": np.arange(8)[None] > 5}
params = plain.init(jax.random.key(0))
value, slope = jax.value_and_grad(lambda p: plain.loss(p, batch, None)[0])(params)
better = jax.tree.map(lambda p, g: p - 0.1 * g, params, slope)
shown["policy"] = [float(value), float(plain.loss(better, batch, None)[0])]

told = policy_for(conditioning="rotation")
params = told.init(jax.random.key(0))
moved, turned = pose.copy(), pose.copy()
moved[0, 3] += 0.3
turned[:3, :3] = pose[:3, :3] @ np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
acts = [
    np.asarray(told.act(params, obs | {"base_from_camera": np.float32(p)[None, None]}, None))
    for p in (pose, moved, turned)
]
shown["conditioning"] = [float(abs(act - acts[0]).max()) for act in acts[1:]]

folder = out / "recorded"
folder.mkdir()
for number in range(2):
    np.savez(folder / f"{number}.npz", state=np.zeros((3, 2)), action=np.zeros((3, 2)),
             pictures=np.full((3, 8, 10, 3), 7, np.uint8),
             K=[[9, 0, 5], [0, 9, 4], [0, 0, 1]], base_from_camera=pose)
recording = read_recording(folder)
sight = recording.episodes[1].sights["front"]
shown["format"] = [len(recording.episodes), sight.height, sight.width, len(list(sight.decode()))]
shown["pose"] = sight.calibration.base_from_camera.tolist()
print(json.dumps(shown))
"""


def changed(text, diff):
    """A file's text, with what a diff says in the place of what it says."""
    old, new = [], []
    for line in [*diff.splitlines(), "-"]:
        if line.startswith("-") and new:
            before, after = "\n".join(old), "\n".join(new)
            assert text.count(before) == 1, before
            text, old, new = text.replace(before, after), [], []
        (old if line.startswith("-") else new).append(line[1:])
    return text


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """What a copy of jaxcam does that has been changed as all recipes say."""
    root = tmp_path_factory.mktemp("recipes")
    installed = Path(jaxcam.__file__).parent  # with what was compiled of it
    shutil.copytree(installed, root / "jaxcam")
    steps = 0
    for block in blocks_of(REPO / "CONTRIBUTING.md"):
        head, _, rest = block.text.partition("\n")
        if head.startswith("# jaxcam/"):
            file = root / head.removeprefix("# ")
            assert file.exists() == (block.language == "diff")
            file.write_text(changed(file.read_text(), rest) if file.exists() else rest)
            steps += 1
    assert steps == 12
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(root)], capture_output=True, text=True, cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_a_task(followed):
    assert followed["task"] > 0.08


def test_a_policy(followed):
    before, after = followed["policy"]
    assert after < before


def test_a_conditioning(followed):
    moved, turned = followed["conditioning"]
    assert moved == 0
    assert turned > 1e-6


def test_a_format(followed):
    assert followed["format"] == [2, 8, 10, 3]
    assert followed["pose"][2] == [0, 0, -1, 1]
