"""Checkpoints as LeRobot writes them, by default without weights: no network has to be built."""

import json

import numpy as np
from places import GOLDEN

CONFIGS = json.loads((GOLDEN / "lerobot_configs.json").read_text())
"""What LeRobot writes of each policy's defaults, by version and policy."""
PROPRIO, ACTION, SIDE = 11, 7, 64
VIEW = "observation.images.view_0"
FEATURES = {
    "input_features": {
        VIEW: {"type": "VISUAL", "shape": [3, SIDE, SIDE]},
        "observation.state": {"type": "STATE", "shape": [PROPRIO]},
    },
    "output_features": {"action": {"type": "ACTION", "shape": [ACTION]}},
}


def config_of(kind, version="0.6.1", **changes):
    """A `config.json` of one view."""
    return CONFIGS[version][kind] | json.loads(json.dumps(FEATURES)) | changes


def statistics():
    """Of the features; colours as ImageNet's."""
    stats = {}
    for name, size in (("observation.state", PROPRIO), ("action", ACTION)):
        ends = {"mean": 0.5, "std": 0.25, "min": -1.0, "max": 1.0}
        stats |= {f"{name}.{k}": np.full(size, v, np.float32) for k, v in ends.items()}
    pair = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
    colours = {k: np.reshape(np.float32(v), (3, 1, 1)) for k, v in pair.items()}
    return stats | {f"{VIEW}.{k}": v for k, v in colours.items()}


def write_folder(folder, kind, version="0.6.1", **changes):
    """A checkpoint's files but its weights."""
    from jaxcam.interop.lerobot.pipelines import write_pipelines  # needs an extra

    folder.mkdir(exist_ok=True)
    config = config_of(kind, version, **changes)
    (folder / "config.json").write_text(json.dumps(config))
    write_pipelines(folder, config, statistics())
    if kind == "smolvla":
        edited(folder, "policy_preprocessor.json", lambda c: c["steps"].extend(WORDS))
    return folder


WORDS = [
    {"registry_name": "smolvla_new_line_processor", "config": {}},
    {
        "registry_name": "tokenizer_processor",
        "config": {
            "max_length": 48,
            "task_key": "task",
            "padding_side": "right",
            "padding": "longest",
            "truncation": True,
            "tokenizer_name": "HuggingFaceTB/SmolVLM2-500M-Video-Instruct",
        },
    },
]


def edited(folder, name, change):
    """A file of a checkpoint, changed."""
    content = json.loads((folder / name).read_text())
    change(content)
    (folder / name).write_text(json.dumps(content))
