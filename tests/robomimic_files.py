"""Files in robomimic's layout, made of episodes that robosuite 1.4.1 and 1.5.2 recorded."""

import json

import h5py
import numpy as np
from places import GOLDEN

from jaxcam.config.datasets import RobomimicConfig
from jaxcam.interop.robomimic import import_demos

VERSIONS = ("1.4", "1.5")
EPISODES = 2


def recorded(version):
    """The recorded arrays, env_args decoded."""
    arrays = dict(np.load(GOLDEN / f"robomimic_lift_{version}.npz"))
    return {**arrays, "env_args": json.loads(str(arrays["env_args"]))}


def write(path, parts, *, mask=None, leave_out=()):
    """A file in robomimic's layout."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["total"] = sum(len(parts[f"states_{i}"]) for i in range(EPISODES))
        data.attrs["env_args"] = json.dumps(parts["env_args"])
        for i in range(EPISODES):
            demo = data.create_group(f"demo_{i}")
            demo.attrs["num_samples"] = len(parts[f"states_{i}"])
            if "model_file" not in leave_out:
                demo.attrs["model_file"] = str(parts[f"model_{i}"])
            for name in {"states", "actions"} - set(leave_out):
                demo[name] = parts[f"{name}_{i}"]
        for key, names in (mask or {}).items():
            file[f"mask/{key}"] = np.array(names, "S8")
    return path


def imported(path, **settings):
    out = path.with_name(f"out{len(list(path.parent.glob('out*')))}.hdf5")
    return import_demos(RobomimicConfig(file=str(path), out=str(out), **settings))


def of_many(path, count, masks):
    """A file of `count` demonstrations, two recorded ones in turn."""
    parts = recorded("1.5")
    with h5py.File(path, "w") as file:
        file.create_group("data").attrs["env_args"] = json.dumps(parts["env_args"])
        for i in range(count):
            demo = file.create_group(f"data/demo_{i}")
            demo.attrs["model_file"] = str(parts[f"model_{i % 2}"])
            demo["states"], demo["actions"] = parts[f"states_{i % 2}"], parts[f"actions_{i % 2}"]
        for key, numbers in masks.items():
            file[f"mask/{key}"] = np.array([f"demo_{i}" for i in numbers], "S8")
    return path
