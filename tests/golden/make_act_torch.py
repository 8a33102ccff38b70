"""Write `act_torch.npz`: what a PyTorch ACT of the paper's form computes, for the parity tests.

Run in an environment with torch and numpy; jaxcam is not needed:

    pip install torch==2.13.0 numpy
    python tests/golden/make_act_torch.py

The network is the paper's (ResNet-18, ray encoder, pre-norm transformer, variational encoder) with
a narrow transformer. Its weights are not stored: `weight` makes them from their names, here and in
the test. Dropout is off and the latent is its mean, so nothing is random.
"""

import zlib
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

WIDTH, HEADS, FFN, LAYERS, LATENT = 16, 2, 24, 2, 4
CHUNK, ACTION, PROPRIO, SIZE, VIEWS, BATCH = 6, 3, 5, 64, 2, 2


def weight(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The weight of a name: seeded by it, with a spread that keeps activations near 1."""
    values = np.random.RandomState(zlib.crc32(name.encode())).normal(size=shape)
    if len(shape) > 1:
        return (values * np.sqrt(1.5 / np.prod(shape[1:]))).astype(np.float32)
    return (0.1 * values + ("norm" in name and name.endswith("weight"))).astype(np.float32)


def frozen_norm(x: torch.Tensor) -> torch.Tensor:
    """A frozen batch norm that was never given statistics."""
    one, zero = torch.ones(x.shape[1]), torch.zeros(x.shape[1])
    return F.batch_norm(x, zero, one, one, zero, training=False, eps=1e-5)


class Block(nn.Module):
    def __init__(self, d_in: int, d_out: int, stride: int):
        super().__init__()
        self.conv1 = nn.Conv2d(d_in, d_out, 3, stride, 1, bias=False)
        self.conv2 = nn.Conv2d(d_out, d_out, 3, 1, 1, bias=False)
        has_shortcut = stride > 1 or d_in != d_out
        self.shortcut = nn.Conv2d(d_in, d_out, 1, stride, bias=False) if has_shortcut else None

    def forward(self, x):
        y = frozen_norm(self.conv2(F.relu(frozen_norm(self.conv1(x)))))
        return F.relu(y + (x if self.shortcut is None else frozen_norm(self.shortcut(x))))


class ResNet(nn.Module):
    def __init__(self):
        super().__init__()
        self.stem = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        plan = [(64, 64, 1), (64, 64, 1), (64, 128, 2), (128, 128, 1)]
        plan += [(128, 256, 2), (256, 256, 1), (256, 512, 2), (512, 512, 1)]
        self.blocks = nn.ModuleList(Block(*args) for args in plan)

    def forward(self, x):
        x = F.max_pool2d(F.relu(frozen_norm(self.stem(x))), 3, 2, 1)
        for block in self.blocks:
            x = block(x)
        return x


class RayEncoder(nn.Module):
    def __init__(self):
        super().__init__()
        widths = [6, 64, 128, 256, 512, 512]
        sizes = [7, 3, 3, 3, 3]
        self.convs = nn.ModuleList(
            nn.Conv2d(widths[i], widths[i + 1], k, 2, k // 2, bias=False)
            for i, k in enumerate(sizes)
        )

    def forward(self, x):
        for conv in self.convs:
            x = F.relu(frozen_norm(conv(x)))
        return x


def attention() -> nn.MultiheadAttention:
    return nn.MultiheadAttention(WIDTH, HEADS, batch_first=True)


class EncoderLayer(nn.Module):
    def __init__(self):
        super().__init__()
        self.attention = attention()
        self.norm1, self.norm2 = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH)
        self.up, self.down = nn.Linear(WIDTH, FFN), nn.Linear(FFN, WIDTH)

    def forward(self, x, position, ignore=None):
        y = self.norm1(x)
        x = x + self.attention(y + position, y + position, y, key_padding_mask=ignore)[0]
        return x + self.down(F.relu(self.up(self.norm2(x))))


class Encoder(nn.Module):
    def __init__(self):
        super().__init__()
        self.layers = nn.ModuleList(EncoderLayer() for _ in range(LAYERS))
        self.norm = nn.LayerNorm(WIDTH)

    def forward(self, x, position, ignore=None):
        for layer in self.layers:
            x = layer(x, position, ignore)
        return self.norm(x)


class Decoder(nn.Module):
    def __init__(self):
        super().__init__()
        self.self_attention, self.cross_attention = attention(), attention()
        self.norm1, self.norm2 = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH)
        self.norm3, self.norm = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH)
        self.up, self.down = nn.Linear(WIDTH, FFN), nn.Linear(FFN, WIDTH)

    def forward(self, query, memory, position):
        x = torch.zeros(len(memory), CHUNK, WIDTH)
        y = self.norm1(x)
        x = x + self.self_attention(y + query, y + query, y)[0]
        y = self.norm2(x) + query
        x = x + self.cross_attention(y, memory + position, memory)[0]
        return self.norm(x + self.down(F.relu(self.up(self.norm3(x)))))


def sine_table(length: int) -> torch.Tensor:
    rows = [
        [
            (np.sin if i % 2 == 0 else np.cos)(pos / 10000 ** (2 * (i // 2) / WIDTH))
            for i in range(WIDTH)
        ]
        for pos in range(length)
    ]
    return torch.tensor(np.array(rows), dtype=torch.float32)


class Act(nn.Module):
    def __init__(self):
        super().__init__()
        self.image, self.rays = ResNet(), RayEncoder()
        self.mix = nn.Conv2d(1024, WIDTH, 1)
        self.pose = nn.Linear(16, WIDTH)
        self.proprio, self.latent = nn.Linear(PROPRIO, WIDTH), nn.Linear(LATENT, WIDTH)
        self.image_position = nn.Embedding(VIEWS * (SIZE // 32) ** 2, WIDTH)
        self.position, self.query = nn.Embedding(4, WIDTH), nn.Embedding(CHUNK, WIDTH)
        self.encoder, self.decoder = Encoder(), Decoder()
        self.action, self.is_pad = nn.Linear(WIDTH, ACTION), nn.Linear(WIDTH, 1)
        self.latent_proprio = nn.Linear(PROPRIO, WIDTH)
        self.latent_action = nn.Linear(ACTION, WIDTH)
        self.latent_encoder = Encoder()
        self.latent_out = nn.Linear(WIDTH, 2 * LATENT)

    def encode(self, proprio, action, is_pad):
        first = self.latent_proprio(proprio)[:, None]
        x = torch.cat([torch.zeros_like(first), first, self.latent_action(action)], 1)
        ignore = torch.cat([torch.zeros(len(x), 2, dtype=torch.bool), is_pad], 1)
        x = self.latent_encoder(x, sine_table(2 + CHUNK), ignore)
        return self.latent_out(x[:, 0]).split(LATENT, -1)

    def forward(self, images, rays, proprio, latent):
        """Map images [B, V, 3, H, W], rays [B, V, 6, H, W] and the latent to actions."""
        tokens = []
        for v in range(VIEWS):
            features = torch.cat([self.image(images[:, v]), self.rays(rays[:, v])], 1)
            tokens.append(self.mix(features).flatten(2).transpose(1, 2))
        batch = len(proprio)
        tokens.append(self.pose(torch.zeros(batch, 2, 16)))
        tokens += [self.proprio(proprio)[:, None], self.latent(latent)[:, None]]
        position = torch.cat([self.image_position.weight, self.position.weight])
        memory = self.encoder(torch.cat(tokens, 1), position)
        return self.action(self.decoder(self.query.weight, memory, position))


def authors_rays(K: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Ray-map [6, H, W] in the authors' convention, from an OpenCV pose."""
    opengl = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    out = np.zeros((6, SIZE, SIZE))
    for i in range(SIZE):
        for j in range(SIZE):
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
    std = rng.uniform(0.5, 2, (2, max(ACTION, PROPRIO)))
    mean = rng.normal(size=(2, max(ACTION, PROPRIO)))
    arrays = {
        # Coarse noise: it compresses.
        "image": rng.randint(0, 256, (BATCH, VIEWS, 8, 8, 3)).repeat(8, 2).repeat(8, 3),
        "K": np.tile(K, (BATCH, VIEWS, 1, 1)),
        "base_from_camera": pose,
        "proprio": rng.normal(size=(BATCH, PROPRIO)),
        "action": rng.normal(size=(BATCH, CHUNK, ACTION)),
        "action_mean": mean[0, :ACTION],
        "action_std": std[0, :ACTION],
        "proprio_mean": mean[1, :PROPRIO],
        "proprio_std": std[1, :PROPRIO],
    }
    inputs = {k: v.astype(np.float32) for k, v in arrays.items()}
    inputs["image"] = arrays["image"].astype(np.uint8)
    inputs["is_pad"] = np.arange(CHUNK) >= np.array([[CHUNK], [CHUNK - 2]])
    return inputs


def main() -> None:
    model = Act().eval()
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            parameter.copy_(torch.from_numpy(weight(name, tuple(parameter.shape))))
    inputs = make_inputs()
    as_tensor = {k: torch.from_numpy(v) for k, v in inputs.items()}
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    images = ((as_tensor["image"] / 255 - mean) / std).movedim(-1, 2)
    rays = np.stack(
        [
            np.stack([authors_rays(inputs["K"][b, v], pose) for v, pose in enumerate(poses)])
            for b, poses in enumerate(inputs["base_from_camera"].astype(np.float64))
        ]
    )
    rays = torch.from_numpy(rays)
    # Proprioception is replaced by zeros before it is normalised.
    proprio = -as_tensor["proprio_mean"] / as_tensor["proprio_std"]
    proprio = proprio.expand(BATCH, PROPRIO)
    target = (as_tensor["action"] - as_tensor["action_mean"]) / as_tensor["action_std"]
    is_pad = as_tensor["is_pad"]
    with torch.no_grad():
        mu, log_variance = model.encode(proprio, target, is_pad)
        kl = (-0.5 * (1 + log_variance - mu.pow(2) - log_variance.exp())).sum(1).mean()
        predicted = model(images, rays, proprio, mu)
        error = F.l1_loss(predicted, target, reduction="none") * ~is_pad[..., None]
        acted = model(images, rays, proprio, torch.zeros(BATCH, LATENT))
        acted = acted * as_tensor["action_std"] + as_tensor["action_mean"]
        features = model.image(images[:, 0])
    outputs = {
        "out_features": features[0, :64],
        "out_action": acted,
        "out_l1": error.mean(),
        "out_kl": kl,
        "out_loss": error.mean() + kl,
    }
    path = Path(__file__).with_name("act_torch.npz")
    np.savez_compressed(path, **inputs, **{k: v.numpy() for k, v in outputs.items()})
    print(f"{path.name}: {path.stat().st_size} bytes, l1 {error.mean():.4f}, kl {kl:.4f}")


if __name__ == "__main__":
    main()
