"""Settings of Diffusion Policy and its presets."""

from dataclasses import dataclass, replace
from typing import Literal

from jaxcam.config.fields import check_least
from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import VisionConfig, check_known
from jaxcam.models.diffusion.samplers import SAMPLERS
from jaxcam.models.losses import PADDINGS


@dataclass(frozen=True)
class DiffusionConfig(VisionConfig):
    """Settings of Diffusion Policy; the defaults are the paper's, as the authors trained it."""

    conditioning: str = "early"
    twin_of: str = "early"
    ray_convention: Literal["jaxcam", "authors"] = "authors"
    norm: str = "group"
    image_scaling: str = "unit"
    pool: str = "softmax"
    heat_gain: float = 1.0
    chunk: int = 32
    """Actions predicted at a time, from the oldest observation on."""
    execute: int = 0
    """Actions, from the newest observation on, that are executed before the policy is asked again;
    0 is all of them."""
    obs_steps: int = 1
    """Observations the policy sees: the newest and those of the steps before it."""
    crop: int = 0
    """Side in pixels of the square the policy looks at: random in training, else central; 0 is the
    whole image."""
    crop_random: bool = True
    """Whether that square is random in training."""
    encoder_per_view: bool = False
    """Whether every view has an image encoder of its own."""
    features: int = 64
    """Numbers that a view's tokens become."""
    features_relu: bool = True
    """Whether those are rectified."""
    hidden: tuple[int, ...] = ()
    """Widths of a perceptron that all that conditions the chunk as a whole goes through first; the
    public implementations have none."""
    local_proprio: bool = True
    """Whether proprioception conditions every step of the chunk, instead of the chunk as a
    whole."""
    drop_proprio: bool = True
    """Whether proprioception is replaced by zeros (before normalisation), as in the paper."""
    keyframe_weight: float = 0.0
    """Weight of the loss on keyframes, which the condition then has to tell; 0 asks for none. A
    keyframe is where the grip will be when its command next changes."""
    channels: tuple[int, ...] = (512, 1024, 2048)
    """Width of every stage of the U-Net."""
    kernel: int = 5
    """Steps that a convolution of the U-Net sees."""
    groups: int = 8
    """Groups of the U-Net's norms."""
    last_groups: int = 0
    """Groups of its last norm, 8 in the public implementations whatever the others have; 0 is as
    many as the others."""
    step_width: int = 128
    """Width of the noising step's embedding."""
    noising_steps: int = 100
    """Steps of the noising process."""
    sampler: str = "ddpm"
    """How actions are drawn: ddpm, or ddim, which adds no noise and may take fewer steps."""
    sample_steps: int = 100
    """Denoising steps when acting."""
    temperature: float = 1.0
    """Scale of all noise that actions are drawn with; below 1 they vary less, at 0 not at all."""
    padding: str = "sample"
    """How steps past a demonstration's end count in the loss, see `padded_mean`. With sample they
    are zeros before normalisation, as in the paper, otherwise copies of the last action."""

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        super().__post_init__()
        check_least(self, 1, "chunk features kernel groups step_width noising_steps")
        check_least(self, 0, "execute keyframe_weight crop temperature")
        if not self.channels or min(self.channels + self.hidden) < 1:
            raise ConfigError(
                f"channels and hidden are widths of at least 1, and there is at least one stage; "
                f"got {self.channels} and {self.hidden}."
            )
        check_known(self, sampler=SAMPLERS, padding=PADDINGS)
        if self.frames_tokens:
            raise ConfigError(
                f"Diffusion Policy has no conditioning '{self.network}': that is geometry in "
                "attention, and its U-Net has none. ACT and SmolVLA have it."
            )
        multiple = 2 ** (len(self.channels) - 1)
        if self.chunk % multiple:
            raise ConfigError(
                f"chunk {self.chunk} is not a multiple of {multiple}, as {len(self.channels)} "
                "stages of the U-Net need."
            )
        if any(width % self.groups for width in self.channels):
            raise ConfigError(
                f"channels {self.channels} are not multiples of groups {self.groups}."
            )
        if self.last_groups < 0 or self.channels[0] % (self.last_groups or self.groups):
            raise ConfigError(
                f"channels {self.channels[0]} is not a multiple of last_groups {self.last_groups}."
            )
        if not 1 <= self.sample_steps <= self.noising_steps:
            raise ConfigError(
                f"sample_steps must be 1 to noising_steps ({self.noising_steps}), "
                f"got {self.sample_steps}."
            )
        if not 1 <= self.obs_steps < self.chunk:
            raise ConfigError(f"obs_steps must be 1 to {self.chunk - 1}, got {self.obs_steps}.")


_PUBLIC = DiffusionConfig(
    conditioning="none",
    twin_of="none",
    ray_convention="jaxcam",
    chunk=16,
    execute=8,
    obs_steps=2,
    local_proprio=False,
    drop_proprio=False,
    padding="counted",
)

DIFFUSION_PRESETS: dict[str, DiffusionConfig] = {
    "paper": DiffusionConfig(),
    "lerobot": replace(_PUBLIC, image_scaling="imagenet"),
    "original": replace(
        _PUBLIC,
        image_scaling="symmetric",
        crop=76,
        encoder_per_view=True,
        features_relu=False,
    ),
    "laptop": DiffusionConfig(
        conditioning="keypoints",
        twin_of="keypoints",
        ray_convention="jaxcam",
        encoder="small",
        encoder_width=32,
        encoder_depth=2,
        image_scaling="symmetric",
        pool="keypoints",
        heat_gain=25.0,
        chunk=16,
        execute=8,
        features=256,
        hidden=(256, 256),
        local_proprio=False,
        drop_proprio=False,
        keyframe_weight=0.9,
        channels=(32, 64, 128),
        step_width=64,
        sampler="ddim",
        sample_steps=10,
        temperature=0.5,
        padding="valid",
    ),
}
