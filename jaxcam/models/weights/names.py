"""What public checkpoints call our parameters: the only place that knows their names.

A map says for the path of one of our parameters, such as `vision/layers/0/query/kernel`, which
array of the file it comes from.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

from jaxcam.models.smolvla.network import PRETRAINED
from jaxcam.models.weights.names_robot import (
    Arrays,
    Path,
    lerobot_act,
    lerobot_diffusion,
    original_act,
    prepare_act,
    prepare_diffusion,
    resnet18,
)


@dataclass(frozen=True)
class NameMap:
    """How one kind of checkpoint is laid out.

    Attributes:
        title: What it is.
        marker: Regular expression of a name that only such checkpoints have.
        theirs: Their name of the parameter at one of our paths; None if it keeps its value.
        prefix: Regular expression that is cut off their names first; what lacks it is left out.
        unused: Regular expression of their names that nothing here needs.
        prepare: Brings their arrays, without the prefix, to the names that `theirs` gives.
    """

    title: str
    marker: str
    theirs: Callable[[Path], str | None]
    prefix: str = ""
    unused: str = "(?!)"
    prepare: Callable[[Arrays], Arrays] = dict


_TEXT = {
    "norm1": "input_layernorm",
    "query": "self_attn.q_proj",
    "key": "self_attn.k_proj",
    "value": "self_attn.v_proj",
    "out": "self_attn.o_proj",
    "norm2": "post_attention_layernorm",
    "gate": "mlp.gate_proj",
    "up": "mlp.up_proj",
    "down": "mlp.down_proj",
}
_VISION = _TEXT | {
    "norm1": "layer_norm1",
    "norm2": "layer_norm2",
    "out": "self_attn.out_proj",
    "up": "mlp.fc1",
    "down": "mlp.fc2",
}
_SMOLVLA = {
    "state": "state_proj",
    "action_in": "action_in_proj",
    "time_in": "action_time_mlp_in",
    "time_out": "action_time_mlp_out",
    "action_out": "action_out_proj",
}


def _suffix(leaf: str) -> str:
    return "bias" if leaf == "bias" else "weight"


def smolvlm(path: Path) -> str | None:
    """Hugging Face's name for a part of SmolVLM2, without the leading `model.`."""
    part, *rest, leaf = path
    if part not in PRETRAINED:
        return None
    match part, rest:
        case "vision", ["layers", number, module]:
            name = f"vision_model.encoder.layers.{number}.{_VISION[module]}"
        case "vision", ["patch"]:
            name = "vision_model.embeddings.patch_embedding"
        case "vision", ["norm"]:
            name = "vision_model.post_layernorm"
        case "vision", _:
            name = "vision_model.embeddings.position_embedding"
        case "connector", _:
            name = "connector.modality_projection.proj"
        case "text", [number, module]:
            name = f"text_model.layers.{number}.{_TEXT[module]}"
        case _:
            name = "text_model.embed_tokens"
    return f"{name}.{_suffix(leaf)}"


def lerobot_smolvla(path: Path) -> str | None:
    """LeRobot's name for a part of SmolVLA, without the leading `model.`; ray fusion has none."""
    part, *rest, leaf = path
    if (name := smolvlm(path)) is not None:
        return f"vlm_with_expert.vlm.model.{name}"
    if part == "expert":
        return f"vlm_with_expert.lm_expert.layers.{rest[0]}.{_TEXT[rest[1]]}.weight"
    if part == "norm":
        return "vlm_with_expert.lm_expert.norm.weight"
    return f"{_SMOLVLA[part]}.{_suffix(leaf)}" if part in _SMOLVLA else None


MAPS = (
    NameMap(
        "SmolVLA (LeRobot)",
        r"model\.vlm_with_expert\..*",
        lerobot_smolvla,
        prefix=r"model\.",
        unused=r".*\.(lm_head|text_model\.norm)\.weight",
    ),
    NameMap(
        "SmolVLM2",
        r"model\.vision_model\.embeddings\.patch_embedding\.weight",
        smolvlm,
        prefix=r"model\.",
        # SmolVLA takes its first layers.
        unused=r"text_model\.(norm|layers\.\d+)\..*",
    ),
    NameMap(
        "ACT (LeRobot)",
        r"model\.encoder_latent_input_proj\.weight",
        lerobot_act,
        prefix=r"model\.",
        unused=r"vae_encoder_pos_enc",
        prepare=prepare_act,
    ),
    NameMap(
        "ACT (original)",
        r"model\.latent_out_proj\.weight",
        original_act,
        prefix=r"model\.",
        # Its decoder has layers whose output nothing reads.
        unused=r"pos_table|transformer\.decoder\.layers\.[1-9]\d*\..*",
        prepare=prepare_act,
    ),
    NameMap(
        "Diffusion Policy (LeRobot)",
        r"diffusion\.unet\.diffusion_step_encoder\.1\.weight",
        lerobot_diffusion,
        prefix=r"diffusion\.",
        unused=r".*\.pool\.pos_grid",
        prepare=prepare_diffusion,
    ),
    NameMap(
        "ResNet-18 (R3M)",
        r"(r3m\.)?module\.convnet\.conv1\.weight",
        resnet18,
        prefix=r"(r3m\.)?module\.convnet\.",
    ),
    NameMap("ResNet-18 (torchvision)", r"conv1\.weight", resnet18, unused=r"fc\..*"),
)
"""Checkpoints that can be loaded."""


def name_map_of(names: list[str]) -> NameMap | None:
    """The map of a checkpoint with these names."""
    for known in MAPS:
        if any(re.fullmatch(known.marker, name) for name in names):
            return known
    return None


WRAPPED = ("state_dict.", "model_state_dict.", "module.", "model.")
"""What training scripts and parallel training put before all names of a network."""


def unwrap(arrays: Arrays) -> Arrays:
    """Arrays by the names that their network gives them.

    Names that are of a known kind stay as they are. From others what wrappers put there is cut:
    `_orig_mod.` of `torch.compile` anywhere, the names in `WRAPPED` in front. Beside a state dict
    lie the optimizer's arrays, which are then left out.

    Args:
        arrays: By their names in the file.
    """
    plain = {re.sub(r"(^|\.)_orig_mod\.", r"\1", name): array for name, array in arrays.items()}
    if len(plain) < len(arrays) or name_map_of(list(plain)) is not None:
        return plain if len(plain) == len(arrays) else arrays
    for prefix in WRAPPED:
        inner = {n.removeprefix(prefix): a for n, a in plain.items() if n.startswith(prefix)}
        whole = len(inner) == len(plain) or "state_dict" in prefix
        if inner and whole and name_map_of(list(unwrapped := unwrap(inner))) is not None:
            return unwrapped
    return arrays
