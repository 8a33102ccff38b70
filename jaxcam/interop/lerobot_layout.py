"""Settings of ACT and Diffusion Policy in LeRobot's words (version 0.4.4), there and back.

LeRobot's networks know no cameras, so only policies without a ray path have a place in them. Images
are called as `jaxcam.lerobot` calls them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxcam.errors import CheckpointError
from jaxcam.models import FAMILIES, PolicySpec
from jaxcam.models.fusion import IMAGENET_MEAN, IMAGENET_STD
from jaxcam.models.normalization import LEROBOT_STD_FLOOR
from jaxcam.models.weights.names_robot import Arrays, restore_act, restore_diffusion

STATE, ACTION, IMAGE = "observation.state", "action", "observation.images.view_{}"
SCALINGS = {
    "imagenet": (IMAGENET_MEAN, IMAGENET_STD),
    "symmetric": (np.full(3, 0.5, np.float32), np.full(3, 0.5, np.float32)),
    "unit": (np.zeros(3, np.float32), np.ones(3, np.float32)),
}
"""Mean and deviation of colours in 0 to 1, by the name of our scaling."""


@dataclass(frozen=True)
class Counterpart:
    """One policy of LeRobot's and what it is here.

    Attributes:
        title: Of the policy's file of weights, see `jaxcam.models.weights.names`.
        prefix: Of its arrays.
        same: Their settings that are ours, under another name.
        ours: Values that ours must have.
        theirs: Values that theirs must have.
        scaling: Modes by kind of feature.
        restore: Brings arrays to their names, see `NameMap.prepare`.
    """

    title: str
    prefix: str
    same: Mapping[str, str]
    ours: Mapping[str, Any]
    theirs: Mapping[str, Any]
    scaling: Mapping[str, str]
    restore: Callable[[Arrays], Arrays]


COUNTERPARTS = {
    "act": Counterpart(
        title="ACT (LeRobot)",
        prefix="model.",
        same={
            "chunk_size": "chunk", "n_action_steps": "execute", "pre_norm": "pre_norm",
            "dim_model": "width", "n_heads": "heads", "dim_feedforward": "hidden",
            "n_encoder_layers": "layers", "latent_dim": "latent_dim",
            "n_vae_encoder_layers": "latent_layers", "dropout": "dropout", "kl_weight": "kl_weight",
        },
        ours={
            "network": "none", "encoder": "resnet18", "norm": "frozen", "pool": "grid",
            "head": "transformer", "image_positions": "sine", "learned_cls": True, "pose_tokens": 0,
            "drop_proprio": False, "keyframe_weight": 0.0,
        },
        theirs={
            "n_obs_steps": 1, "vision_backbone": "resnet18", "n_decoder_layers": 1, "use_vae": True,
            "replace_final_stride_with_dilation": False, "feedforward_activation": "relu",
        },
        scaling={"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"},
        restore=restore_act,
    ),
    "diffusion": Counterpart(
        title="Diffusion Policy (LeRobot)",
        prefix="diffusion.",
        same={
            "horizon": "chunk", "n_action_steps": "execute", "n_obs_steps": "obs_steps",
            "spatial_softmax_num_keypoints": "keypoints", "down_dims": "channels",
            "use_separate_rgb_encoder_per_camera": "encoder_per_view", "kernel_size": "kernel",
            "n_groups": "groups", "diffusion_step_embed_dim": "step_width",
            "num_train_timesteps": "noising_steps", "num_inference_steps": "sample_steps",
        },
        ours={
            "network": "none", "encoder": "resnet18", "norm": "group", "encoder_width": 512,
            "pool": "softmax", "heat_gain": 1.0, "features_relu": True, "hidden": (),
            "local_proprio": False, "drop_proprio": False, "keyframe_weight": 0.0,
            "temperature": 1.0,
        },
        theirs={
            "vision_backbone": "resnet18", "resize_shape": None, "use_group_norm": True,
            "use_film_scale_modulation": True, "beta_schedule": "squaredcos_cap_v2",
            "prediction_type": "epsilon", "clip_sample": True, "clip_sample_range": 1.0,
        },
        scaling={"VISUAL": "MEAN_STD", "STATE": "MIN_MAX", "ACTION": "MIN_MAX"},
        restore=restore_diffusion,
    ),
}  # fmt: skip


def config_of(settings: Any, spec: PolicySpec, ensemble: float = 0.0) -> dict[str, Any]:
    """LeRobot's `config.json` of a policy.

    Args:
        settings: The policy's.
        spec: Its sizes.
        ensemble: Rate of temporal ensembling, 0 is off.

    Raises:
        CheckpointError: LeRobot's network has no place for it.
    """
    name = next(n for n, family in FAMILIES.items() if family.config is type(settings))
    counterpart = COUNTERPARTS[name]
    wrong = [
        f"{key} is {value}, not {wanted}"
        for key, wanted in counterpart.ours.items()
        if (value := getattr(settings, key)) != wanted
    ]
    wrong += _unequal_sizes(name, settings)
    if wrong:
        raise CheckpointError(
            f"LeRobot's {counterpart.title.split(' (')[0]} has no place for this policy: "
            f"{'; '.join(wrong)}. What it has is --preset lerobot with --conditioning none."
        )
    same = {theirs: getattr(settings, ours) for theirs, ours in counterpart.same.items()}
    left = spec.chunk - spec.obs_steps + 1
    same["n_action_steps"] = min(settings.execute or left, left)
    if name == "act":
        same |= {"pretrained_backbone_weights": None}
        if ensemble:
            same |= {"temporal_ensemble_coeff": ensemble, "n_action_steps": 1}
    else:
        crop = [settings.crop] * 2 if settings.crop else None
        masked = settings.padding not in ("counted", "sample")
        same["use_separate_rgb_encoder_per_camera"] &= spec.views > 1
        same |= {"noise_scheduler_type": settings.sampler.upper(), "crop_shape": crop}
        same |= {"do_mask_loss_for_padding": masked}
    views = {
        IMAGE.format(v): {"type": "VISUAL", "shape": [3, spec.height, spec.width]}
        for v in range(spec.views)
    }
    return {
        "type": name,
        "device": "cpu",
        "push_to_hub": False,
        "input_features": views | {STATE: {"type": "STATE", "shape": [spec.proprio_dim]}},
        "output_features": {ACTION: {"type": "ACTION", "shape": [spec.action_dim]}},
        "normalization_mapping": dict(counterpart.scaling),
        **counterpart.theirs,
        **same,
    }


def _unequal_sizes(name: str, settings: Any) -> list[str]:
    """Sizes that are free here and not there."""
    if name == "act":
        if not settings.latent_dim:
            return ["latent_dim is 0"]
        same = settings.encoder_width == settings.width
        return [] if same else [f"encoder_width is {settings.encoder_width}, not as width"]
    wrong = []
    if settings.features != 2 * settings.keypoints:
        wrong.append(f"features is {settings.features}, not twice the keypoints")
    if settings.chunk % (multiple := 2 ** len(settings.channels)):
        wrong.append(f"chunk is {settings.chunk}, not a multiple of {multiple}")
    return wrong


def settings_of(config: Mapping[str, Any], image_scaling: str) -> tuple[Any, PolicySpec]:
    """Our settings and sizes of a policy whose `config.json` this is.

    Args:
        config: LeRobot's.
        image_scaling: One of `SCALINGS`.

    Raises:
        CheckpointError: Our network has no place for it.
    """
    name = config.get("type", "")
    if name not in COUNTERPARTS:
        known = " and ".join(COUNTERPARTS)
        raise CheckpointError(f"It is of policy '{name}'; {known} can be read.")
    counterpart, inputs = COUNTERPARTS[name], config["input_features"]
    shapes = [tuple(f["shape"]) for f in inputs.values() if f["type"] == "VISUAL"]
    wrong = _unequal_values(config, counterpart)
    if len(set(shapes)) != 1 or len(inputs) != len(shapes) + 1 or STATE not in inputs:
        wrong.append(f"inputs are {', '.join(inputs)}, not images of one size and {STATE}")
    if wrong:
        raise CheckpointError(f"Our {name} has no place for it: {'; '.join(wrong)}.")
    same = {ours: config[theirs] for theirs, ours in counterpart.same.items()}
    same = {k: tuple(v) if isinstance(v, list) else v for k, v in same.items()}
    same |= _act_alone(same) if name == "act" else _diffusion_alone(same, config)
    ours = {("twin_of" if k == "network" else k): v for k, v in counterpart.ours.items()}
    same["image_scaling"] = image_scaling
    settings = replace(FAMILIES[name].presets["lerobot"], **(ours | same))
    spec = PolicySpec(
        action_dim=config["output_features"][ACTION]["shape"][0],
        proprio_dim=inputs[STATE]["shape"][0],
        views=len(shapes),
        height=shapes[0][1],
        width=shapes[0][2],
        chunk=settings.chunk,
        obs_steps=settings.obs_steps,
    )
    return settings, spec


def _unequal_values(config: Mapping[str, Any], counterpart: Counterpart) -> list[str]:
    """Their settings that have other values than ours can have."""
    wanted = {**counterpart.theirs, "normalization_mapping": counterpart.scaling}
    return [
        f"{key} is {config[key]}, not {value}"
        for key, value in wanted.items()
        if config.get(key, value) != value
    ]


def _act_alone(same: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that only our ACT has, from those that both have."""
    return {
        "encoder_width": same["width"],
        "pad_head": False,
        "action_std_floor": LEROBOT_STD_FLOOR,
    }


def _diffusion_alone(same: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that only our Diffusion Policy has, or that it has in other words."""
    return {
        "sample_steps": same["sample_steps"] or same["noising_steps"],
        "sampler": config["noise_scheduler_type"].lower(),
        "crop": (config["crop_shape"] or [0])[0],
        "features": 2 * same["keypoints"],
        "padding": "zeroed" if config["do_mask_loss_for_padding"] else "counted",
    }
