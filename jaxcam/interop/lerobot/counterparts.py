"""What each setting of a LeRobot policy is here: ours, only one value, or nothing that matters.

Each setting of `jaxcam.interop.lerobot.records` stands in exactly one place of its counterpart,
and one that stands in none is refused, so that none that changes an output can be passed over.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from jaxcam.errors import CheckpointError
from jaxcam.interop.lerobot.records import (
    ActFile,
    DiffusionFile,
    PolicyFile,
    SmolVlaFile,
    record_of,
)
from jaxcam.models.weights.names_robot import Arrays, restore_act, restore_diffusion

_ONLY = ("use_amp", "use_peft")
_FREE = {
    "type": "it is the policy's name",
    "normalization_mapping": "the pipelines are obeyed, which are compared by themselves",
    "pretrained_path": "it says where training began",
    "pretrained_revision": "it says where training began; that there is one, which losses",
    "device": "it says what computes",
    **dict.fromkeys(("push_to_hub", "repo_id", "private", "tags", "license"), "it is for the hub"),
    **dict.fromkeys(("optimizer_lr", "optimizer_weight_decay"), "it is for training"),
}
"""Of every policy."""
_FEATURES = ("input_features", "output_features")


@dataclass(frozen=True)
class Counterpart:
    """One policy of LeRobot's and what it is here.

    Attributes:
        record: Its `config.json`.
        title: Of the policy's file of weights, see `jaxcam.models.weights.names`.
        prefix: Of its arrays.
        same: Their settings that are ours, under another name.
        ours: Values that ours must have.
        only: Their settings of which just the record's own value has a place here.
        alone: Their settings that become ours, or ours theirs, in other words.
        free: Their settings that change nothing of what given weights compute, and why.
        scaling: Modes by kind of feature.
        restore: Brings arrays to their names, see `NameMap.prepare`; None cannot be exported.
    """

    record: type[PolicyFile]
    title: str
    prefix: str
    same: Mapping[str, str]
    ours: Mapping[str, Any]
    only: tuple[str, ...]
    alone: tuple[str, ...]
    free: Mapping[str, str]
    scaling: Mapping[str, str]
    restore: Callable[[Arrays], Arrays] | None


COUNTERPARTS = {
    "act": Counterpart(
        record=ActFile,
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
        only=(
            "n_obs_steps", "vision_backbone", "n_decoder_layers", "use_vae",
            "replace_final_stride_with_dilation", "feedforward_activation", *_ONLY,
        ),
        alone=("temporal_ensemble_coeff", *_FEATURES),
        free={
            **_FREE,
            "pretrained_backbone_weights": "given weights take their place",
            "optimizer_lr_backbone": "it is for training",
        },
        scaling={"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"},
        restore=restore_act,
    ),
    "diffusion": Counterpart(
        record=DiffusionFile,
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
        only=(
            "vision_backbone", "resize_shape", "use_film_scale_modulation", "beta_schedule",
            "prediction_type", "clip_sample", "clip_sample_range", *_ONLY,
        ),
        alone=(
            "crop_shape", "crop_is_random", "use_group_norm", "noise_scheduler_type",
            "do_mask_loss_for_padding", *_FEATURES,
        ),
        free={
            **_FREE,
            "pretrained_backbone_weights": "given weights take their place",
            "crop_ratio": "it is for pictures that are resized, which have no place here",
            "beta_start": "the cosine schedule has none",
            "beta_end": "the cosine schedule has none",
            "drop_n_last_frames": "it says what is trained on",
            "gradient_checkpointing": "it saves memory in training",
            "compile_model": "it makes the same faster; the prefix of its arrays is cut",
            "compile_mode": "it makes the same faster",
            **dict.fromkeys(
                ("optimizer_betas", "optimizer_eps", "scheduler_name", "scheduler_warmup_steps"),
                "it is for training",
            ),
        },
        scaling={"VISUAL": "MEAN_STD", "STATE": "MIN_MAX", "ACTION": "MIN_MAX"},
        restore=restore_diffusion,
    ),
    "smolvla": Counterpart(
        record=SmolVlaFile,
        title="SmolVLA (LeRobot)",
        prefix="model.",
        same={
            "chunk_size": "chunk", "n_action_steps": "execute", "max_state_dim": "state_width",
            "max_action_dim": "action_width", "num_steps": "steps", "num_vlm_layers": "layers",
        },
        ours={"network": "none", "mask": "blocks", "scale_embeddings": True, "drop_proprio": False},
        only=(
            "n_obs_steps", "empty_cameras", "adapt_to_pi_aloha", "use_delta_joint_actions_aloha",
            "use_cache", "vlm_model_name", "add_image_special_tokens", "min_period", "max_period",
            "resize_imgs_with_padding", *_ONLY,
        ),
        alone=(
            "train_expert_only", "attention_mode", "num_expert_layers", "self_attn_every_n_layers",
            "expert_width_multiplier", "tokenizer_max_length", "rtc_config", *_FEATURES,
        ),
        free={
            **_FREE,
            "prefix_length": "tokens that fill the prefix up are masked",
            "pad_language_to": "tokens that fill the prompt up are masked",
            "load_vlm_weights": "given weights take their place; what they compute in is rounding",
            "compile_model": "it makes the same faster; the prefix of its arrays is cut",
            "compile_mode": "it makes the same faster",
            **dict.fromkeys(
                (
                    "freeze_vision_encoder", "train_state_proj", "optimizer_betas", "optimizer_eps",
                    "optimizer_grad_clip_norm", "scheduler_warmup_steps", "scheduler_decay_steps",
                    "scheduler_decay_lr",
                ),
                "it is for training",
            ),
        },
        scaling={"VISUAL": "IDENTITY", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"},
        restore=None,
    ),
}  # fmt: skip


def policy_file(config: Mapping[str, Any]) -> PolicyFile:
    """The record of a `config.json`.

    Args:
        config: As JSON has it.

    Raises:
        CheckpointError: It is of a policy that is not known here.
        ConfigError: A setting is missing, unknown, of another type, or out of bounds.
    """
    name = config.get("type", "")
    if not isinstance(name, str) or name not in COUNTERPARTS:
        known = ", ".join(COUNTERPARTS)
        raise CheckpointError(f"It is of policy {name!r:.80}; {known} can be read.")
    return record_of(COUNTERPARTS[name].record, config, "config.json")
