"""Settings of policies in LeRobot's words (versions 0.4.4 to 0.6.1), there and back.

LeRobot's networks know no cameras, so only policies without a ray path have a place in them. Images
are called as `jaxcam.lerobot` calls them.
"""

from dataclasses import fields, replace
from typing import Any

from jaxcam.config.fields import short
from jaxcam.errors import CheckpointError
from jaxcam.interop.lerobot.counterparts import COUNTERPARTS, Counterpart
from jaxcam.interop.lerobot.pipelines import ACTION, IMAGE, STATE
from jaxcam.interop.lerobot.records import PolicyFile, record_of
from jaxcam.models import FAMILIES, PolicySpec
from jaxcam.models.normalization import LEROBOT_STD_FLOOR
from jaxcam.models.smolvla.config import MOST_TOKENS

LAST_GROUPS = 8
"""Groups of the last norm of LeRobot's U-Net, whatever `n_groups` says."""
NOT_THERE = frozenset({
    "conditioning", "twin_of", "nominal_pose", "warp_height", "warp_fovy_deg", "ray_convention",
    "lift", "keypoint_features", "encoder_depth", "compute_dtype", "floors", "action_std_floor",
    "pad_head", "padding", "execute",
})  # fmt: skip
"""Settings of ours that LeRobot has in other words, or that mean nothing in a network of its."""
OF_THE_RUN = NOT_THERE | {
    "remat", "keyframe_weight", "dropout", "kl_weight", "train", "chunk", "steps", "sampler",
    "sample_steps", "temperature", "crop_random", "prompt", "tokenizer", "tokens",
    "other_prompts", "other_tokens",
}  # fmt: skip
"""Settings that change nothing of what weights were trained to compute, so that a run that begins
with the weights chooses them: how it is told its cameras, how it is trained, how it acts."""


def config_of(settings: Any, spec: PolicySpec, ensemble: float = 0.0) -> dict[str, Any]:
    """LeRobot's `config.json` of a policy.

    What it says is read back, and is then the same policy.

    Args:
        settings: The policy's.
        spec: Its sizes.
        ensemble: Rate of temporal ensembling, 0 is off.

    Raises:
        CheckpointError: LeRobot's network has no place for it.
        ConfigError: LeRobot's settings have bounds that it is beyond.
    """
    name = next(n for n, family in FAMILIES.items() if family.config is type(settings))
    counterpart = COUNTERPARTS[name]
    wrong = [
        f"{key} is {value}, not {wanted}"
        for key, wanted in counterpart.ours.items()
        if (value := getattr(settings, key)) != wanted
    ]
    wrong += _unequal_sizes(name, settings)
    if not wrong:
        if spec.views == 1 and name == "diffusion":
            settings = replace(settings, encoder_per_view=False)  # it is the same there
        theirs = _file_of(name, settings, spec, ensemble)
        back = settings_of(theirs, settings.image_scaling)
        wrong = [
            f"{key} is {ours}, there {value}"
            for key, ours, value in unlike_settings(settings, back)
        ]
        if spec_of(theirs) != spec:
            wrong.append(f"its sizes are {spec}, there {spec_of(theirs)}")
    if wrong:
        raise CheckpointError(
            f"LeRobot's {counterpart.title.split(' (')[0]} has no place for this policy: "
            f"{'; '.join(wrong)}. What it has is --preset lerobot with --conditioning none."
        )
    return theirs.written()


def unlike_settings(
    ours: Any, theirs: Any, free: frozenset[str] = NOT_THERE
) -> list[tuple[str, Any, Any]]:
    """Settings of two policies of one kind that differ.

    Args:
        ours: Settings of a policy.
        theirs: Of another.
        free: Names that may differ.

    Returns:
        Name and both values.
    """
    pairs = ((f.name, getattr(ours, f.name), getattr(theirs, f.name)) for f in fields(ours))
    return [pair for pair in pairs if pair[0] not in free and pair[1] != pair[2]]


def _file_of(name: str, settings: Any, spec: PolicySpec, ensemble: float) -> PolicyFile:
    """Their `config.json`, of a policy that has no part that they lack."""
    counterpart = COUNTERPARTS[name]
    values = {theirs: getattr(settings, ours) for theirs, ours in counterpart.same.items()}
    ahead = spec.chunk - spec.obs_steps + 1
    values["n_action_steps"] = min(settings.execute or ahead, ahead)
    if name == "act":
        values |= {"n_obs_steps": 1, "temporal_ensemble_coeff": ensemble or None}
        values["n_action_steps"] = 1 if ensemble else values["n_action_steps"]
    else:
        crop = [settings.crop] * 2 if settings.crop else None
        masked = settings.padding not in ("counted", "sample")
        values |= {"noise_scheduler_type": settings.sampler.upper(), "crop_shape": crop}
        values |= {"do_mask_loss_for_padding": masked, "crop_is_random": settings.crop_random}
        values |= {"use_group_norm": settings.norm == "group"}
        values["down_dims"] = list(settings.channels)
    views = {
        IMAGE.format(v): {"type": "VISUAL", "shape": [3, spec.height, spec.width]}
        for v in range(spec.views)
    }
    values |= {
        "type": name,
        "input_features": views | {STATE: {"type": "STATE", "shape": [spec.proprio_dim]}},
        "output_features": {ACTION: {"type": "ACTION", "shape": [spec.action_dim]}},
        "normalization_mapping": dict(counterpart.scaling),
    }
    return record_of(counterpart.record, values, "config.json")


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
    if settings.chunk % (multiple := 2 ** len(settings.channels)):
        wrong.append(f"chunk is {settings.chunk}, not a multiple of {multiple}")
    return wrong


def settings_of(theirs: PolicyFile, image_scaling: str | None = None) -> Any:
    """Our settings of a policy whose `config.json` this is.

    Args:
        theirs: LeRobot's.
        image_scaling: One of `jaxcam.interop.lerobot.pipelines.SCALINGS`; SmolVLA has none.

    Raises:
        CheckpointError: Our network has no place for it, with everything that has none.
        ConfigError: A value is of another kind than LeRobot writes, or our policy cannot have it.
    """
    name, counterpart = theirs.type, COUNTERPARTS[theirs.type]
    wrong = _unequal_values(theirs, counterpart) + _MISFITS[name](theirs)
    if wrong:
        raise CheckpointError(f"Our {name} has no place for it: {'; '.join(wrong)}.")
    same = {ours: getattr(theirs, key) for key, ours in counterpart.same.items()}
    same |= _ALONE[name](theirs)
    ours = {("twin_of" if k == "network" else k): v for k, v in counterpart.ours.items()}
    if image_scaling is not None:
        same |= {"image_scaling": image_scaling, "floors": False}
    return replace(FAMILIES[name].presets["lerobot"], **(ours | same))


def spec_of(theirs: PolicyFile) -> PolicySpec:
    """Our sizes of a policy whose `config.json` this is.

    Raises:
        CheckpointError: It has inputs or outputs that ours lack, or lacks ours.
    """
    inputs, outputs = theirs.features("input_features"), theirs.features("output_features")
    shapes = {name: inputs[name].shape for name in theirs.images}
    wrong = [f"input {k!r:.80} is one too many" for k in inputs if k not in (*shapes, STATE)]
    wrong += [f"output {k!r:.80} is one too many" for k in outputs if k != ACTION]
    for name, listed, what in ((STATE, inputs, "input"), (ACTION, outputs, "output")):
        if name not in listed:
            wrong.append(f"{what} {name} is missing")
        elif (shape := listed[name].shape) and len(shape) != 1:
            wrong.append(f"{what} {name} has the shape {shape}, not one number")
    wrong += ["images are missing among the inputs"] if not shapes else []
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{k} {'x'.join(map(str, shape))}" for k, shape in shapes.items())
        wrong.append(f"images are of several sizes: {listed}")
    for image, shape in shapes.items():
        if len(shape) != 3 or shape[0] != 3:
            wrong.append(f"{image!r:.80} has the shape {shape}, not (3, height, width)")
    ours = [IMAGE.format(v) for v in range(len(shapes))]
    if list(shapes) != ours and sorted(shapes) == sorted(ours):
        wrong.append(f"it takes its images in another order: {', '.join(shapes)}")
    if not wrong and (crop := getattr(theirs, "crop_shape", None)):
        height, width = next(iter(shapes.values()))[1:]
        if crop[0] > height or crop[1] > width:
            wrong.append(f"crop_shape {crop} does not fit in images of {height}x{width}")
    if wrong:
        raise CheckpointError(f"Our {theirs.type} has no place for it: {'; '.join(wrong)}.")
    _, height, width = next(iter(shapes.values()))
    chunk = getattr(theirs, {"diffusion": "horizon"}.get(theirs.type, "chunk_size"))
    [proprio_dim], [action_dim] = inputs[STATE].shape, outputs[ACTION].shape
    return PolicySpec(
        action_dim, proprio_dim, len(shapes), height, width, chunk, theirs.n_obs_steps
    )


def _unequal_values(theirs: PolicyFile, counterpart: Counterpart) -> list[str]:
    """Settings of theirs that have other values than ours can have."""
    usual = {f.name: f.default for f in fields(theirs)} | {"n_obs_steps": 1}
    return [
        f"{key} is {short(value)}, not {usual[key]}"
        for key in counterpart.only
        if (value := getattr(theirs, key)) != usual[key]
    ]


def _act_misfits(theirs: Any) -> list[str]:
    """Values of ACT's settings that only some of ours have."""
    rate, steps = theirs.temporal_ensemble_coeff, theirs.n_action_steps
    wrong = []
    if rate == 0:
        wrong.append("temporal_ensemble_coeff is 0: a plain mean, while 0 is off here")
    if rate is not None and rate < -1:
        wrong.append(f"temporal_ensemble_coeff is {rate}, less than -1")
    if rate is not None and steps != 1:
        wrong.append(f"n_action_steps is {steps} with temporal ensembling, not 1")
    if steps > theirs.chunk_size:
        wrong.append(f"n_action_steps is {steps}, more than chunk_size ({theirs.chunk_size})")
    if theirs.dim_model % theirs.n_heads or theirs.dim_model % 2:
        wrong.append(f"dim_model is {theirs.dim_model}, no multiple of 2 and n_heads")
    if theirs.dropout >= 1:
        wrong.append(f"dropout is {theirs.dropout}, not below 1")
    return wrong


def _diffusion_misfits(theirs: Any) -> list[str]:
    """Values of Diffusion Policy's settings that only some of ours have."""
    wrong, crop, widths = [], theirs.crop_shape, theirs.down_dims
    if crop and crop[0] != crop[1]:
        wrong.append(f"crop_shape is {crop}, which is not square")
    if not theirs.kernel_size % 2:
        wrong.append(f"kernel_size is {theirs.kernel_size}, which is even")
    if theirs.diffusion_step_embed_dim % 2:
        wrong.append(f"diffusion_step_embed_dim is {theirs.diffusion_step_embed_dim}, which is odd")
    if (theirs.num_inference_steps or 0) > theirs.num_train_timesteps:
        wrong.append("num_inference_steps is more than num_train_timesteps")
    if theirs.noise_scheduler_type not in ("DDPM", "DDIM"):
        wrong.append(f"noise_scheduler_type is {short(theirs.noise_scheduler_type)}")
    if any(width % theirs.n_groups for width in widths) or widths[0] % LAST_GROUPS:
        wrong.append(f"down_dims {widths} are no multiples of n_groups ({theirs.n_groups}) and 8")
    if theirs.horizon % 2 ** len(widths):
        wrong.append(f"horizon is {theirs.horizon}, no multiple of {2 ** len(widths)}")
    if theirs.n_obs_steps >= theirs.horizon:
        wrong.append(f"n_obs_steps is {theirs.n_obs_steps}, not less than the horizon")
    return wrong


def _smolvla_misfits(theirs: Any) -> list[str]:
    """Values of SmolVLA's settings that only some of ours have."""
    wrong, layers, distance = [], theirs.num_vlm_layers, theirs.self_attn_every_n_layers
    if theirs.n_action_steps > theirs.chunk_size:
        wrong.append(f"n_action_steps is {theirs.n_action_steps}, more than chunk_size")
    if theirs.attention_mode not in ("cross_attn", "self_attn"):
        wrong.append(f"attention_mode is {short(theirs.attention_mode)}")
    elif theirs.attention_mode == "cross_attn" and distance != 2:
        wrong.append(f"self_attn_every_n_layers is {distance}, not 2")
    elif theirs.attention_mode == "cross_attn" and layers % 2:
        wrong.append(f"num_vlm_layers is {layers}, which is odd")
    if theirs.num_expert_layers > 0 and theirs.num_expert_layers != layers:
        wrong.append(f"num_expert_layers is {theirs.num_expert_layers}, not num_vlm_layers")
    if theirs.tokenizer_max_length < MOST_TOKENS:
        wrong.append(
            f"tokenizer_max_length is {theirs.tokenizer_max_length}: longer prompts are cut there, "
            f"ours have up to {MOST_TOKENS} tokens"
        )
    if (theirs.rtc_config or {}).get("enabled", theirs.rtc_config is not None) is not False:
        wrong.append("rtc_config is enabled")
    return wrong


def _act_alone(theirs: Any) -> dict[str, Any]:
    """Settings that only our ACT has, from those that both have."""
    return {
        "encoder_width": theirs.dim_model,
        "pad_head": False,
        "action_std_floor": LEROBOT_STD_FLOOR,
        "padding": "valid" if theirs.is_later else "zeroed",
    }


def _diffusion_alone(theirs: Any) -> dict[str, Any]:
    """Settings that only our Diffusion Policy has, or that it has in other words."""
    masked = "valid" if theirs.is_later else "zeroed"
    return {
        "sample_steps": theirs.num_inference_steps or theirs.num_train_timesteps,
        "sampler": theirs.noise_scheduler_type.lower(),
        "crop": (theirs.crop_shape or [0])[0],
        "crop_random": theirs.crop_is_random,
        "norm": "group" if theirs.use_group_norm else "frozen",
        "last_groups": 0 if theirs.n_groups == LAST_GROUPS else LAST_GROUPS,
        "features": 2 * theirs.spatial_softmax_num_keypoints,
        "padding": masked if theirs.do_mask_loss_for_padding else "counted",
    }


def _smolvla_alone(theirs: Any) -> dict[str, Any]:
    """Settings that our SmolVLA has in other words; LeRobot's expert is as wide as it says."""
    width = int(FAMILIES["smolvla"].presets["lerobot"].width * theirs.expert_width_multiplier)
    hidden = 4 * int(2 * width / 3)
    return {
        "attention": "interleaved" if theirs.attention_mode == "cross_attn" else "joint",
        "train": "expert" if theirs.train_expert_only else "all",
        "expert_width": width,
        "expert_hidden": -(-hidden // 256) * 256,
        "padding": "valid" if theirs.is_later else "counted",
    }


_MISFITS = {"act": _act_misfits, "diffusion": _diffusion_misfits, "smolvla": _smolvla_misfits}
_ALONE = {"act": _act_alone, "diffusion": _diffusion_alone, "smolvla": _smolvla_alone}
