"""What LeRobot and the original ACT call the parameters of ACT and Diffusion Policy."""

import re

import numpy as np

Path = tuple[str, ...]
Arrays = dict[str, np.ndarray]

_LAYER = {
    "attention": "self_attn",
    "self_attention": "self_attn",
    "cross_attention": "multihead_attn",
    "up": "linear1",
    "down": "linear2",
    "query": "q_proj",
    "key": "k_proj",
    "value": "v_proj",
    "out": "out_proj",
}
_LEROBOT_ACT = {
    ("vision", "mix"): "encoder_img_feat_input_proj",
    ("head", "proprio"): "encoder_robot_state_input_proj",
    ("head", "latent"): "encoder_latent_input_proj",
    ("head", "position"): "encoder_1d_feature_pos_embed",
    ("head", "query"): "decoder_pos_embed",
    ("head", "action"): "action_head",
    ("latent", "cls"): "vae_encoder_cls_embed",
    ("latent", "proprio"): "vae_encoder_robot_state_input_proj",
    ("latent", "action"): "vae_encoder_action_input_proj",
    ("latent", "out"): "vae_encoder_latent_output_proj",
    ("head", "encoder"): "encoder",
    ("head", "decoder"): "decoder",
    ("latent", "encoder"): "vae_encoder",
}
_ORIGINAL_ACT = {
    ("vision", "mix"): "input_proj",
    ("head", "proprio"): "input_proj_robot_state",
    ("head", "latent"): "latent_out_proj",
    ("head", "position"): "additional_pos_embed",
    ("head", "query"): "query_embed",
    ("head", "action"): "action_head",
    ("head", "is_pad"): "is_pad_head",
    ("latent", "cls"): "cls_embed",
    ("latent", "proprio"): "encoder_joint_proj",
    ("latent", "action"): "encoder_action_proj",
    ("latent", "out"): "latent_proj",
    ("head", "encoder"): "transformer.encoder",
    ("head", "decoder"): "transformer.decoder",
    ("latent", "encoder"): "encoder",
}
_BACKBONE = {"conv1": "0", "bn1": "1"} | {f"layer{i}": str(i + 3) for i in range(1, 5)}


def _suffix(leaf: str) -> str:
    return "bias" if leaf == "bias" else "weight"


def resnet18(path: Path) -> str | None:
    """Torchvision's name for a part of a ResNet-18, which every policy calls `image`.

    Batch norms are folded before: their scale and bias are called `frozen_scale`, `frozen_bias`.
    """
    if "image" not in path:
        return None
    *inner, leaf = path[path.index("image") + 1 :]
    match inner:
        case ["stem"]:
            name = "conv1"
        case ["norm"]:
            name = "bn1"
        case ["blocks", number, module]:
            layer, block = divmod(int(number), 2)
            ours = {"norm1": "bn1", "norm2": "bn2", "shortcut": "downsample.0"}
            ours["shortcut_norm"] = "downsample.1"
            name = f"layer{layer + 1}.{block}.{ours.get(module, module)}"
        case _:
            return None
    return f"{name}.{leaf if leaf.startswith('frozen') else _suffix(leaf)}"


def _act(path: Path, parts: dict[tuple[str, ...], str], backbone: str) -> str | None:
    if (name := resnet18(path)) is not None:
        return f"{backbone}.{name}"
    if path[:2] not in parts:
        return None
    first, rest = parts[path[:2]], list(path[2:])
    if path[1] not in ("encoder", "decoder"):
        return f"{first}.{_suffix(rest[-1] if rest else '')}"
    *inner, leaf = (_LAYER.get(p, p) for p in rest if p != "feed_forward")
    if path[1] == "decoder" and inner != ["norm"]:
        inner = ["layers", "0", *inner]
    return ".".join([first, *inner, _suffix(leaf)])


def lerobot_act(path: Path) -> str | None:
    """LeRobot's name for a part of ACT, without the leading `model.`."""
    return _act(path, _LEROBOT_ACT, "backbone")


def original_act(path: Path) -> str | None:
    """The original ACT's name for a part of it, without the leading `model.`."""
    return _act(path, _ORIGINAL_ACT, "backbones.0.0.body")


def prepare_act(arrays: Arrays) -> Arrays:
    """Queries, keys and values apart; proprioception's position before the latent's, as here."""
    ready: Arrays = {}
    for name, array in arrays.items():
        if match := re.fullmatch(r"(.*)\.in_proj_(weight|bias)", name):
            for part, piece in zip("qkv", np.split(array, 3), strict=True):
                ready[f"{match[1]}.{part}_proj.{match[2]}"] = piece
        elif name.split(".")[0] in ("encoder_1d_feature_pos_embed", "additional_pos_embed"):
            ready[name] = array[::-1]
        else:
            ready[name] = array
    return ready


def restore_act(arrays: Arrays) -> Arrays:
    """The reverse of `prepare_act`."""
    theirs: Arrays = {}
    for name, array in arrays.items():
        if match := re.fullmatch(r"(.*)\.q_proj\.(weight|bias)", name):
            parts = [arrays[f"{match[1]}.{part}_proj.{match[2]}"] for part in "qkv"]
            theirs[f"{match[1]}.in_proj_{match[2]}"] = np.concatenate(parts)
        elif name.split(".")[0] == "encoder_1d_feature_pos_embed":
            theirs[name] = array[::-1]
        elif not re.search(r"\.[kv]_proj\.", name):
            theirs[name] = array
    return theirs


def lerobot_diffusion(path: Path) -> str | None:
    """LeRobot's name for a part of Diffusion Policy, without the leading `diffusion.`.

    Encoders are numbered (see `prepare_diffusion`); a local condition is called as the original
    repository does, since LeRobot has none.
    """
    suffix = _suffix(path[-1])
    if (name := resnet18(path)) is not None:
        child, rest = name.split(".", 1)
        return f"rgb_encoder.{path[1]}.backbone.{_BACKBONE[child]}.{rest}"
    match path[:-1]:
        case ["vision", number, "pool", "heat"]:
            name = f"rgb_encoder.{number}.pool.nets"
        case ["features", number]:
            name = f"rgb_encoder.{number}.out"
        case ["unet", *inner]:
            name = f"unet.{_unet(inner)}"
        case _:
            return None
    return f"{name}.{suffix}"


def _unet(inner: list[str]) -> str:
    """Their name for a module of the U-Net."""
    block = {"conv": "block.0", "norm": "block.1"}
    parts = {"block1": "0", "block2": "1"}
    match inner:
        case ["step1"]:
            return "diffusion_step_encoder.1"
        case ["step2"]:
            return "diffusion_step_encoder.3"
        case ["out"]:
            return "final_conv.1"
        case ["last", kind]:
            return f"final_conv.0.{block[kind]}"
        case ["shrink", number]:
            return f"down_modules.{number}.2"
        case ["grow", number]:
            return f"up_modules.{number}.2"
        case ["middle", part, *rest]:
            where = f"mid_modules.{parts[part]}"
        case ["local", number, *rest]:
            where = f"local_cond_encoder.{number}"
        case [way, number, part, *rest]:
            where = f"{way}_modules.{number}.{parts[part]}"
        case _:
            raise ValueError(inner)
    match rest:
        case ["film"]:
            return f"{where}.cond_encoder.1"
        case ["shortcut"]:
            return f"{where}.residual_conv"
        case _:
            return f"{where}.{rest[0].replace('block', 'conv')}.{block[rest[1]]}"


def prepare_diffusion(arrays: Arrays) -> Arrays:
    """A shared encoder numbered 0; the original repository's blocks called as LeRobot's."""

    def rename(name: str) -> str:
        name = re.sub(r"^rgb_encoder\.(?=\D)", "rgb_encoder.0.", name)
        return re.sub(r"\.blocks\.([01])\.block", lambda m: f".conv{int(m[1]) + 1}.block", name)

    return {rename(name): array for name, array in arrays.items()}


def restore_diffusion(arrays: Arrays) -> Arrays:
    """The reverse of `prepare_diffusion`, in LeRobot's names: one encoder alone has no number."""
    if any(name.startswith("rgb_encoder.1.") for name in arrays):
        return arrays
    return {name.replace("rgb_encoder.0.", "rgb_encoder."): x for name, x in arrays.items()}
