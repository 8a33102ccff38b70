"""Settings of what a policy sees: how it is told where its cameras are, and its image encoder.

What they mean is computed in `jaxcam.models.fusion`.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, TypeVar

import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxcam.config.fields import check_least
from jaxcam.config.names import ActionFrame, Conditioning, names_of
from jaxcam.errors import ConfigError, closest
from jaxcam.models.resnet import NORMS

TABLE_HEIGHT = 0.8 - 0.912
"""Of the paper's table over the base, metres."""
TABLE_MIDDLE = (0.56, 0.0, TABLE_HEIGHT)
"""Of it in the base frame, metres."""
# Azimuth 0, elevation 45 degrees, 0.95 m from the table's middle: that of the paper's cameras.
_C = 0.5**0.5
NOMINAL_POSE = (
    (0.0, _C, -_C, TABLE_MIDDLE[0] + 0.95 * _C),
    (1.0, 0.0, 0.0, 0.0),
    (0.0, -_C, -_C, TABLE_HEIGHT + 0.95 * _C),
    (0.0, 0.0, 0.0, 1.0),
)
UNMOVED = tuple(tuple(float(i == j) for j in range(4)) for i in range(4))
IN_ATTENTION = ("prope", "gta", "ray_rope")
"""The ways that need attention between tokens that have a place in a picture."""


@dataclass(frozen=True)
class CameraConfig:
    """How a policy is told where its cameras are, and what it computes in."""

    conditioning: str = "late"
    """How the policy is told where its cameras are, see `jaxcam.models.fusion`."""
    twin_of: str = "late"
    """With conditioning none: the conditioning whose network is kept, fed with a fixed pose."""
    nominal_pose: tuple[tuple[float, ...], ...] = NOMINAL_POSE
    """That fixed pose, base_from_camera, OpenCV axes; also that of the view that warp makes."""
    warp_fovy_deg: float = 45.0
    """Vertical field of view of that view, degrees."""
    warp_height: float = TABLE_HEIGHT
    """Height of the plane that warp takes for what is seen, base frame, metres. The table's nominal
    one: where scenes vary it, what is seen is off by as much as it."""
    ray_convention: Literal["jaxcam", "authors"] = "jaxcam"
    """Order and pixel offset of the ray-map; keypoints always use "jaxcam"."""
    action_frame: str = "base"
    """What the policy predicts actions in, base or camera: those of the first view at its newest
    observation. Set by the run's setting of that name."""
    absolute_actions: bool = False
    """Whether actions are grip poses, rather than what these move by; for action_frame camera."""
    base_from_actions: tuple[tuple[float, ...], ...] = UNMOVED
    """The frame that the run's actions are in, base_from_world in a simulator; likewise."""
    compute_dtype: str = "float32"
    """Arithmetic of the networks, float32 or bfloat16; weights and rays are always float32."""
    obs_steps: ClassVar[int] = 1
    """Observations the policy sees at once."""

    def __post_init__(self) -> None:
        """Refuse names that do not exist, and a pose that is no matrix."""
        for name in ("nominal_pose", "base_from_actions"):
            if [len(row) for row in getattr(self, name)] != [4, 4, 4, 4]:
                raise ConfigError(f"{name} must be 4 rows of 4 numbers, got {getattr(self, name)}.")
        check_least(self, -1000, "warp_height")
        if not 0 < self.warp_fovy_deg < 180:
            raise ConfigError(f"warp_fovy_deg must be 0 to 180, got {self.warp_fovy_deg}.")
        check_known(
            self,
            conditioning=names_of(Conditioning),
            twin_of=names_of(Conditioning),
            ray_convention=("jaxcam", "authors"),
            action_frame=names_of(ActionFrame),
            compute_dtype=("float32", "bfloat16"),
        )

    @property
    def network(self) -> str:
        """The conditioning whose network is built, which an image-only twin shares."""
        return self.twin_of if self.conditioning == "none" else self.conditioning

    @property
    def frames_tokens(self) -> bool:
        """Whether attention knows the cameras of its tokens."""
        return self.network in IN_ATTENTION

    @property
    def dtype(self) -> DTypeLike:
        """Type the networks compute in."""
        return jnp.dtype(self.compute_dtype)


def check_known(config: Any, **known: tuple[str, ...]) -> None:
    """Refuse settings whose value is not one of the known names."""
    for name, names in known.items():
        value = getattr(config, name)
        if value not in names:
            raise ConfigError(f"Unknown {name} '{value}'{closest(str(value), names)}.")


@dataclass(frozen=True)
class VisionConfig(CameraConfig):
    """Settings of the image encoder and of the conditioning."""

    encoders: ClassVar[tuple[str, ...]] = ("resnet18", "small")
    """Image encoders that this kind of policy may have."""
    encoder: str = "resnet18"
    """Image encoder: resnet18 (stride 32) or small (stride 4, cheap on a CPU)."""
    norm: str = "identity"
    """Norms of the ResNet: group, or frozen batch norms with the statistics of loaded weights
    (frozen) or with none (identity)."""
    encoder_depth: int = 2
    """Residual convolutions of the small encoder."""
    encoder_width: int = 512
    """Channels of the feature map that the encoders hand on."""
    image_scaling: str = "imagenet"
    """Scaling of colours: imagenet (mean and deviation), symmetric (-1 to 1) or unit (0 to 1)."""
    pool: str = "grid"
    """What becomes a token: every cell of the feature map (grid), or every one of the keypoints
    (keypoints), or only where these are in the image (softmax), as in Diffusion Policy."""
    fold: int = 1
    """Side of the blocks of cells that become one token, side by side, where tokens are cells."""
    keypoints: int = 32
    """Heat maps a view, when keypoints are pooled."""
    heat_gain: float = 25.0
    """Factor on heat maps before their softmax. At 1 all keypoints start in the image's middle, and
    training spends a thousand updates on getting them away from there."""
    keypoint_features: bool = False
    """Whether a ray keypoint also carries the features under its heat map, as keypoints without
    rays do unless the pool is softmax."""
    lift: bool = True
    """Whether a ray keypoint also carries the point of its ray at a height the network chooses."""
    lift_unit: float = 0.0
    """What counts as 1 in those points, metres from the middle of the paper's table: objects lie
    closer together than numbers of order 1 that networks tell apart at once. 0 leaves them in
    metres from the origin of the rays."""
    floors: bool = True
    """Whether deviations and ranges that nearly vanish are raised to the floors of
    `jaxcam.models.normalization`, or divided by as they are, as LeRobot does."""

    def __post_init__(self) -> None:
        """Refuse names that do not exist."""
        super().__post_init__()
        check_least(self, 1, "encoder_depth encoder_width keypoints fold")
        check_least(self, 0, "heat_gain lift_unit")
        check_known(
            self,
            encoder=self.encoders,
            norm=NORMS,
            image_scaling=("imagenet", "symmetric", "unit"),
            pool=("grid", "keypoints", "softmax"),
        )

    @property
    def pools_keypoints(self) -> bool:
        """Whether tokens are keypoints instead of cells of the feature map."""
        return self.pool != "grid" or self.network == "keypoints"


C = TypeVar("C", bound=CameraConfig)


def with_conditioning(config: C, conditioning: str) -> C:
    """The same policy, conditioned in another way.

    ``none`` gives the image-only twin of the conditioning that `config` has.
    """
    twin_of = config.network if conditioning == "none" else conditioning
    return replace(config, conditioning=conditioning, twin_of=twin_of)
