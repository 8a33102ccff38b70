"""What LeRobot writes of a policy, as typed records: versions 0.4.4 to 0.6.1.

The values here are what an export of ours writes. What each setting means for our policies is said
in `jaxcam.interop.lerobot.counterparts`.
"""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

from jaxcam.config.fields import SettingsRecord, as_record, check_least, check_most, check_types
from jaxcam.errors import CheckpointError, ConfigError
from jaxcam.files.paths import read_text

C = TypeVar("C", bound=SettingsRecord)
Mode = Literal["IDENTITY", "MEAN_STD", "MIN_MAX", "QUANTILES", "QUANTILE10"]
"""How LeRobot scales a kind of feature."""
NOT_WRITTEN = ""
"""Of a setting that 0.4.4 does not know."""
LATER = ("pretrained_revision", "gradient_checkpointing")
"""Settings that 0.4.4 does not know, and would not read."""
MOST_BYTES = 16 * 2**20
"""Of a file; parsed it takes ten times as much memory."""
MOST_NUMBERS = 10_000
"""Of an action, a state, a chunk and the noising steps, and the largest width but for `MOST_WIDTH`.
Tables of these sizes are made before a file of weights has its say."""
MOST_WIDTH = 100_000
MOST_LAYERS = 100
MOST_PIXELS = 8192
MOST_FEATURES = 100
MOST_STAGES = 12


@dataclass(frozen=True)
class Feature:
    """One array that goes into a policy or comes out of it."""

    type: Literal["STATE", "VISUAL", "ENV", "ACTION", "REWARD", "LANGUAGE"]
    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        check_types(self)
        most = MOST_PIXELS if self.type == "VISUAL" else MOST_NUMBERS
        if not self.shape or not all(1 <= size <= most for size in self.shape):
            raise ConfigError(f"shape must be numbers of 1 to {most}, got {self.shape[:9]}.")


@dataclass(frozen=True, kw_only=True)
class PolicyFile:
    """What the `config.json` of every policy says."""

    SIZES: ClassVar[tuple[str, ...]] = ()
    """Settings that are sizes of arrays among the weights."""
    COUNTS: ClassVar[tuple[str, ...]] = ()
    """Settings that are counts of layers, each with arrays of its own."""
    type: str
    input_features: dict[str, Any] | None
    output_features: dict[str, Any] | None
    normalization_mapping: dict[str, Mode]
    n_action_steps: int
    n_obs_steps: int
    device: str | None = "cpu"
    use_amp: bool = False
    use_peft: bool = False
    push_to_hub: bool = False
    repo_id: str | None = None
    private: bool | None = None
    tags: list[str] | None = None
    license: str | None = None
    pretrained_path: str | None = None
    pretrained_revision: str | None = NOT_WRITTEN
    optimizer_lr: float = 1e-5
    optimizer_weight_decay: float = 1e-4

    def __post_init__(self) -> None:
        check_types(self)
        check_least(self, 1, "n_action_steps n_obs_steps")
        check_most(self, MOST_NUMBERS, "n_action_steps")
        for name in ("input_features", "output_features"):
            self.features(name)

    def features(self, name: str) -> dict[str, Feature]:
        """The features of `input_features` or `output_features`, in their order.

        Raises:
            ConfigError: They are not of the form that LeRobot writes.
        """
        listed = getattr(self, name) or {}
        if len(listed) > MOST_FEATURES:
            raise ConfigError(f"{name} are {len(listed)}, more than {MOST_FEATURES}.")
        return features(listed, name)

    @property
    def images(self) -> list[str]:
        """The names of the images that go in."""
        inputs = self.features("input_features")
        return [name for name, feature in inputs.items() if feature.type == "VISUAL"]

    @property
    def is_later(self) -> bool:
        """Whether a later LeRobot than 0.4.4 wrote it, whose losses leave padding out."""
        return self.pretrained_revision != NOT_WRITTEN

    def written(self) -> dict[str, Any]:
        """What LeRobot 0.4.4 reads as the same."""
        known = [f.name for f in fields(self) if f.name not in LATER]
        return {name: getattr(self, name) for name in known}


@dataclass(frozen=True, kw_only=True)
class ActFile(PolicyFile):
    """ACT's `config.json`."""

    SIZES: ClassVar[tuple[str, ...]] = ("chunk_size", "dim_model", "dim_feedforward", "latent_dim")
    COUNTS: ClassVar[tuple[str, ...]] = ("n_encoder_layers", "n_vae_encoder_layers")
    chunk_size: int
    pre_norm: bool
    dim_model: int
    n_heads: int
    dim_feedforward: int
    n_encoder_layers: int
    latent_dim: int
    n_vae_encoder_layers: int
    temporal_ensemble_coeff: float | None
    dropout: float
    kl_weight: float
    vision_backbone: str = "resnet18"
    pretrained_backbone_weights: str | None = None
    replace_final_stride_with_dilation: bool | int = False
    feedforward_activation: str = "relu"
    n_decoder_layers: int = 1
    use_vae: bool = True
    optimizer_lr_backbone: float = 1e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        check_least(self, 1, "chunk_size dim_model n_heads dim_feedforward n_encoder_layers")
        check_least(self, 1, "latent_dim n_vae_encoder_layers")
        check_least(self, 0, "dropout kl_weight")
        check_most(self, MOST_NUMBERS, "chunk_size dim_model n_heads latent_dim")
        check_most(self, MOST_WIDTH, "dim_feedforward")
        check_most(self, MOST_LAYERS, "n_encoder_layers n_vae_encoder_layers n_decoder_layers")


@dataclass(frozen=True, kw_only=True)
class DiffusionFile(PolicyFile):
    """Diffusion Policy's `config.json`."""

    SIZES: ClassVar[tuple[str, ...]] = (
        "down_dims", "kernel_size", "diffusion_step_embed_dim", "spatial_softmax_num_keypoints",
    )  # fmt: skip
    horizon: int
    spatial_softmax_num_keypoints: int
    down_dims: tuple[int, ...]
    use_separate_rgb_encoder_per_camera: bool
    kernel_size: int
    n_groups: int
    diffusion_step_embed_dim: int
    num_train_timesteps: int
    num_inference_steps: int | None
    crop_shape: tuple[int, int] | None
    crop_is_random: bool
    use_group_norm: bool
    noise_scheduler_type: str
    do_mask_loss_for_padding: bool
    vision_backbone: str = "resnet18"
    pretrained_backbone_weights: str | None = None
    resize_shape: tuple[int, int] | None = None
    crop_ratio: float = 1.0
    use_film_scale_modulation: bool = True
    beta_schedule: str = "squaredcos_cap_v2"
    beta_start: float = 1e-4
    beta_end: float = 0.02
    prediction_type: str = "epsilon"
    clip_sample: bool = True
    clip_sample_range: float = 1.0
    drop_n_last_frames: int = 7
    gradient_checkpointing: bool = False
    compile_model: bool = False
    compile_mode: str = "reduce-overhead"
    optimizer_lr: float = 1e-4
    optimizer_betas: tuple[float, float] = (0.95, 0.999)
    optimizer_eps: float = 1e-8
    optimizer_weight_decay: float = 1e-6
    scheduler_name: str = "cosine"
    scheduler_warmup_steps: int = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        check_least(self, 1, "horizon spatial_softmax_num_keypoints kernel_size n_groups")
        check_least(self, 4, "diffusion_step_embed_dim")
        check_least(self, 1, "num_train_timesteps num_inference_steps")
        check_most(self, MOST_NUMBERS, "horizon kernel_size diffusion_step_embed_dim")
        check_most(self, MOST_NUMBERS, "spatial_softmax_num_keypoints num_train_timesteps")
        if not 1 <= len(self.down_dims) <= MOST_STAGES:
            raise ConfigError(f"down_dims must be 1 to {MOST_STAGES}, got {len(self.down_dims)}.")
        if not all(1 <= width <= MOST_WIDTH for width in self.down_dims):
            raise ConfigError(
                f"down_dims must be widths of 1 to {MOST_WIDTH}, got {self.down_dims[:9]}."
            )
        for name in ("crop_shape", "resize_shape"):
            if not all(1 <= side <= MOST_PIXELS for side in getattr(self, name) or ()):
                raise ConfigError(
                    f"{name} must be sides of 1 to {MOST_PIXELS}, got {getattr(self, name)}."
                )


@dataclass(frozen=True, kw_only=True)
class SmolVlaFile(PolicyFile):
    """SmolVLA's `config.json`."""

    chunk_size: int
    max_state_dim: int
    max_action_dim: int
    num_steps: int
    train_expert_only: bool
    attention_mode: str
    num_vlm_layers: int
    num_expert_layers: int
    self_attn_every_n_layers: int
    expert_width_multiplier: float
    tokenizer_max_length: int
    rtc_config: dict[str, Any] | None = None
    resize_imgs_with_padding: tuple[int, int] | None = (512, 512)
    empty_cameras: int = 0
    adapt_to_pi_aloha: bool = False
    use_delta_joint_actions_aloha: bool = False
    use_cache: bool = True
    vlm_model_name: str = "HuggingFaceTB/SmolVLM2-500M-Video-Instruct"
    add_image_special_tokens: bool = False
    min_period: float = 4e-3
    max_period: float = 4.0
    prefix_length: int = -1
    pad_language_to: str = "longest"
    load_vlm_weights: bool = False
    freeze_vision_encoder: bool = True
    train_state_proj: bool = True
    compile_model: bool = False
    compile_mode: str = "max-autotune"
    optimizer_lr: float = 1e-4
    optimizer_betas: tuple[float, float] = (0.9, 0.95)
    optimizer_eps: float = 1e-8
    optimizer_weight_decay: float = 1e-10
    optimizer_grad_clip_norm: float = 10
    scheduler_warmup_steps: int = 1_000
    scheduler_decay_steps: int = 30_000
    scheduler_decay_lr: float = 2.5e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        check_least(self, 1, "chunk_size max_state_dim max_action_dim num_steps num_vlm_layers")
        check_most(self, MOST_NUMBERS, "chunk_size max_state_dim max_action_dim num_steps")
        check_most(self, MOST_LAYERS, "num_vlm_layers")
        check_least(self, 0, "expert_width_multiplier", or_equal=False)
        check_most(self, 10, "expert_width_multiplier")


def features(listed: dict[str, Any], what: str) -> dict[str, Feature]:
    """Features by their names.

    Args:
        listed: As JSON has them.
        what: The setting that lists them, for messages.

    Raises:
        ConfigError: They are not of the form that LeRobot writes.
    """
    return {
        name: record_of(Feature, one, f"feature {name!r:.80} of {what}")
        for name, one in listed.items()
    }


def record_of(kind: type[C], values: Any, what: str) -> C:
    """The record that values are, see `as_record`; messages say of what.

    Raises:
        ConfigError: They are not.
    """
    try:
        return as_record(kind, values, what)
    except ConfigError as error:
        start = "" if what in str(error) else f"{what}: "
        raise ConfigError(f"{start}{error}") from error


def read_checkpoint_json(path: Path) -> dict[str, Any]:
    """What a JSON file of a checkpoint says.

    Raises:
        CheckpointError: There is no such file.
        ConfigError: It is too large, cannot be read, or holds anything else than an object.
    """
    where = f"{path.parent} is no LeRobot checkpoint"
    if not path.is_file():
        raise CheckpointError(f"{where}: it has no {path.name}.")
    try:
        size = path.stat().st_size
        content = json.loads(read_text(path)) if size <= MOST_BYTES else None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{where}: {path.name} is not JSON: {str(error)[:200]}.") from error
    if size > MOST_BYTES:
        raise ConfigError(f"{where}: {path.name} has {size} bytes, more than {MOST_BYTES}.")
    if not isinstance(content, dict):
        raise ConfigError(f"{where}: {path.name} is a JSON {type(content).__name__}, no object.")
    return content
