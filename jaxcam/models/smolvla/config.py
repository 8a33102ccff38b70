"""Settings of SmolVLA and its presets."""

from dataclasses import dataclass
from typing import ClassVar

from jaxcam.config.fields import check_least
from jaxcam.errors import ConfigError
from jaxcam.models.conditioning import IN_ATTENTION, VisionConfig, check_known
from jaxcam.models.losses import PADDINGS
from jaxcam.models.policy import PolicySpec

MOST_TOKENS = 48
"""Longest prompt SmolVLA takes."""
HASHED_WORDS = "words"
"""Instead of a tokenizer's file: a word's number follows from its letters."""


@dataclass(frozen=True)
class SmolVlaConfig(VisionConfig):
    """Settings of SmolVLA; the defaults are the paper's, as the authors trained it.

    The tower ``siglip`` is SmolVLM2's, whose sizes begin with ``vision_``. With another encoder the
    policy sees through the one that ACT and Diffusion Policy have, and all ways to tell it its
    camera are open to it.
    """

    encoders: ClassVar[tuple[str, ...]] = ("siglip", "small", "resnet18")
    encoder: str = "siglip"
    image_scaling: str = "symmetric"

    chunk: int = 30
    """Actions predicted at a time."""
    execute: int = 0
    """Actions of a chunk that are executed before the policy is asked again; 0 is all of them."""
    prompt: str = ""
    """What the robot is told to do; unless given, the task's own words."""
    tokenizer: str = ""
    """File tokenizer.json that turns the prompt into tokens; or `words`, which needs no file and
    gives each word a number by a hash, for a language model that has learned nothing yet."""
    tokens: tuple[int, ...] = ()
    """The prompt's tokens; unless given, the tokenizer makes them."""
    other_prompts: tuple[str, ...] = ()
    """What else it may be told, in a dataset with several instructions; observations say which by
    number, from 1 (0 is the first prompt)."""
    other_tokens: tuple[tuple[int, ...], ...] = ()
    """The tokens of those."""
    attention: str = "joint"
    """What the expert's layers attend to: prefix and actions (joint), or in every other layer the
    prefix alone (interleaved)."""
    mask: str = "causal"
    """Whether pictures and words see only what is before them (causal), or each other (blocks)."""
    scale_embeddings: bool = False
    """Whether pictures and words are scaled up by the root of their width."""
    train: str = "all"
    """What is trained: all of it, or everything but the vision language model (expert)."""
    padding: str = "valid"
    """How steps past a demonstration's end count in the loss, see `padded_mean`. Numbers that fill
    an action up count where such steps do. With valid, such steps are zeros before normalisation,
    as in the paper, otherwise copies of the last action."""
    keyframe_weight: float = 0.0
    """Weight of the loss on keyframes, which the prefix then has to tell; 0 asks for none. A
    keyframe is where the grip will be when its command next changes."""
    steps: int = 10
    """Euler steps from noise to actions."""
    drop_proprio: bool = True
    """Whether proprioception is replaced by zeros (before normalisation), as in the paper."""
    state_width: int = 32
    """Numbers of the state, filled up with zeros."""
    action_width: int = 0
    """Numbers of an action, filled up with zeros; 0 is as many as there are."""
    image_size: int = 512
    """Image side that the vision tower gets."""
    patch: int = 16
    """Side of its patches."""
    vision_width: int = 768
    """Width of the vision tower."""
    vision_layers: int = 12
    """Layers of the vision tower."""
    vision_heads: int = 12
    """Attention heads of the vision tower."""
    vision_hidden: int = 3072
    """Hidden width of the vision tower's perceptrons."""
    shuffle: int = 4
    """Side of the blocks of image tokens that are folded into one."""
    vocabulary: int = 49280
    """Number of words."""
    width: int = 960
    """Width of the language model."""
    layers: int = 16
    """Layers of the language model, and of the expert."""
    heads: int = 15
    """Query heads of both."""
    kv_heads: int = 5
    """Key and value heads of both."""
    head_dim: int = 64
    """Numbers a head."""
    hidden: int = 2560
    """Hidden width of the language model's perceptrons."""
    expert_width: int = 720
    """Width of the action expert."""
    expert_hidden: int = 2048
    """Hidden width of the expert's perceptrons."""
    remat: bool = True
    """Whether layers are computed again in the backward pass instead of being kept in memory."""

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        super().__post_init__()
        check_least(self, 1, "chunk steps state_width image_size patch vision_width vision_layers")
        check_least(self, 1, "vision_heads vision_hidden shuffle vocabulary width layers heads")
        check_least(self, 1, "kv_heads head_dim hidden expert_width expert_hidden")
        check_least(self, 0, "execute action_width keyframe_weight")
        check_known(
            self,
            attention=("joint", "interleaved"),
            mask=("causal", "blocks"),
            train=("all", "expert"),
            padding=PADDINGS,
        )
        if self.frames_tokens:
            self._check_frames()
        if self.encoder == "siglip":
            self._check_tower()
        if self.image_size % (self.patch * self.shuffle):
            raise ConfigError(
                f"image_size {self.image_size} is not a multiple of patch {self.patch} times "
                f"shuffle {self.shuffle}."
            )
        if self.vision_width % self.vision_heads or self.heads % self.kv_heads:
            raise ConfigError(
                "vision_width must be a multiple of vision_heads, and heads of kv_heads."
            )
        if self.attention == "interleaved" and self.layers % 2:
            raise ConfigError(f"Interleaved layers come in pairs, got {self.layers}.")
        for tokens in (self.tokens, *self.other_tokens):
            if len(tokens) > MOST_TOKENS:
                raise ConfigError(
                    f"The prompt has {len(tokens)} tokens; SmolVLA takes {MOST_TOKENS}. Shorten it."
                )
            if any(not 0 <= token < self.vocabulary for token in tokens):
                raise ConfigError(
                    f"Tokens must be 0 to {self.vocabulary - 1}, got {tokens}. Is the tokenizer "
                    "that of the vision language model?"
                )

    def _check_frames(self) -> None:
        """Refuse geometry in attention between keypoints, or heads that it does not divide."""
        if self.pools_keypoints:
            raise ConfigError(
                f"conditioning {self.network} is for attention between cells of a picture: take "
                "--model pool=grid fold=3, or a preset with the pretrained tower."
            )
        if self.head_dim % 8:
            raise ConfigError(
                f"conditioning {self.network} needs heads of a multiple of 8 channels; head_dim is "
                f"{self.head_dim}."
            )

    def _check_tower(self) -> None:
        """Refuse what the pretrained tower cannot have."""
        if self.network not in (known := ("none", "token", "late", "warp", *IN_ATTENTION)):
            raise ConfigError(
                f"SmolVLA has no conditioning '{self.network}', only {', '.join(known)}: its "
                "pretrained tower takes three channels and hands on every patch. --preset laptop "
                "has a tower of its own and early and keypoints."
            )
        if (self.pool, self.image_scaling) != ("grid", "symmetric"):
            raise ConfigError(
                "SmolVLA's pretrained tower hands on a grid of pictures scaled to -1..1: pool must "
                f"be grid and image_scaling symmetric, got {self.pool} and {self.image_scaling}."
            )

    def crosses(self, layer: int) -> bool:
        """Whether a layer of the expert only reads the prefix."""
        return self.attention == "interleaved" and layer % 2 == 1

    def actions(self, spec: PolicySpec) -> int:
        """Numbers of a padded action."""
        return self.action_width or spec.action_dim


SMOLVLA_PRESETS: dict[str, SmolVlaConfig] = {
    "paper": SmolVlaConfig(ray_convention="authors"),
    "lerobot": SmolVlaConfig(
        conditioning="none",
        twin_of="none",
        chunk=50,
        attention="interleaved",
        mask="blocks",
        scale_embeddings=True,
        train="expert",
        padding="counted",
        drop_proprio=False,
        action_width=32,
    ),
    "laptop": SmolVlaConfig(
        conditioning="keypoints",
        twin_of="keypoints",
        encoder="small",
        encoder_width=32,
        encoder_depth=2,
        pool="keypoints",
        tokenizer=HASHED_WORDS,
        chunk=16,
        execute=8,
        mask="blocks",
        keyframe_weight=0.9,
        drop_proprio=False,
        vocabulary=2048,
        width=192,
        layers=3,
        heads=6,
        kv_heads=2,
        head_dim=32,
        hidden=384,
        expert_width=128,
        expert_hidden=256,
        remat=False,
    ),
    "tiny": SmolVlaConfig(
        ray_convention="authors",
        chunk=8,
        tokens=(1, 2, 3),
        image_size=64,
        patch=8,
        vision_width=32,
        vision_layers=2,
        vision_heads=2,
        vision_hidden=64,
        shuffle=4,
        vocabulary=8,
        width=48,
        layers=2,
        heads=3,
        kv_heads=1,
        head_dim=16,
        hidden=96,
        expert_width=36,
        expert_hidden=72,
    ),
}
