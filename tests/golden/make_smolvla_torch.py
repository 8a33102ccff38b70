"""Write `smolvla_torch.npz`: what LeRobot's SmolVLA computes, for the parity tests.

Run in an environment of its own, with LeRobot's policy, Hugging Face's model and PyTorch:

    pip install torch==2.13.0 "transformers>=4.57.1,<5" num2words
    pip install --no-deps lerobot==0.4.4   # then what its imports ask for, without torchvision
    python tests/golden/make_smolvla_torch.py

The modules are LeRobot's and transformers' own at tiny widths. Nothing is downloaded: the model's
configuration is made here, and its tokenizer is not used. Weights are not stored: `weight` makes
them from their names, here and in the test; the names and shapes are stored.

- `lerobot`: as LeRobot runs it, with cached sampling. One thing is changed: in float32
  transformers' tower computes wrong position numbers (huggingface/transformers#47133), so it is
  given the ones that bfloat16, in which the weights were trained, gives.
- `paper`: the same modules with joint attention in every layer, the paper's causal mask over
  everything, no scaling of embeddings, padded actions hidden from attention, every step of the
  sampling computed from scratch, and late fusion of ray-maps, written here in plain PyTorch.
"""

import importlib.machinery
import json
import sys
import types
import zlib
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812
from transformers import SmolVLMConfig
from transformers.models.smolvlm import modeling_smolvlm

SIDE, PATCH, TOKENS, PADDING = 128, 16, (3, 7, 1), 2
BATCH, VIEWS, CHUNK, ACTION, PADDED_ACTION, PROPRIO, STATE = 2, 2, 6, 3, 8, 5, 8
VISION = {
    "hidden_size": 32,
    "intermediate_size": 40,
    "num_hidden_layers": 1,
    "num_attention_heads": 2,
    "image_size": SIDE,
    "patch_size": PATCH,
}
TEXT = {
    "model_type": "llama",
    "hidden_size": 48,
    "intermediate_size": 56,
    "num_hidden_layers": 2,
    "num_attention_heads": 6,
    "num_key_value_heads": 2,
    "head_dim": 8,
    "vocab_size": 11,
    "rms_norm_eps": 1e-5,
    "rope_theta": 100_000,
    "pad_token_id": 0,
}


def import_lerobot():
    """LeRobot's two modules; torchvision, which only its datasets need, is left out."""
    for name in ("", ".transforms", ".transforms.v2", ".transforms.functional", ".io"):
        module = MagicMock()
        module.__spec__ = importlib.machinery.ModuleSpec("torchvision" + name, None)
        sys.modules["torchvision" + name] = module
    sys.modules["torchvision.transforms.v2.functional"] = MagicMock()
    from lerobot.policies.smolvla import modeling_smolvla, smolvlm_with_expert

    return modeling_smolvla, smolvlm_with_expert


def weight(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The weight of a name: seeded by it, with a spread that keeps activations near 1."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + ("norm" in name and name.endswith("weight"))).astype(np.float32)


def embed_patches(self, pixel_values, patch_attention_mask):
    """The tower's embeddings with every patch at its own position."""
    patches = self.patch_embedding(pixel_values).flatten(2).transpose(1, 2)
    return patches + self.position_embedding.weight


def tiny_config(attention: str, actions: int):
    """What LeRobot's module reads of its settings."""
    return types.SimpleNamespace(
        vlm_model_name="none",
        freeze_vision_encoder=False,
        train_expert_only=False,
        load_vlm_weights=False,
        attention_mode=attention,
        num_expert_layers=-1,
        num_vlm_layers=2,
        self_attn_every_n_layers=2,
        expert_width_multiplier=0.75,
        device="cpu",
        max_state_dim=STATE,
        max_action_dim=actions,
        train_state_proj=True,
        add_image_special_tokens=False,
        prefix_length=-1,
        compile_model=False,
        chunk_size=CHUNK,
        num_steps=10,
        use_cache=True,
        min_period=4e-3,
        max_period=4.0,
        rtc_config=None,
    )


def build(modeling, expert_module, attention: str, actions: int):
    """LeRobot's flow matching model, filled by `weight`."""
    vlm = SmolVLMConfig(vision_config=dict(VISION), text_config=dict(TEXT), scale_factor=4)
    vlm._attn_implementation = "eager"
    expert_module.AutoConfig = types.SimpleNamespace(from_pretrained=lambda _: vlm)
    expert_module.AutoProcessor = MagicMock()
    expert_module.AutoProcessor.from_pretrained().tokenizer.fake_image_token_id = 0
    expert_module.AutoProcessor.from_pretrained().tokenizer.global_image_token_id = 0
    modeling_smolvlm.SmolVLMVisionEmbeddings.forward = embed_patches
    return modeling.VLAFlowMatching(tiny_config(attention, actions)).float().eval()


def fill(model: nn.Module, prefix: str) -> dict[str, tuple[int, ...]]:
    """Give every parameter the weight of its name; returns names and shapes."""
    shapes = {}
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            shapes[prefix + name] = tuple(parameter.shape)
            parameter.copy_(torch.from_numpy(weight(prefix + name, tuple(parameter.shape))))
    return shapes


class RayFusion(nn.Module):
    """The authors' fusion of image tokens with a ray-map."""

    def __init__(self, width: int):
        super().__init__()
        plan = [(6, 64, 7), (64, 128, 3), (128, 256, 3), (256, 512, 3), (512, 512, 3)]
        self.convs = nn.ModuleList(
            nn.Conv2d(d_in, d_out, k, 2, k // 2, bias=False) for d_in, d_out, k in plan
        )
        self.out = nn.Conv2d(512, width, 1)
        self.mix = nn.Linear(2 * width, width)

    def forward(self, tokens, rays):
        for conv in self.convs:
            rays = F.relu(conv(rays) / np.sqrt(1 + 1e-5))
        grid = int(tokens.shape[1] ** 0.5)
        rays = self.out(F.adaptive_avg_pool2d(rays, grid)).flatten(2).transpose(1, 2)
        parts = [F.layer_norm(x, x.shape[-1:]) for x in (tokens, rays)]
        return self.mix(torch.cat(parts, -1))


def authors_rays(K: np.ndarray, pose: np.ndarray, size: int) -> np.ndarray:
    """Ray-map [6, H, W] in the authors' convention, from an OpenCV pose."""
    opengl = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    out = np.zeros((6, size, size))
    for i in range(size):
        for j in range(size):
            x, y = (j + 1.0 - K[0, 2]) / K[0, 0], (i + 1.0 - K[1, 2]) / K[1, 1]
            d = opengl @ [x, -y, -1.0]
            d = d / (np.linalg.norm(d) + 1e-8)
            out[:, i, j] = [*np.cross(pose[:3, 3], d), *d]
    return out.astype(np.float32)


def make_inputs() -> dict[str, np.ndarray]:
    rng = np.random.RandomState(0)
    c = np.sqrt(0.5)
    pose = np.tile(np.eye(4), (BATCH, VIEWS, 1, 1))
    pose[..., :3, :3] = [[0, c, -c], [1, 0, 0], [0, -c, -c]]
    pose[..., :3, 3] = rng.uniform([0.9, -0.3, 0.3], [1.5, 0.3, 0.9], (BATCH, VIEWS, 3))
    K = np.array([[77.0, 0, 32], [0, 77, 32], [0, 0, 1]])
    arrays = {
        "K": np.tile(K, (BATCH, VIEWS, 1, 1)),
        "base_from_camera": pose,
        "proprio": rng.normal(size=(BATCH, PROPRIO)),
        "action": rng.normal(size=(BATCH, CHUNK, ACTION)),
        "action_mean": rng.normal(size=ACTION),
        "action_std": rng.uniform(0.5, 2, ACTION),
        "proprio_mean": rng.normal(size=PROPRIO),
        "proprio_std": rng.uniform(0.5, 2, PROPRIO),
        "noise": rng.normal(size=(BATCH, CHUNK, PADDED_ACTION)),
        "time": rng.uniform(0.05, 1, BATCH),
    }
    inputs = {k: v.astype(np.float32) for k, v in arrays.items()}
    # Every number a square of 8 pixels, in the test as here.
    inputs["coarse"] = rng.randint(0, 256, (BATCH, VIEWS, 12, 12, 3)).astype(np.uint8)
    inputs["is_pad"] = np.arange(CHUNK) >= np.array([[CHUNK], [CHUNK - 2]])
    return inputs


def pictures(modeling, inputs, cells: int) -> list[torch.Tensor]:
    """Views of `cells` squares a side, resized by LeRobot, in -1..1."""
    images = inputs["coarse"][:, :, :cells, :cells].repeat(8, 2).repeat(8, 3)
    images = torch.from_numpy(images).movedim(-1, 2) / 255
    return [
        modeling.resize_with_pad(images[:, v], SIDE, SIDE, pad_value=0) * 2 - 1
        for v in range(VIEWS)
    ]


def normalised(inputs, name: str, width: int) -> torch.Tensor:
    values = (inputs[name] - inputs[f"{name}_mean"]) / inputs[f"{name}_std"]
    return F.pad(torch.from_numpy(values), (0, width - values.shape[-1]))


def losses(error: torch.Tensor, is_pad: torch.Tensor) -> dict[str, torch.Tensor]:
    """Both padding rules: everything counts, or only real steps and numbers."""
    keep = ~is_pad[..., None]
    valid = (error[..., :ACTION] * keep).sum() / (keep.sum() * ACTION)
    return {"loss_all": error.mean(), "loss_valid": valid}


def run_lerobot(modeling, expert_module, inputs):
    """LeRobot's own forward and cached sampling; the prompt is padded."""
    model = build(modeling, expert_module, "cross_attn", PADDED_ACTION)
    shapes = fill(model, "model.")
    images = pictures(modeling, inputs, 12)
    tokens = torch.tensor([[*TOKENS, *[0] * PADDING]]).expand(BATCH, -1)
    prompt = tokens, torch.tensor([[True] * len(TOKENS) + [False] * PADDING]).expand(BATCH, -1)
    shown = [torch.ones(BATCH, dtype=torch.bool)] * VIEWS
    state, action = (
        normalised(inputs, "proprio", STATE),
        normalised(inputs, "action", PADDED_ACTION),
    )
    noise, time = torch.from_numpy(inputs["noise"]), torch.from_numpy(inputs["time"])
    velocities = []
    hook = model.action_out_proj.register_forward_hook(lambda *args: velocities.append(args[2]))
    error = model.forward(images, shown, *prompt, state, action, noise, time)
    hook.remove()
    still = torch.zeros_like(noise)
    return shapes, {
        "velocity": velocities[0],
        "sample": model.sample_actions(images, shown, *prompt, state, noise),
        "still": model.sample_actions(images, shown, *prompt, state, still)[..., :ACTION],
        **losses(error, torch.from_numpy(inputs["is_pad"])),
    }


def run_paper(modeling, expert_module, inputs):
    """The paper's form, built of LeRobot's parts."""
    model = build(modeling, expert_module, "self_attn", ACTION)
    inner = model.vlm_with_expert
    inner.fusion = RayFusion(VISION["hidden_size"])
    shapes = fill(model, "model.")
    vlm, width = inner.get_vlm_model(), TEXT["hidden_size"]
    rays = np.stack(
        [
            [authors_rays(K, pose, 64) for K, pose in zip(*pair, strict=True)]
            for pair in zip(inputs["K"], inputs["base_from_camera"].astype(np.float64), strict=True)
        ]
    )
    views = pictures(modeling, inputs, 8)
    # LeRobot hands one view after the other to this; the view's number picks its rays.
    number = iter(())

    def embed_image(image):
        tokens = vlm.vision_model(pixel_values=image).last_hidden_state
        tokens = inner.fusion(tokens, 2 * torch.from_numpy(rays[:, next(number)]) - 1)
        return vlm.connector(tokens) / width**0.5

    inner.embed_image = embed_image
    inner.embed_language_tokens = lambda ids: vlm.text_model.embed_tokens(ids) / width**0.5
    tokens = torch.tensor([TOKENS]).expand(BATCH, -1)
    shown = [torch.ones(BATCH, dtype=torch.bool)] * VIEWS
    zero = inputs | {"proprio": np.zeros_like(inputs["proprio"])}
    state, action = normalised(zero, "proprio", STATE), normalised(inputs, "action", ACTION)

    def velocity(x, time, keep):
        nonlocal number
        number = iter(range(VIEWS))
        prefix, valid, _ = model.embed_prefix(
            views, shown, tokens, torch.ones_like(tokens, dtype=torch.bool), state
        )
        suffix, _, _ = model.embed_suffix(x, time)
        valid = torch.cat([valid, keep], 1)
        mask = torch.ones(BATCH, valid.shape[1], valid.shape[1], dtype=torch.bool).tril()
        (_, out), _ = inner.forward(
            attention_mask=mask & valid[:, None] & valid[..., None],
            position_ids=valid.cumsum(1) - 1,
            inputs_embeds=[prefix, suffix],
            use_cache=False,
            fill_kv_cache=False,
        )
        return model.action_out_proj(out)

    def sample(x):
        for i in range(10):
            time = torch.full((BATCH,), 1 - i / 10)
            x = x - velocity(x, time, torch.ones(BATCH, CHUNK, dtype=torch.bool)) / 10
        return x

    noise, time = torch.from_numpy(inputs["noise"])[..., :ACTION], torch.from_numpy(inputs["time"])
    is_pad = torch.from_numpy(inputs["is_pad"])
    t = time[:, None, None]
    predicted = velocity(t * noise + (1 - t) * action, time, ~is_pad)
    return shapes, {
        "velocity": predicted,
        "sample": sample(noise),
        "still": sample(torch.zeros_like(noise)),
        **losses((predicted - (noise - action)) ** 2, is_pad),
    }


def main() -> None:
    modules, inputs, stored = import_lerobot(), make_inputs(), {}
    for name, run in (("lerobot", run_lerobot), ("paper", run_paper)):
        with torch.no_grad():
            shapes, outputs = run(*modules, inputs)
        outputs["still"] = outputs["still"] * torch.from_numpy(
            inputs["action_std"]
        ) + torch.from_numpy(inputs["action_mean"])
        stored |= {f"{name}_{k}": v.numpy().astype(np.float32) for k, v in outputs.items()}
        stored[f"{name}_shapes"] = np.array(json.dumps(shapes))
        print(name, {k: float(v.abs().mean()) for k, v in outputs.items()})
    path = Path(__file__).with_name("smolvla_torch.npz")
    np.savez_compressed(path, **inputs, **stored)
    print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
