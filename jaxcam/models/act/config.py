"""Settings of ACT and its presets."""

from dataclasses import dataclass, replace

from jaxcam.config.fields import check_least
from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import VisionConfig, check_known
from jaxcam.models.keypoints import TAUGHT
from jaxcam.models.losses import PADDINGS
from jaxcam.models.normalization import ORIGINAL_STD_FLOOR, STD_FLOOR
from jaxcam.models.policy import PolicySpec


@dataclass(frozen=True)
class ActConfig(VisionConfig):
    """Settings of ACT; the defaults are the paper's, as the authors trained it."""

    chunk: int = 30
    """Actions predicted at a time."""
    execute: int = 0
    """Actions of a chunk that are executed before the policy is asked again; 0 is all of them."""
    keyframe_weight: float = 0.0
    """Weight of the loss on keyframes, which the policy then predicts beside every action; 0
    predicts none. A keyframe is where the grip will be when its command next changes."""
    heatmap_weight: float = 0.0
    """Weight of the loss that teaches two heat maps of every view to lie where the keyframe is
    seen, see `jaxcam.models.keypoints`; 0 teaches none."""
    head: str = "transformer"
    """From tokens to actions: the paper's transformer, or an mlp over all tokens at once."""
    width: int = 512
    """Width of the transformer, or of the perceptron's hidden layers."""
    heads: int = 8
    """Attention heads."""
    hidden: int = 2048
    """Hidden width of the transformer's feed-forward layers."""
    layers: int = 4
    """Encoder layers of the transformer, or hidden layers of the perceptron."""
    pre_norm: bool = True
    """Whether the transformer's norms come before its layers, as in the paper, or after them."""
    image_positions: str = "learned"
    """Positions of image tokens: learned for every view, or the same sine table for all."""
    learned_cls: bool = False
    """Whether the variational encoder's first token is learned or zero."""
    pad_head: bool = True
    """Whether there is a head for padding, which some public weights have and nobody trains."""
    pose_tokens: int = 2
    """Least number of pose tokens; they are fed with zeros unless the conditioning is token."""
    latent_dim: int = 32
    """Size of the variational latent; 0 builds no variational encoder."""
    latent_layers: int = 4
    """Layers of the variational encoder."""
    kl_weight: float = 1.0
    """Weight of the latent's KL divergence in the loss."""
    dropout: float = 0.1
    """Dropout rate in training."""
    drop_proprio: bool = True
    """Whether proprioception is replaced by zeros (before normalisation), as in the paper."""
    action_std_floor: float = STD_FLOOR
    """Least deviation that actions are divided by."""
    padding: str = "zeroed"
    """How steps past a demonstration's end count in the loss, see `padded_mean`."""

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        super().__post_init__()
        check_least(self, 1, "chunk width heads hidden layers")
        check_least(
            self, 0, "execute keyframe_weight heatmap_weight pose_tokens latent_dim latent_layers"
        )
        check_least(self, 0, "kl_weight dropout action_std_floor")
        known = {"head": ("transformer", "mlp"), "image_positions": ("learned", "sine")}
        check_known(self, padding=PADDINGS, **known)
        if self.width % self.heads:
            raise ConfigError(f"width {self.width} is not a multiple of heads {self.heads}.")
        if self.frames_tokens:
            self._check_frames()
        if self.heatmap_weight:
            self._check_heatmaps()
        if self.dropout >= 1:
            raise ConfigError(f"dropout must be below 1, got {self.dropout}.")

    def _check_heatmaps(self) -> None:
        """Refuse to teach heat maps that there are not, or where nobody says where they belong."""
        if not self.pools_keypoints or self.keypoints < TAUGHT:
            raise ConfigError(
                f"heatmap_weight teaches {TAUGHT} heat maps: take --conditioning keypoints or "
                f"--model pool=keypoints, with keypoints={TAUGHT} or more; or heatmap_weight=0."
            )
        if self.network == "warp":
            raise ConfigError(
                "heatmap_weight is for pictures as they are: conditioning warp has its heat maps "
                "over others. heatmap_weight=0 teaches none."
            )
        if not self.keyframe_weight:
            raise ConfigError("heatmap_weight needs keyframes: take keyframe_weight=0.9, too.")
        if self.action_frame != "base":
            raise ConfigError(
                f"heatmap_weight is for keyframes in the base: action_frame {self.action_frame} "
                "has them in another frame than the cameras' poses."
            )

    def _check_frames(self) -> None:
        """Refuse geometry in attention where there is none, or heads that it does not divide."""
        if self.head != "transformer" or self.pools_keypoints:
            raise ConfigError(
                f"conditioning {self.network} is for attention between cells of a picture: take "
                "--preset attention or paper, or --model head=transformer pool=grid fold=3."
            )
        if self.width // self.heads % 8:
            raise ConfigError(
                f"conditioning {self.network} needs heads of a multiple of 8 channels: width "
                f"{self.width} over heads {self.heads} is {self.width / self.heads:g}."
            )

    def outputs(self, spec: PolicySpec) -> int:
        """Numbers predicted a step: an action and, if asked for, its keyframe's position."""
        return spec.action_dim + 3 * (self.keyframe_weight > 0)


_PUBLIC = ActConfig(
    conditioning="none",
    twin_of="none",
    norm="frozen",
    chunk=100,
    hidden=3200,
    pre_norm=False,
    image_positions="sine",
    learned_cls=True,
    pose_tokens=0,
    kl_weight=10.0,
    drop_proprio=False,
)

ACT_PRESETS: dict[str, ActConfig] = {
    "paper": ActConfig(ray_convention="authors"),
    "lerobot": replace(_PUBLIC, pad_head=False),
    "original": replace(_PUBLIC, action_std_floor=ORIGINAL_STD_FLOOR),
    "laptop": ActConfig(
        conditioning="keypoints",
        twin_of="keypoints",
        encoder="small",
        encoder_width=32,
        encoder_depth=2,
        image_scaling="symmetric",
        pool="keypoints",
        chunk=16,
        execute=8,
        keyframe_weight=0.9,
        drop_proprio=False,
        head="mlp",
        width=256,
        layers=2,
        hidden=512,
        pose_tokens=0,
        latent_dim=0,
        dropout=0.0,
    ),
}
# One network for all ways of conditioning: a transformer over 7 x 7 tokens of the small encoder.
ACT_PRESETS["attention"] = replace(
    ACT_PRESETS["laptop"],
    conditioning="late",
    twin_of="late",
    pool="grid",
    fold=3,
    head="transformer",
    width=64,
    heads=4,
    hidden=128,
)
