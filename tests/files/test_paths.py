"""A path means the same however it is written: relative, absolute, through a link or with `~`."""

import os
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from policy_inputs import start
from running import exit_code

from jaxcam.config.datasets import CollectConfig
from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.data.collection import dataset_path
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.files.jsonl import read_jsonl
from jaxcam.files.paths import absolute, home, read_bytes, read_text
from jaxcam.models import FAMILIES, PolicySpec, make_policy
from jaxcam.runs.grid import read_grid
from jaxcam.runs.identity import resolve
from jaxcam.sim.actions import action_dim
from jaxcam.sim.world import PROPRIO_DIM
from jaxcam.training.checkpoint import Checkpoints, checkpoint_steps
from jaxcam.training.side import make_side
from jaxcam.training.state import init_state, make_optimizer

SIDE = 16
SMALL = {
    "chunk": 6, "execute": 2, "width": 16, "encoder_width": 16, "heads": 2, "hidden": 24,
    "layers": 1, "latent_layers": 1, "latent_dim": 4,
}  # fmt: skip
WAYS = {
    "relative": "runs/a",
    "with a dot": "./runs/a/",
    "absolute": "{here}/runs/a",
    "through a link": "linked/a",
    "home": "~/runs/a",
    "up and down": "runs/../runs/a",
    "from within": ".",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a run of a tiny ACT, whose only checkpoint is whole, and a link to its runs."""
    here = tmp_path_factory.mktemp("place")
    settings = replace(FAMILIES["act"].presets["lerobot"], **SMALL)  # pyright: ignore
    config = TrainConfig(
        preset="lerobot", conditioning="none", resolution=SIDE, run_dir="runs/a", pairs=1
    )
    config = resolve(config, accelerator=False)
    action = action_dim(config.action_space)
    spec = PolicySpec(action, PROPRIO_DIM, 1, SIDE, SIDE, settings.chunk, settings.obs_steps)
    sizes = {"action": action, "proprio": PROPRIO_DIM, "keyframe": 3}
    stats = {
        f"{name}_{kind}": np.full(size, value, np.float32)
        for name, size in sizes.items()
        for kind, value in (("mean", 0), ("std", 1), ("min", -1), ("max", 1))
    }
    policy = make_policy(settings, spec, stats)
    params = start(policy)
    optimizer = make_optimizer(config, policy.trained)
    state = init_state(lambda key: params, optimizer, jax.random.key(0))
    side = make_side(config, settings=settings, spec=spec, stats=stats, data="none")
    (here / "runs" / "a").mkdir(parents=True)
    (here / "runs" / "a" / "config.json").write_text(to_json(config))
    with Checkpoints(here / "runs" / "a" / "checkpoints") as checkpoints:
        checkpoints.save(state, side)
    (here / "linked").symlink_to("runs")
    return here


@pytest.fixture(params=WAYS)
def path(request, place, monkeypatch):
    """The run's path, written in one way."""
    way = WAYS[request.param]
    monkeypatch.chdir(place / "runs" / "a" if way == "." else place)
    monkeypatch.setenv("HOME", str(place))
    return way.format(here=place)


def test_the_doctor_reads_the_checkpoints(path, capsys):
    assert exit_code("check", path) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "all 1 are what was written: 0" in text
    assert checkpoint_steps(path) == [0]


@pytest.mark.parametrize(
    "path", ["relative", "through a link", "home", "from within"], indirect=True
)
def test_an_evaluation_is_of_the_same_run(path, place):
    assert exit_code("evaluate", path, "--pairs", 1, "--width", 1, "--videos", 0) == 0
    (row,) = read_jsonl(place / "runs" / "a" / "eval" / "rows.jsonl")
    assert row["run"] == "a"


def test_weights_are_exported(path, place, capsys):
    pytest.importorskip("safetensors")
    out = f"{path}/../exported"
    assert exit_code("weights", path, "--export", out) == 0
    weights = place / "runs" / "exported" / "model.safetensors"
    assert weights.is_file()
    capsys.readouterr()
    assert exit_code("weights", f"{out}/model.safetensors") == 0
    assert "backbone" in capsys.readouterr().out
    for file in weights.parent.iterdir():
        file.unlink()
    weights.parent.rmdir()


@pytest.mark.parametrize(
    "argv",
    [
        ("check", "~/none.hdf5"),
        ("replay", "~/none.hdf5"),
        ("robomimic", "~/none.hdf5"),
        ("maniskill", "~/none.hdf5"),
        ("lerobot", "~/none.hdf5", "~/out"),
        ("train", "--dataset=~/none.hdf5"),
        ("report", "~/none"),
        ("sweep", "~/none.yaml"),
    ],
    ids=lambda argv: argv[0],
)
def test_commands_look_in_the_home(tmp_path, monkeypatch, capsys, argv):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert exit_code(*argv) != 0
    words = "".join(capsys.readouterr()).replace("│", "")
    assert f"{tmp_path}/none" in "".join(words.split())
    assert not list(tmp_path.iterdir())


def test_runs_of_a_grid_and_datasets_in_the_home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "grid.yaml").write_text(
        "runs_dir: ~/runs\nruns:\n  - {policy: act, preset: laptop, seed: 0}\n"
    )
    grid = read_grid("~/grid.yaml")
    assert grid.runs_dir == tmp_path / "runs"
    assert all(str(run.folder).startswith(str(tmp_path)) for run in grid.runs)
    assert dataset_path(CollectConfig(data_dir="~/data")).parent == tmp_path / "data"


def test_what_paths_mean(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    assert absolute(".") == tmp_path
    assert absolute("~/a") == tmp_path / "me" / "a"
    assert home("~nobody-of-this-name/a") == Path("~nobody-of-this-name/a")
    (tmp_path / "deep" / "er").mkdir(parents=True)
    os.symlink("deep/er", tmp_path / "link")
    assert absolute("link") == tmp_path / "link"
    assert absolute("link/..") == (tmp_path / "deep").resolve()


@pytest.mark.parametrize("make", [absolute, home])
def test_an_empty_path_is_not_the_working_directory(make):
    """As `"$RUN"` is where nobody has set it."""
    with pytest.raises(ConfigError, match="A path is empty"):
        make("")


def test_giants_pipes_and_devices_are_not_read(tmp_path):
    """Sparse files, which take no disk, would take all memory."""
    giant, pipe, device = (tmp_path / name for name in ("giant", "pipe", "device"))
    with open(giant, "wb") as file:
        file.truncate(1 << 40)
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    for path, words in ((giant, "1099512 MB"), (pipe, "regular"), (device, "regular")):
        for read in (read_bytes, read_text):
            with pytest.raises(OSError, match=words):
                read(path)
        with pytest.raises(DatasetError, match="cannot be read"):
            read_jsonl(path)
    giant.write_bytes(b"a\xff")
    assert read_text(giant, "replace") == "a\ufffd"
    assert read_bytes(giant, most=2) == b"a\xff"
