"""Write `act_public.npz`: what LeRobot's and the original ACT compute, for the parity tests.

For the environment see `lerobot_networks.py`; jaxcam is not needed. The original is read from a
checkout of github.com/tonyzhaozh/act (742c753c):

    python tests/golden/make_act_public.py PATH_OF_THE_CHECKOUT

Transformers are narrow, dropout is off, the latent is its mean. Weights are not stored: they are
made from their names, here and in the test. The original fixes 14 joints and a latent of 32.
"""

import json
import sys
import types
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import torch
from lerobot_networks import ACT, ACTConfig, ACTTemporalEnsembler, fill, settings
from torch.nn import functional as F  # noqa: N812

BATCH, VIEWS, SIZE, CHUNK, WIDTH = 2, 2, 64, 6, 16
SIZES = {"lerobot": (3, 5), "original": (14, 14)}
"""Dimensions of actions and of proprioception."""
MEAN, STD = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])


def make_inputs(action: int, proprio: int) -> dict[str, np.ndarray]:
    rng = np.random.RandomState(1)
    image = rng.randint(0, 256, (BATCH, VIEWS, 8, 8, 3)).repeat(8, 2).repeat(8, 3)
    arrays = {
        "proprio": rng.normal(size=(BATCH, proprio)),
        "action": rng.normal(size=(BATCH, CHUNK, action)),
        "action_mean": rng.normal(size=action),
        "action_std": rng.uniform(0.5, 2, action),
        "proprio_mean": rng.normal(size=proprio),
        "proprio_std": rng.uniform(0.5, 2, proprio),
    }
    inputs = {k: v.astype(np.float32) for k, v in arrays.items()}
    inputs["image"] = image.astype(np.uint8)
    inputs["is_pad"] = np.arange(CHUNK) >= np.array([[CHUNK], [CHUNK - 2]])
    return inputs


def lerobot(action: int, proprio: int):
    """The network, and its outputs without and with actions."""
    config = settings(
        ACTConfig, proprio, action, VIEWS, SIZE, chunk_size=CHUNK, n_action_steps=CHUNK,
        pretrained_backbone_weights=None, dim_model=WIDTH, n_heads=2, dim_feedforward=24,
        n_encoder_layers=2, n_vae_encoder_layers=2, latent_dim=4, dropout=0.0,
    )  # fmt: skip
    model = ACT(config)
    torch.randn_like = torch.zeros_like  # the latent is its mean

    def run(images, state, target=None, is_pad=None):
        batch = {"observation.images": list(images.unbind(1)), "observation.state": state}
        model.train(target is not None)
        if target is not None:
            batch |= {"action": target, "action_is_pad": is_pad}
        return model(batch)

    return model, run


def original(checkout: str):
    """The network, and its outputs without and with actions."""
    sys.modules["IPython"] = MagicMock()
    sys.path.insert(0, str(Path(checkout) / "detr"))
    from models import backbone, detr_vae

    backbone.is_main_process = lambda: False  # no ImageNet weights
    detr_vae.reparametrize = lambda mean, log_variance: mean
    arguments = types.SimpleNamespace(
        hidden_dim=WIDTH, dropout=0.0, nheads=2, dim_feedforward=24, enc_layers=2, dec_layers=2,
        pre_norm=False, position_embedding="sine", backbone="resnet18", lr_backbone=1e-5,
        masks=False, dilation=False, num_queries=CHUNK, camera_names=["a", "b"],
    )  # fmt: skip
    model = detr_vae.build(arguments).eval()

    def run(images, state, target=None, is_pad=None):
        actions, _, latent = model(state, images, None, target, is_pad)
        return actions, latent

    return model, run


def outputs(run, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    given = {k: torch.from_numpy(v) for k, v in inputs.items()}
    images = ((given["image"] / 255 - MEAN) / STD).movedim(-1, 2)
    state = (given["proprio"] - given["proprio_mean"]) / given["proprio_std"]
    target = (given["action"] - given["action_mean"]) / given["action_std"]
    is_pad = given["is_pad"]
    acted, _ = run(images, state)
    predicted, (mean, log_variance) = run(images, state, target, is_pad)
    kl = (-0.5 * (1 + log_variance - mean**2 - log_variance.exp())).sum(1).mean()
    error = F.l1_loss(predicted, target, reduction="none") * ~is_pad[..., None]
    tensors = {
        "action": acted * given["action_std"] + given["action_mean"],
        "kl": kl,
        "l1_zeroed": error.mean(),
        "l1_valid": error.sum() / ((~is_pad).sum() * target.shape[-1]),
    }
    return {f"out_{k}": v.numpy() for k, v in tensors.items()}


def ensemble() -> dict[str, np.ndarray]:
    """Actions that LeRobot's temporal ensembler gives for made-up chunks."""
    chunks = np.random.RandomState(2).normal(size=(9, BATCH, 4, 3)).astype(np.float32)
    ensembler = ACTTemporalEnsembler(0.01, 4)
    actions = [ensembler.update(torch.from_numpy(chunk)).numpy() for chunk in chunks]
    return {"ensemble/chunks": chunks, "ensemble/actions": np.stack(actions)}


def main() -> None:
    arrays = ensemble()
    for case, sizes in SIZES.items():
        model, run = lerobot(*sizes) if case == "lerobot" else original(sys.argv[1])
        inputs = make_inputs(*sizes)
        names = fill(model)
        with torch.no_grad():
            tensors = outputs(run, inputs)
        inputs["names"] = np.array(json.dumps(names))
        arrays |= {f"{case}/{k}": v for k, v in (inputs | tensors).items()}
        print(case, {k: float(v) for k, v in tensors.items() if v.ndim == 0})
    path = Path(__file__).with_name("act_public.npz")
    np.savez_compressed(path, **arrays)
    print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
