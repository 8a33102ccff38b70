"""The settings that are names, and the values that a policy's preset gives."""

from pathlib import Path
from typing import Any

# Every file in there is a task of that name.
_TASKS = tuple(sorted(p.stem for p in Path(__file__).parents[1].glob("sim/tasks/[a-z]*.py")))

# The settings that are names, and the names there are.
NAMES: dict[str, tuple[str, ...]] = {
    "task": _TASKS,
    "scene": ("fixed", "randomized"),
    "policy": ("act", "diffusion", "smolvla"),
    "preset": ("auto", "laptop", "paper", "lerobot", "original", "tiny"),
    "conditioning": ("none", "token", "early", "late", "keypoints"),
    "action_space": (
        "eef_delta",
        "eef_abs",
        "joint_delta",
        "joint_abs",
        "eef_delta_componentwise",
    ),
    "actions": ("commands", "states"),
    "schedule": ("constant", "cosine"),
    "optimizer": ("adamw", "adam"),
    "precision": ("float32", "bfloat16"),
    "log": ("tensorboard", "wandb"),
    "stem": ("keep", "new"),
    "split": ("test", "validation"),
    "protocol": ("one", "paper"),
    "cluster": ("none", "slurm", "local"),
    "engine": ("auto", "native", "mjx-jax", "mjx-warp", "sapien", "sapien-gpu"),
}

# What presets give unless they say otherwise.
USUAL: dict[str, Any] = {
    "optimizer": "adamw", "beta1": 0.9, "beta2": 0.999, "clip_norm": 1.0, "final_lr": 0.0,
    "ema": 0.0, "ema_power": 0.0,
}  # fmt: skip

# The values a preset gives. The paper's come from the authors' released run settings; an epoch of
# theirs is 3 updates, and they evaluate and save every 1000 epochs. Those of original are the
# repositories' (2000 epochs of 200 demonstrations for ACT, about 3000 for Diffusion Policy), those
# of lerobot the defaults of its version 0.4.4.
PRESETS: dict[tuple[str, str], dict[str, Any]] = {
    ("act", "paper"): {
        "conditioning": "late", "precision": "bfloat16", "resolution": 256,
        "steps": 60_000, "batch": 70, "lr": 2e-5, "weight_decay": 1e-4,
        "schedule": "constant", "warmup": 0, "crop_min": 0.8,
        "log_every": 50, "eval_every": 3000, "save_every": 3000, "steps_per_call": 10,
    },
    ("act", "lerobot"): {
        "conditioning": "none", "precision": "float32", "resolution": 256,
        "steps": 100_000, "batch": 8, "lr": 1e-5, "weight_decay": 1e-4, "clip_norm": 10.0,
        "schedule": "constant", "warmup": 0, "crop_min": 1.0,
        "log_every": 200, "eval_every": 20_000, "save_every": 20_000, "steps_per_call": 10,
    },
    ("act", "original"): {
        "conditioning": "none", "precision": "float32", "resolution": 480,
        "steps": 50_000, "batch": 8, "lr": 1e-5, "weight_decay": 1e-4, "clip_norm": 0.0,
        "schedule": "constant", "warmup": 0, "crop_min": 1.0,
        "log_every": 50, "eval_every": 2500, "save_every": 2500, "steps_per_call": 10,
    },
    ("act", "laptop"): {
        "conditioning": "keypoints", "precision": "float32", "resolution": 84,
        "steps": 4000, "batch": 64, "lr": 1e-3, "weight_decay": 1e-4,
        "schedule": "cosine", "warmup": 200, "crop_min": 0.8,
        "log_every": 50, "eval_every": 500, "save_every": 500, "steps_per_call": 10,
    },
    ("diffusion", "paper"): {
        "conditioning": "early", "precision": "bfloat16", "resolution": 256,
        "steps": 300_000, "batch": 70, "lr": 2e-5, "weight_decay": 1e-4,
        "schedule": "constant", "warmup": 0, "crop_min": 0.8,
        "log_every": 50, "eval_every": 6000, "save_every": 6000, "steps_per_call": 10,
    },
    ("diffusion", "lerobot"): {
        "conditioning": "none", "precision": "float32", "resolution": 96,
        "steps": 100_000, "batch": 64, "lr": 1e-4, "weight_decay": 1e-6, "clip_norm": 10.0,
        "optimizer": "adam", "beta1": 0.95, "schedule": "cosine", "warmup": 500, "crop_min": 1.0,
        "log_every": 200, "eval_every": 20_000, "save_every": 20_000, "steps_per_call": 10,
    },
    ("diffusion", "original"): {
        "conditioning": "none", "precision": "float32", "resolution": 84,
        "steps": 450_000, "batch": 64, "lr": 1e-4, "weight_decay": 1e-6, "clip_norm": 0.0,
        "beta1": 0.95, "schedule": "cosine", "warmup": 500, "crop_min": 1.0,
        "ema": 0.9999, "ema_power": 0.75,
        "log_every": 150, "eval_every": 7500, "save_every": 7500, "steps_per_call": 10,
    },
    ("diffusion", "laptop"): {
        "conditioning": "keypoints", "precision": "float32", "resolution": 84,
        "steps": 4000, "batch": 64, "lr": 1e-3, "weight_decay": 1e-4,
        "schedule": "cosine", "warmup": 200, "crop_min": 0.8, "ema": 0.995, "ema_power": 0.75,
        "log_every": 50, "eval_every": 500, "save_every": 500, "steps_per_call": 10,
    },
    # The authors' first update has a rate of 0, ours one step's share of the warm-up.
    ("smolvla", "paper"): {
        "conditioning": "late", "precision": "bfloat16", "resolution": 256,
        "steps": 90_000, "batch": 70, "lr": 1e-4, "weight_decay": 1e-3,
        "schedule": "cosine", "warmup": 4500, "crop_min": 0.8,
        "log_every": 50, "eval_every": 3000, "save_every": 3000, "steps_per_call": 10,
    },
    ("smolvla", "lerobot"): {
        "conditioning": "none", "precision": "bfloat16", "resolution": 256,
        "steps": 30_000, "batch": 64, "lr": 1e-4, "weight_decay": 1e-10, "clip_norm": 10.0,
        "beta2": 0.95, "schedule": "cosine", "warmup": 1000, "final_lr": 2.5e-6, "crop_min": 1.0,
        "log_every": 200, "eval_every": 3000, "save_every": 3000, "steps_per_call": 10,
    },
    # For tests: the paper's form, small enough for a CPU, without a tokenizer.
    ("smolvla", "tiny"): {
        "conditioning": "late", "precision": "float32", "resolution": 64,
        "steps": 200, "batch": 8, "lr": 1e-3, "weight_decay": 1e-4,
        "schedule": "cosine", "warmup": 10, "crop_min": 0.8,
        "log_every": 10, "eval_every": 50, "save_every": 100, "steps_per_call": 1,
    },
}  # fmt: skip
