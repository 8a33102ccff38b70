"""Write `lerobot_fields.json`: what LeRobot computes when one setting is another than usual.

    pip install torch numpy einops
    pip install --no-deps lerobot==0.4.4 diffusers==0.35.2 torchvision "huggingface_hub<1" draccus
    python tests/golden/make_lerobot_fields.py

and whatever small packages those miss; `BLANK` lists parts of LeRobot, and packages, that are
replaced by nothing. Policies are tiny, weights are made by their names (`weight` of
`lerobot_networks.py`, which the test has too), noise is zero. A setting whose value LeRobot itself
refuses has no actions. The test holds ours against each: equal, or refused.
"""

import functools
import importlib.abc
import importlib.machinery
import json
import sys
import tempfile
import zlib
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from unittest.mock import MagicMock

import numpy as np
import torch

BLANK = (
    "datasets", "accelerate", "pyarrow", "lerobot.datasets", "lerobot.robots",
    "lerobot.teleoperators", "lerobot.motors", "lerobot.envs", "lerobot.cameras",
    "torchvision._meta_registrations", "torchvision._autograd_registrations", "serial",
    "deepdiff", "gymnasium", "wandb",
)  # fmt: skip


class Blank(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Modules that nothing here uses."""

    def find_spec(self, fullname, path=None, target=None):
        del path, target
        if any(fullname == part or fullname.startswith(part + ".") for part in BLANK):
            return importlib.machinery.ModuleSpec(fullname, self, is_package=True)
        return None

    def create_module(self, spec) -> ModuleType:
        del spec
        module = MagicMock()
        module.__path__ = []
        module.__version__ = "0.0.1"
        return module

    def exec_module(self, module: ModuleType) -> None:
        pass


sys.meta_path.insert(0, Blank())

import diffusers.schedulers.scheduling_ddpm as ddpm  # noqa: E402
from lerobot.configs.types import FeatureType, PolicyFeature  # noqa: E402
from lerobot.policies.act.modeling_act import ACTConfig, ACTPolicy  # noqa: E402
from lerobot.policies.diffusion.modeling_diffusion import (  # noqa: E402
    DiffusionConfig,
    DiffusionPolicy,
)
from lerobot.policies.factory import make_pre_post_processors  # noqa: E402
from lerobot.policies.utils import populate_queues  # noqa: E402

ddpm.randn_tensor = lambda shape, **_: torch.zeros(shape)
STATE, ACTION, VIEWS, SIDE = 11, 7, 2, 64
SHARED = {
    "device": ["cpu"], "use_amp": [True], "use_peft": [True], "push_to_hub": [False],
    "repo_id": ["me/mine"], "private": [True], "tags": [["a"]], "license": ["mit"],
    "pretrained_path": ["there"], "optimizer_lr": [0.1], "optimizer_weight_decay": [0.1],
}  # fmt: skip
KINDS = {
    "act": (
        ACTConfig,
        ACTPolicy,
        {
            "chunk_size": 6, "n_action_steps": 6, "dim_model": 16, "n_heads": 2,
            "dim_feedforward": 24, "n_encoder_layers": 1, "n_vae_encoder_layers": 1,
            "latent_dim": 4, "pretrained_backbone_weights": None,
        },
        SHARED | {
            "n_obs_steps": [2], "chunk_size": [9], "n_action_steps": [4, 0],
            "vision_backbone": ["resnet34"], "replace_final_stride_with_dilation": [True],
            "pre_norm": [True], "dim_model": [24], "n_heads": [4], "dim_feedforward": [40],
            "feedforward_activation": ["gelu"], "n_encoder_layers": [2], "n_decoder_layers": [2],
            "use_vae": [False], "latent_dim": [6], "n_vae_encoder_layers": [2],
            "temporal_ensemble_coeff": [0.01], "dropout": [0.5], "kl_weight": [1.0],
            "optimizer_lr_backbone": [0.1],
        },
    ),
    "diffusion": (
        DiffusionConfig,
        DiffusionPolicy,
        {
            "horizon": 8, "n_action_steps": 4, "down_dims": (16, 32), "kernel_size": 3,
            "diffusion_step_embed_dim": 16, "spatial_softmax_num_keypoints": 4,
            "noise_scheduler_type": "DDIM", "num_inference_steps": 3,
        },
        SHARED | {
            "n_obs_steps": [1], "horizon": [16], "n_action_steps": [2, 0],
            "drop_n_last_frames": [3], "vision_backbone": ["resnet34"],
            "resize_shape": [(48, 48)], "crop_ratio": [0.5], "crop_shape": [(40, 40), (40, 56)],
            "crop_is_random": [False], "use_group_norm": [False],
            "spatial_softmax_num_keypoints": [6], "use_separate_rgb_encoder_per_camera": [True],
            "down_dims": [(16, 32, 64)], "kernel_size": [5, 4], "n_groups": [4, 16],
            "diffusion_step_embed_dim": [32], "use_film_scale_modulation": [False],
            "noise_scheduler_type": ["DDPM"], "num_train_timesteps": [50],
            "beta_schedule": ["linear"], "beta_start": [0.01], "beta_end": [0.5],
            "prediction_type": ["sample"], "clip_sample": [False], "clip_sample_range": [0.5],
            "num_inference_steps": [None, 7], "compile_mode": ["default"],
            "do_mask_loss_for_padding": [True], "optimizer_betas": [(0.5, 0.5)],
            "optimizer_eps": [0.1], "scheduler_name": ["linear"], "scheduler_warmup_steps": [1],
        },
    ),
}  # fmt: skip
"""Settings of both policies: the usual ones of this test, and others of each."""
NOT_VARIED = {
    "input_features", "output_features", "normalization_mapping",  # by the test
    "pretrained_backbone_weights",  # would download
    "compile_model",  # changes the names of weights
}  # fmt: skip


@functools.cache
def weight(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The array of a name: seeded by it, with a spread that keeps activations near 1."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if name.endswith("running_var"):
        return (1 + 0.5 * np.abs(values)).astype(np.float32)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + name.endswith("weight")).astype(np.float32)


def statistics() -> dict[str, dict[str, np.ndarray]]:
    """Of the features; the first number never varied, the second hardly."""
    rng, stats = np.random.RandomState(0), {}
    for name, size in (("observation.state", STATE), ("action", ACTION)):
        low, width = rng.normal(size=size), rng.uniform(0.5, 2, size)
        width[:2] = 0, 5e-4
        stats[name] = {"mean": low + width / 2, "std": width / 3, "min": low, "max": low + width}
    for view in range(VIEWS):
        ends = {"min": 0.0, "max": 1.0}
        pair = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)} | ends
        spread = {k: np.ones((3, 1, 1)) * np.reshape(v, (-1, 1, 1)) for k, v in pair.items()}
        stats[f"observation.images.view_{view}"] = spread
    return {
        f: {k: v.astype(np.float32) for k, v in by_name.items()} for f, by_name in stats.items()
    }


def observation(steps: int) -> dict[str, np.ndarray]:
    """Pictures uint8 [S, V, H, W, 3] and states [S, P] near the middle of the statistics."""
    rng, state = np.random.RandomState(1), statistics()["observation.state"]
    drawn = rng.normal(size=(2, STATE))[:steps]
    return {
        "image": rng.randint(0, 256, (2, VIEWS, SIDE, SIDE, 3)).astype(np.uint8)[:steps],
        "proprio": (state["mean"] + state["std"] * drawn).astype(np.float32),
    }


def features() -> dict[str, dict[str, PolicyFeature]]:
    """What goes in and what comes out."""
    views = {
        f"observation.images.view_{v}": PolicyFeature(FeatureType.VISUAL, (3, SIDE, SIDE))
        for v in range(VIEWS)
    }
    state = {"observation.state": PolicyFeature(FeatureType.STATE, (STATE,))}
    action = {"action": PolicyFeature(FeatureType.ACTION, (ACTION,))}
    return {"input_features": views | state, "output_features": action}


def run(kind: str, changes: dict) -> dict:
    """A policy's files and, unless it cannot be, its actions."""
    make_config, make_policy, usual, _ = KINDS[kind]
    config = make_config(**usual | {"device": "cpu"} | changes, **features())
    with tempfile.TemporaryDirectory() as folder:
        config._save_pretrained(Path(folder))
        record = {"config": json.loads((Path(folder) / "config.json").read_text())}
    config.device = "cpu"
    policy = make_policy(config).eval()
    shapes = {}
    for name, array in policy.state_dict().items():
        if array.ndim and not name.endswith(("pos_grid", "pos_enc")):
            shapes[name] = list(array.shape)
            with torch.no_grad():
                array.copy_(torch.from_numpy(weight(name, tuple(array.shape))))
    before, after = make_pre_post_processors(config, dataset_stats=statistics())
    record["shapes"] = shapes
    steps = config.n_obs_steps
    obs, actions = observation(steps), []
    policy.reset()
    for image, state in zip(obs["image"], obs["proprio"], strict=True):
        batch = {"observation.state": torch.from_numpy(state)}
        for v in range(VIEWS):
            picture = torch.from_numpy(image[v]).permute(2, 0, 1) / 255
            batch[f"observation.images.view_{v}"] = picture
        noise = {}
        if kind == "diffusion":
            noise = {"noise": torch.zeros(1, config.horizon, ACTION)}
            policy._queues["action"].clear()
            ready = before(batch)
            images = [ready[k] for k in config.image_features]
            ready = {k: v for k, v in ready.items() if isinstance(v, torch.Tensor)}
            ready["observation.images"] = torch.stack(images, dim=-4)
            policy._queues = populate_queues(policy._queues, ready)
        else:
            ready = before(batch)
        with torch.no_grad():
            actions = policy.predict_action_chunk(ready, **noise)
    if kind == "act":
        actions = actions[:, : config.n_action_steps]
    record["actions"] = np.stack([after(a).numpy()[0] for a in actions.swapaxes(0, 1)]).tolist()
    return record


def main() -> None:
    """Run every case."""
    out = {}
    for kind, (make_config, _, _, varied) in KINDS.items():
        missing = {f.name for f in fields(make_config)} - varied.keys() - NOT_VARIED
        assert not missing, missing
        usual = run(kind, {})
        out[kind] = usual | {"cases": []}
        for name, values in varied.items():
            for value in values:
                changes = {name: value}
                if name == "temporal_ensemble_coeff":
                    changes["n_action_steps"] = 1
                try:
                    record = run(kind, changes)
                except Exception as error:
                    record = {"config": dict(usual["config"]) | changes}
                    print(f"{kind} {name}={value}: LeRobot says {error!r:.90}", flush=True)
                changed = {k: v for k, v in record["config"].items() if v != usual["config"].get(k)}
                # LeRobot takes some back, such as `use_amp` on a CPU; a file may say so still.
                case = {"config": changed | changes, "actions": record.get("actions")}
                if record.get("shapes", usual["shapes"]) != usual["shapes"]:
                    case["shapes"] = record["shapes"]
                out[kind]["cases"].append({"field": name, **case})
    path = Path(__file__).parent / "lerobot_fields.json"
    path.write_text(json.dumps(out) + "\n")
    print(path, path.stat().st_size)


if __name__ == "__main__":
    main()
