"""One train step with LeRobot's modules, for `policies.py`, which starts this with another Python.

The environment is that of `tests/golden/lerobot_networks.py`. Settings are the paper's: ACT with a
chunk of 30, feed-forward width 2048 and pre-norm, Diffusion Policy with a chunk of 32 and one
observation, 256 pixels, one camera, float32. ACT is without ray-maps; they are six more channels
of Diffusion Policy's images.

Every line on standard input makes one update; its seconds are printed, and those of all cores.
"""

import sys
import time
from pathlib import Path

import torch
from torch import nn

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "golden"))
import lerobot_networks as lerobot

ACTION, PROPRIO, SIZE = 7, 9, 256


def make_act(batch: int):
    """The network, and its loss."""
    config = lerobot.settings(
        lerobot.ACTConfig, PROPRIO, ACTION, 1, SIZE, chunk_size=30, n_action_steps=30,
        dim_feedforward=2048, pre_norm=True, pretrained_backbone_weights=None,
    )  # fmt: skip
    model = lerobot.ACT(config).train()
    inputs = {
        "observation.images": [torch.rand(batch, 3, SIZE, SIZE)],
        "observation.state": torch.randn(batch, PROPRIO),
        "action": torch.randn(batch, 30, ACTION),
        "action_is_pad": torch.zeros(batch, 30, dtype=torch.bool),
    }

    def loss():
        predicted, (mean, log_variance) = model(inputs)
        kl = (-0.5 * (1 + log_variance - mean**2 - log_variance.exp())).sum(-1).mean()
        return (predicted - inputs["action"]).abs().mean() + kl

    return model, loss


def make_diffusion(batch: int):
    """The network, and its loss."""
    config = lerobot.settings(
        lerobot.DiffusionConfig, PROPRIO, ACTION, 1, SIZE, n_obs_steps=1, horizon=32,
        n_action_steps=32,
    )  # fmt: skip
    model = lerobot.DiffusionModel(config).train()
    model.rgb_encoder.backbone[0] = nn.Conv2d(9, 64, 7, 2, 3, bias=False)
    inputs = {
        "observation.images": torch.rand(batch, 1, 1, 9, SIZE, SIZE),
        "observation.state": torch.randn(batch, 1, PROPRIO),
        "action": torch.rand(batch, 32, ACTION),
        "action_is_pad": torch.zeros(batch, 32, dtype=torch.bool),
    }
    return model, lambda: model.compute_loss(inputs)


def main() -> None:
    """Answer lines with seconds."""
    kind, batch = sys.argv[1], int(sys.argv[2])
    model, loss = (make_act if kind == "act" else make_diffusion)(batch)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=2e-5, weight_decay=1e-4)
    for _ in sys.stdin:
        began = time.perf_counter(), time.process_time()
        optimizer.zero_grad()
        loss().backward()
        nn.utils.clip_grad_norm_(trained, 1.0)
        optimizer.step()
        print(time.perf_counter() - began[0], time.process_time() - began[1], flush=True)


if __name__ == "__main__":
    main()
