"""Settings of ACT and Diffusion Policy in LeRobot's words (version 0.4.4), there and back.

LeRobot's networks know no cameras, so only policies without a ray path have a place in them. Images
are called as `jaxcam.lerobot` calls them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

from jaxcam.config.fields import check_value, short
from jaxcam.errors import CheckpointError
from jaxcam.interop.lerobot.pipelines import ACTION, IMAGE, STATE, Feature, features_of
from jaxcam.models import FAMILIES, PolicySpec
from jaxcam.models.normalization import LEROBOT_STD_FLOOR
from jaxcam.models.weights.names_robot import Arrays, restore_act, restore_diffusion

LAST_GROUPS = 8
"""Groups of the last norm of LeRobot's U-Net, whatever `n_groups` says."""
MOST_PIXELS = 2**13
"""Rows or columns of a picture."""
_ALONE: dict[str, Any] = {
    "temporal_ensemble_coeff": float | None, "crop_shape": list[int] | None,
    "crop_is_random": bool, "use_group_norm": bool, "noise_scheduler_type": str,
    "do_mask_loss_for_padding": bool, "down_dims": list[int], "num_inference_steps": int | None,
}  # fmt: skip
"""Kinds of their settings whose values are none of ours."""
_FREE = {
    "device": "cpu", "push_to_hub": False, "repo_id": None, "private": None, "tags": None,
    "license": None, "pretrained_path": None, "pretrained_backbone_weights": None,
}  # fmt: skip
"""Settings of every policy that change nothing of what given weights compute, and our values."""
_PLAIN = {"use_amp": False, "use_peft": False}
"""Settings of every policy that would."""
_ELSEWHERE = {
    "type", "input_features", "output_features", "normalization_mapping", "pretrained_revision",
    "gradient_checkpointing",
}  # fmt: skip
"""Settings that are read elsewhere, or mean nothing here and are unknown to LeRobot 0.4.4."""


@dataclass(frozen=True)
class Counterpart:
    """One policy of LeRobot's and what it is here.

    Attributes:
        title: Of the policy's file of weights, see `jaxcam.models.weights.names`.
        prefix: Of its arrays.
        same: Their settings that are ours, under another name.
        ours: Values that ours must have.
        theirs: Values that theirs must have.
        alone: Their settings that become ours, or ours theirs, in other words.
        free: Their settings that change nothing of what given weights compute, and values to
            write: LeRobot's own defaults move from version to version.
        scaling: Modes by kind of feature.
        restore: Brings arrays to their names, see `NameMap.prepare`.
    """

    title: str
    prefix: str
    same: Mapping[str, str]
    ours: Mapping[str, Any]
    theirs: Mapping[str, Any]
    alone: tuple[str, ...]
    free: Mapping[str, Any]
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
            **_PLAIN,
        },
        alone=("temporal_ensemble_coeff",),
        free={
            "optimizer_lr": 1e-5, "optimizer_weight_decay": 1e-4, "optimizer_lr_backbone": 1e-5,
            **_FREE,
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
            "network": "none", "encoder": "resnet18", "encoder_width": 512, "pool": "softmax",
            "heat_gain": 1.0, "features_relu": True, "hidden": (),
            "local_proprio": False, "drop_proprio": False, "keyframe_weight": 0.0,
            "temperature": 1.0,
        },
        theirs={
            "vision_backbone": "resnet18", "resize_shape": None,
            "use_film_scale_modulation": True, "beta_schedule": "squaredcos_cap_v2",
            "prediction_type": "epsilon", "clip_sample": True, "clip_sample_range": 1.0, **_PLAIN,
        },
        alone=(
            "crop_shape", "crop_is_random", "use_group_norm", "noise_scheduler_type",
            "do_mask_loss_for_padding",
        ),
        free={
            "drop_n_last_frames": 7, "crop_ratio": 1.0, "beta_start": 1e-4, "beta_end": 0.02,
            "compile_model": False, "compile_mode": "reduce-overhead", "optimizer_lr": 1e-4,
            "optimizer_betas": [0.95, 0.999], "optimizer_eps": 1e-8, "optimizer_weight_decay": 1e-6,
            "scheduler_name": "cosine", "scheduler_warmup_steps": 500, **_FREE,
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
    ahead = spec.chunk - spec.obs_steps + 1
    same["n_action_steps"] = min(settings.execute or ahead, ahead)
    if name == "act":
        same |= {"temporal_ensemble_coeff": ensemble or None}
        same["n_action_steps"] = 1 if ensemble else same["n_action_steps"]
    else:
        crop = [settings.crop] * 2 if settings.crop else None
        masked = settings.padding not in ("counted", "sample")
        same["use_separate_rgb_encoder_per_camera"] &= spec.views > 1
        same |= {"noise_scheduler_type": settings.sampler.upper(), "crop_shape": crop}
        same |= {"do_mask_loss_for_padding": masked, "crop_is_random": settings.crop_random}
        same |= {"use_group_norm": settings.norm == "group"}
    views = {
        IMAGE.format(v): {"type": "VISUAL", "shape": [3, spec.height, spec.width]}
        for v in range(spec.views)
    }
    return {
        "type": name,
        "input_features": views | {STATE: {"type": "STATE", "shape": [spec.proprio_dim]}},
        "output_features": {ACTION: {"type": "ACTION", "shape": [spec.action_dim]}},
        "normalization_mapping": dict(counterpart.scaling),
        **counterpart.free,
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
    if settings.norm not in ("group", "frozen"):
        wrong.append(f"norm is {settings.norm}, not group or frozen")
    if (last := settings.last_groups or settings.groups) != LAST_GROUPS:
        wrong.append(f"the last norm has {last} groups (last_groups), not {LAST_GROUPS}")
    if not settings.kernel % 2:
        wrong.append(f"kernel is {settings.kernel}, which is even")
    if settings.chunk % (multiple := 2 ** len(settings.channels)):
        wrong.append(f"chunk is {settings.chunk}, not a multiple of {multiple}")
    return wrong


def check_type(config: Mapping[str, Any]) -> Counterpart:
    """The counterpart of a policy whose `config.json` this is.

    Raises:
        CheckpointError: There is none.
    """
    name = config.get("type", "")
    if not isinstance(name, str) or name not in COUNTERPARTS:
        known = " and ".join(COUNTERPARTS)
        raise CheckpointError(f"It is of policy {short(name)}; {known} can be read.")
    return COUNTERPARTS[name]


def settings_of(config: Mapping[str, Any], image_scaling: str) -> tuple[Any, PolicySpec]:
    """Our settings and sizes of a policy whose `config.json` this is.

    Args:
        config: LeRobot's.
        image_scaling: One of `jaxcam.interop.lerobot.pipelines.SCALINGS`.

    Raises:
        CheckpointError: Our network has no place for it, with everything that has none.
        ConfigError: A value is of another kind than LeRobot writes, or our policy cannot have it.
    """
    counterpart, name = check_type(config), config["type"]
    _check_kinds(config, counterpart)
    wrong = _unequal_values(config, counterpart)
    where = Path("config.json")
    inputs = features_of(where, config, "input_features")
    outputs = features_of(where, config, "output_features")
    wrong += _unequal_features(inputs, outputs)
    if not wrong:
        wrong = _act_misfits(config) if name == "act" else _diffusion_misfits(config)
    if wrong:
        raise CheckpointError(f"Our {name} has no place for it: {'; '.join(wrong)}.")
    same = {ours: config[theirs] for theirs, ours in counterpart.same.items()}
    same = {k: tuple(v) if isinstance(v, list) else v for k, v in same.items()}
    same |= _act_alone(same, config) if name == "act" else _diffusion_alone(same, config)
    ours = {("twin_of" if k == "network" else k): v for k, v in counterpart.ours.items()}
    same |= {"image_scaling": image_scaling, "floors": False}
    settings = replace(FAMILIES[name].presets["lerobot"], **(ours | same))
    shapes = [feature.shape for feature in inputs.values() if feature.type == "VISUAL"]
    spec = PolicySpec(
        action_dim=outputs[ACTION].shape[0],
        proprio_dim=inputs[STATE].shape[0],
        views=len(shapes),
        height=shapes[0][1],
        width=shapes[0][2],
        chunk=settings.chunk,
        obs_steps=settings.obs_steps,
    )
    return settings, spec


def _check_kinds(config: Mapping[str, Any], counterpart: Counterpart) -> None:
    """Refuses values of another kind than ours have, or than they are listed with."""
    hints = get_type_hints(FAMILIES[config["type"]].config)
    kinds = {theirs: hints[ours] for theirs, ours in counterpart.same.items()} | _ALONE
    for name in (*counterpart.same, *counterpart.alone):
        if name in config:
            check_value("config.json: ", name, config[name], kinds[name])


def _unequal_values(config: Mapping[str, Any], counterpart: Counterpart) -> list[str]:
    """Their settings that have other values than ours can have, that lack, or that are unknown."""
    needed = (*counterpart.same, *counterpart.alone)
    known = _ELSEWHERE.union(needed, counterpart.theirs, counterpart.free)
    return [
        *(
            f"{key} is {short(config[key])}, not {value}"
            for key, value in counterpart.theirs.items()
            if config.get(key, value) != value
        ),
        *(f"{key} is missing, which LeRobot writes" for key in needed if key not in config),
        *(f"{key} ({short(config[key])}) is unknown here" for key in config if key not in known),
    ]


def _unequal_features(inputs: Mapping[str, Feature], outputs: Mapping[str, Feature]) -> list[str]:
    """Inputs and outputs that ours lacks, or has and they lack."""
    images = [k for k, feature in inputs.items() if feature.type == "VISUAL"]
    shapes = {k: tuple(inputs[k].shape) for k in images}
    wrong = [f"input {k} is one too many" for k in inputs if k not in (*images, STATE)]
    wrong += [f"output {k} is one too many" for k in outputs if k != ACTION]
    wrong += [f"input {STATE} is missing"] if STATE not in inputs else []
    wrong += [f"output {ACTION} is missing"] if ACTION not in outputs else []
    wrong += ["images are missing among the inputs"] if not images else []
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{k} {'x'.join(map(str, shape))}" for k, shape in shapes.items())
        wrong.append(f"images are of several sizes: {listed}")
    for image, shape in shapes.items():
        if len(shape) != 3 or shape[0] != 3 or not all(0 < n <= MOST_PIXELS for n in shape):
            wrong.append(f"{image} has the shape {shape}, not (3, height, width)")
    for name, feature in {**inputs, **outputs}.items():
        if name in (STATE, ACTION) and not (len(feature.shape) == 1 and feature.shape[0] > 0):
            wrong.append(f"{name} has the shape {feature.shape}, not a number of numbers")
    ours = [IMAGE.format(v) for v in range(len(images))]
    if images != ours and sorted(images) == sorted(ours):
        wrong.append(f"it takes its images in another order: {', '.join(images)}")
    return wrong


def _act_misfits(config: Mapping[str, Any]) -> list[str]:
    """Values of ACT's settings that only some of ours have."""
    rate, steps = config["temporal_ensemble_coeff"], config["n_action_steps"]
    wrong = _unequal_steps(config)
    if rate == 0:
        wrong.append("temporal_ensemble_coeff is 0: a plain mean, while 0 is off here")
    if rate is not None and steps != 1:
        wrong.append(f"n_action_steps is {steps} with temporal ensembling, not 1")
    return wrong


def _diffusion_misfits(config: Mapping[str, Any]) -> list[str]:
    """Values of Diffusion Policy's settings that only some of ours have."""
    wrong, crop = _unequal_steps(config), config["crop_shape"]
    if crop and (len(crop) != 2 or crop[0] != crop[1]):
        wrong.append(f"crop_shape is {crop}, which is not square")
    if not config["kernel_size"] % 2:
        wrong.append(f"kernel_size is {config['kernel_size']}, which is even")
    if config["num_inference_steps"] == 0:
        wrong.append("num_inference_steps is 0")
    return wrong


def _unequal_steps(config: Mapping[str, Any]) -> list[str]:
    """An execution that LeRobot has no actions for, where 0 is all here."""
    steps = config["n_action_steps"]
    return [] if steps >= 1 else [f"n_action_steps is {steps}"]


def _act_alone(same: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that only our ACT has, from those that both have."""
    return {
        "encoder_width": same["width"],
        "pad_head": False,
        "action_std_floor": LEROBOT_STD_FLOOR,
        "padding": "valid" if _is_later(config) else "zeroed",
    }


def _diffusion_alone(same: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that only our Diffusion Policy has, or that it has in other words."""
    masked = "valid" if _is_later(config) else "zeroed"
    return {
        "sample_steps": same["sample_steps"] or same["noising_steps"],
        "sampler": config["noise_scheduler_type"].lower(),
        "crop": (config["crop_shape"] or [0])[0],
        "crop_random": config["crop_is_random"],
        "norm": "group" if config["use_group_norm"] else "frozen",
        "last_groups": 0 if same["groups"] == LAST_GROUPS else LAST_GROUPS,
        "features": 2 * same["keypoints"],
        "padding": masked if config["do_mask_loss_for_padding"] else "counted",
    }


def _is_later(config: Mapping[str, Any]) -> bool:
    """Whether a later LeRobot than 0.4.4 wrote it, whose losses leave padding out of their mean."""
    return "pretrained_revision" in config
