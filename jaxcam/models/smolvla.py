"""SmolVLA: a small vision language model, and an action expert trained by flow matching.

Two forms of it: the paper's, where the expert attends in every layer to the prefix and itself, all
of it causally and all of it trained; and LeRobot's, where every other layer of the expert only
reads the prefix, pictures and words see each other, and only the expert is trained.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxcam.errors import ConfigError
from jaxcam.models.act import proprio_scale
from jaxcam.models.flow import draw_time, integrate, line
from jaxcam.models.fusion import CameraConfig, check_known, with_conditioning
from jaxcam.models.losses import PADDINGS, padded_mean, repeat_ends
from jaxcam.models.policy import (
    Batch,
    Family,
    Key,
    Obs,
    Params,
    Policy,
    PolicySpec,
    Stats,
    check_sizes,
    pure,
)
from jaxcam.models.smolvla_network import PRETRAINED, SmolVla

STD_FLOOR = 1e-4
"""Least deviation that actions are divided by, the authors'."""

MOST_TOKENS = 48
"""Longest prompt SmolVLA takes."""

NO_TOKENS = (
    "SmolVLA reads a prompt, and needs SmolVLM2's tokenizer for it. Download tokenizer.json of "
    "HuggingFaceTB/SmolVLM2-500M-Video-Instruct from huggingface.co, pip install 'jaxcam[smolvla]' "
    "and pass the file: --model tokenizer=path/to/tokenizer.json"
)


@dataclass(frozen=True)
class SmolVlaConfig(CameraConfig):
    """Settings of SmolVLA; the defaults are the paper's, as the authors trained it."""

    chunk: int = 30
    """Actions predicted at a time."""
    execute: int = 0
    """Actions of a chunk that are executed before the policy is asked again; 0 is all of them."""
    prompt: str = ""
    """What the robot is told to do; unless given, the task's own words."""
    tokenizer: str = ""
    """File tokenizer.json that turns the prompt into tokens."""
    tokens: tuple[int, ...] = ()
    """The prompt's tokens; unless given, the tokenizer makes them."""
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
        check_known(
            self,
            attention=("joint", "interleaved"),
            mask=("causal", "blocks"),
            train=("all", "expert"),
            padding=PADDINGS,
        )
        if self.network not in (known := ("none", "token", "late")):
            raise ConfigError(
                f"SmolVLA has no conditioning '{self.network}', only {', '.join(known)}: its "
                "pretrained tower takes three channels and hands on every patch."
            )
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
        if len(self.tokens) > MOST_TOKENS:
            raise ConfigError(
                f"The prompt has {len(self.tokens)} tokens; SmolVLA takes {MOST_TOKENS}. "
                "Shorten it."
            )
        if any(not 0 <= token < self.vocabulary for token in self.tokens):
            raise ConfigError(
                f"Tokens must be 0 to {self.vocabulary - 1}, got {self.tokens}. Is the tokenizer "
                "that of the vision language model?"
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


def tokenize(prompt: str, file: str) -> tuple[int, ...]:
    """A prompt's tokens, with the line break at its end that SmolVLA was trained with.

    Args:
        prompt: The words.
        file: A tokenizer.json.

    Raises:
        ConfigError: The library is missing, or the file is no tokenizer.
    """
    try:
        from tokenizers import Tokenizer
    except ImportError as error:
        raise ConfigError(
            "Reading a tokenizer needs the package tokenizers: pip install 'jaxcam[smolvla]'"
        ) from error
    try:
        tokenizer = Tokenizer.from_file(file)
    except Exception as error:  # The library raises plain exceptions, whatever is wrong.
        raise ConfigError(f"{file} is not a tokenizer.json: {error}. {NO_TOKENS}") from error
    tokenizer.no_padding()
    tokenizer.no_truncation()
    return tuple(tokenizer.encode(prompt.rstrip("\n") + "\n").ids)


def with_prompt(config: SmolVlaConfig, prompt: str) -> SmolVlaConfig:
    """The settings with their prompt as tokens, if they name a tokenizer's file.

    Args:
        config: Settings. A prompt in them counts more than the other one, tokens more than both.
        prompt: What the task asks for.

    Raises:
        ConfigError: The prompt cannot be turned into tokens, see `tokenize`.
    """
    if config.tokens or not config.tokenizer:
        return config
    prompt = config.prompt or prompt
    return replace(config, prompt=prompt, tokens=tokenize(prompt, config.tokenizer))


def velocity_loss(
    config: SmolVlaConfig,
    predicted: jax.Array,
    target: jax.Array,
    is_pad: jax.Array,
    action_dim: int,
) -> jax.Array:
    """Mean squared error of velocities [B, T, W], of which `action_dim` numbers are real."""
    error = jnp.square(predicted - target)
    if config.padding != "counted":
        error = error[..., :action_dim]
    return padded_mean(error, is_pad, config.padding)


def trained(params: Params) -> Params:
    """False at the parameters that training the expert leaves alone."""
    return {
        part: jax.tree.map(lambda _, is_trained=part not in PRETRAINED: is_trained, tree)
        for part, tree in params.items()
    }


def make_smolvla(config: SmolVlaConfig, spec: PolicySpec, stats: Stats) -> Policy:
    """Make SmolVLA's three functions; statistics become constants of them."""
    check_sizes(config.chunk, spec, stats)
    _check_fit(config, spec)
    action_mean = np.asarray(stats["action_mean"], np.float32)
    action_std = np.maximum(np.asarray(stats["action_std"], np.float32), np.float32(STD_FLOOR))
    proprio_mean = np.asarray(stats["proprio_mean"], np.float32)
    proprio_std = proprio_scale(stats["proprio_std"])
    init, network = pure(lambda rngs: SmolVla(config, spec, rngs=rngs))
    width = config.actions(spec)

    def state(obs: Obs) -> jax.Array:
        raw = jnp.zeros_like(obs["proprio"]) if config.drop_proprio else obs["proprio"]
        return _filled((raw - proprio_mean) / proprio_std, config.state_width)

    def loss(params: Params, batch: Batch, key: Key) -> tuple[jax.Array, dict[str, jax.Array]]:
        if config.train == "expert":
            params = jax.tree.map(
                lambda p, t: p if t else jax.lax.stop_gradient(p), params, trained(params)
            )
        action, is_pad = (batch["action"] - action_mean) / action_std, batch["is_pad"]
        if config.padding != "valid":
            action = repeat_ends(action, is_pad)
        action = _filled(action, width)
        # Without a key, as in validation, noise and times are the same every time.
        noise_key, time_key = jax.random.split(jax.random.key(0) if key is None else key)
        noise = jax.random.normal(noise_key, action.shape)
        time = draw_time(time_key, action.shape[0])
        x, target = line(action, noise, time)
        net = network(params)
        predicted = net.velocity(net.prefix(batch, state(batch)), x, time)
        value = velocity_loss(config, predicted, target, is_pad, spec.action_dim)
        return value, {"loss": value}

    def act(params: Params, obs: Obs, key: Key) -> jax.Array:
        net = network(params)
        prefix = net.prefix(obs, state(obs))
        shape = (obs["proprio"].shape[0], config.chunk, width)
        noise = jnp.zeros(shape) if key is None else jax.random.normal(key, shape)
        x = integrate(lambda x, time: net.velocity(prefix, x, time), noise, config.steps)
        return x[..., : spec.action_dim] * action_std + action_mean

    execute = min(config.execute or spec.chunk, spec.chunk)
    only = trained if config.train == "expert" else None
    return Policy(init, loss, act, config, spec, execute, only)


def _filled(x: jax.Array, width: int) -> jax.Array:
    """The last axis filled up with zeros."""
    return jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, width - x.shape[-1])])


def _check_fit(config: SmolVlaConfig, spec: PolicySpec) -> None:
    if not config.tokens:
        raise ConfigError(NO_TOKENS)
    if spec.height != spec.width:
        raise ConfigError(f"SmolVLA takes square images, got {spec.height}x{spec.width}.")
    if spec.proprio_dim > config.state_width:
        raise ConfigError(
            f"Proprioception has {spec.proprio_dim} numbers, SmolVLA takes {config.state_width}."
        )
    if config.action_width and spec.action_dim > config.action_width:
        raise ConfigError(
            f"Actions have {spec.action_dim} numbers, SmolVLA predicts {config.action_width}."
        )


FAMILY = Family(SmolVlaConfig, SMOLVLA_PRESETS, make_smolvla, with_conditioning, with_prompt)
