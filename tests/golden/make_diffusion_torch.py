"""Write `diffusion_torch.npz`: what LeRobot's Diffusion Policy computes, for the parity tests.

For the environment see `lerobot_networks.py`; jaxcam is not needed:

    python tests/golden/make_diffusion_torch.py

Modules are LeRobot 0.4.4's, samplers diffusers' own. The paper's and the original policy are made
of them: nine input channels and a local condition (two residual blocks, added before the second
block of the first stage and after the last upsampling) for the paper; an encoder per view, a crop
and no last activation for the original. Only the U-Net is narrow. Weights are not stored: they are
made from their names, here and in the test.
"""

import json
from pathlib import Path

import numpy as np
import torch
from diffusers.schedulers import scheduling_ddpm
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot_networks import (
    DiffusionConditionalResidualBlock1d,
    DiffusionConfig,
    DiffusionModel,
    fill,
    settings,
)
from make_act_torch import authors_rays
from torch import nn

BATCH, VIEWS, ACTION, PROPRIO, CHUNK, DENOISING = 2, 2, 3, 5, 8, 10
CASES = {"paper": (64, 1), "lerobot": (96, 2), "original": (84, 2)}
"""Image side and observation steps."""
MEAN, STD = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])


def make_inputs(size: int, steps: int) -> dict[str, np.ndarray]:
    rng = np.random.RandomState(0)
    c = np.sqrt(0.5)
    pose = np.tile(np.eye(4), (BATCH, steps, VIEWS, 1, 1))
    pose[..., :3, :3] = [[0, c, -c], [1, 0, 0], [0, -c, -c]]
    low, high = [0.9, -0.3, 0.3], [1.5, 0.3, 0.9]
    pose[..., :3, 3] = rng.uniform(low, high, (BATCH, 1, VIEWS, 3))
    K = np.array([[77.0, 0, size / 2], [0, 77, size / 2], [0, 0, 1]])
    # Coarse noise: it compresses.
    image = rng.randint(0, 256, (BATCH, steps, VIEWS, size // 4, size // 4, 3))
    image = image.repeat(4, 3).repeat(4, 4)
    low = rng.normal(size=(2, max(ACTION, PROPRIO)))
    high = low + rng.uniform(1, 3, low.shape)
    arrays = {
        "K": np.tile(K, (BATCH, steps, VIEWS, 1, 1)),
        "base_from_camera": pose,
        "proprio": rng.normal(size=(BATCH, steps, PROPRIO)),
        "action": rng.uniform(low[0, :ACTION], high[0, :ACTION], (BATCH, CHUNK, ACTION)),
        "action_min": low[0, :ACTION],
        "action_max": high[0, :ACTION],
        "proprio_min": low[1, :PROPRIO],
        "proprio_max": high[1, :PROPRIO],
        "noise": rng.normal(size=(BATCH, CHUNK, ACTION)),
        "fresh": rng.normal(size=(DENOISING, BATCH, CHUNK, ACTION)),
    }
    inputs = {k: v.astype(np.float32) for k, v in arrays.items()}
    inputs["image"] = image.astype(np.uint8)
    inputs["t"] = np.array([37, 4])
    inputs["is_pad"] = np.arange(CHUNK) >= np.array([[CHUNK], [CHUNK - 3]])
    return inputs


def make_model(case: str, size: int, steps: int) -> DiffusionModel:
    original = case == "original"
    config = settings(
        DiffusionConfig, PROPRIO, ACTION, VIEWS, size,
        n_obs_steps=steps, horizon=CHUNK, n_action_steps=CHUNK - steps + 1, down_dims=(16, 32),
        use_separate_rgb_encoder_per_camera=original, crop_shape=(76, 76) if original else None,
    )  # fmt: skip
    model = DiffusionModel(config)
    if original:
        for encoder in model.rgb_encoder:
            encoder.relu = nn.Identity()
    if case == "paper":
        features = VIEWS * model.rgb_encoder.feature_dim
        model.unet = type(model.unet)(config, global_cond_dim=features)
        model.rgb_encoder.backbone[0] = nn.Conv2d(9, 64, 7, 2, 3, bias=False)
        model.unet.local_cond_encoder = nn.ModuleList(
            DiffusionConditionalResidualBlock1d(
                PROPRIO, 16, 128 + features, 5, 8, use_film_scale_modulation=True
            )
            for _ in range(2)
        )
    return model.eval()


def with_local(unet: nn.Module, x, t, condition, local):
    """The authors' U-Net: a condition of every step enters twice."""
    step = torch.cat([unet.diffusion_step_encoder(t), condition], -1)
    local = local[:, :, None].expand(-1, -1, CHUNK)
    early, late = (block(local, step) for block in unet.local_cond_encoder)
    x, skips = x.transpose(1, 2), []
    for i, (first, second, shrink) in enumerate(unet.down_modules):
        x = first(x, step)
        x = second(x + early if i == 0 else x, step)
        skips.append(x)
        x = shrink(x)
    for block in unet.mid_modules:
        x = block(x, step)
    for first, second, grow in unet.up_modules:
        x = grow(second(first(torch.cat([x, skips.pop()], 1), step), step))
    return unet.final_conv(x + late).transpose(1, 2)


def condition(case: str, model: DiffusionModel, given: dict, rays: torch.Tensor):
    """Global condition, and a predictor of noise."""
    middle = (given["proprio_max"] + given["proprio_min"]) / 2
    half = (given["proprio_max"] - given["proprio_min"]) / 2
    images = given["image"] / 255
    if case == "lerobot":
        images = (images - MEAN) / STD
    if case == "original":
        images = 2 * images - 1
    images = images.movedim(-1, -3)
    if case == "paper":
        both = torch.cat([images, rays], -3).flatten(0, 2)
        features = model.rgb_encoder(both).reshape(BATCH, -1)
        proprio = (-middle / half).expand(BATCH, -1)
        return features, lambda x, t: with_local(model.unet, x, t, features, proprio)
    batch = {
        "observation.state": (given["proprio"] - middle) / half,
        "observation.images": images,
    }
    together = model._prepare_global_conditioning(batch)
    return together, lambda x, t: model.unet(x, t, global_cond=together)


def run(case: str, size: int, steps: int) -> dict[str, np.ndarray]:
    model, inputs = make_model(case, size, steps), make_inputs(size, steps)
    names = fill(model)
    given = {k: torch.from_numpy(v) for k, v in inputs.items()}
    rays = torch.zeros(0)
    if case == "paper":
        flat = inputs["base_from_camera"].astype(np.float64).reshape(-1, 4, 4)
        rays = np.stack([authors_rays(inputs["K"][0, 0, 0], pose) for pose in flat])
        rays = torch.from_numpy(rays).reshape(BATCH, steps, VIEWS, 6, size, size)
    together, predict = condition(case, model, given, rays)

    middle = (given["action_max"] + given["action_min"]) / 2
    half = (given["action_max"] - given["action_min"]) / 2
    pad = given["is_pad"]
    action = given["action"].clone()
    last = (~pad).sum(1) - 1
    for b in range(BATCH):  # the paper pads by zeros, the others repeat the last action
        action[b, pad[b]] = 0.0 if case == "paper" else action[b, last[b]].clone()
    shared = {"num_train_timesteps": 100, "beta_schedule": "squaredcos_cap_v2"}
    ddpm, ddim = DDPMScheduler(**shared), DDIMScheduler(**shared)
    noisy = ddpm.add_noise((action - middle) / half, given["noise"], given["t"])
    predicted = predict(noisy, given["t"])
    error = (predicted - given["noise"]) ** 2
    keep = ~pad[..., None]
    out = {
        "condition": together,
        "predicted": predicted,
        "loss_counted": error.mean(),
        "loss_zeroed": (error * keep).mean(),
        "loss_sample": ((error * keep).mean(-1).sum(1) / (~pad).sum(1)).mean(),
        "loss_valid": (error * keep).sum() / (keep.sum() * ACTION),
    }
    for name, scheduler in (("ddpm", ddpm), ("ddim", ddim)):
        fresh = iter(given["fresh"])
        scheduling_ddpm.randn_tensor = lambda *_, fresh=fresh, **__: next(fresh)
        scheduler.set_timesteps(DENOISING)
        x = given["noise"]
        for t in scheduler.timesteps:
            x = scheduler.step(predict(x, t.expand(BATCH)), t, x).prev_sample
        out[name] = (x * half + middle)[:, steps - 1 :]
    inputs["action"] = np.where(inputs["is_pad"][..., None], 0, inputs["action"])
    inputs["names"] = np.array(json.dumps(names))
    return inputs | {f"out_{k}": v.numpy() for k, v in out.items()}


def main() -> None:
    arrays = {}
    with torch.no_grad():
        for case, (size, steps) in CASES.items():
            computed = run(case, size, steps)
            arrays |= {f"{case}/{k}": v for k, v in computed.items()}
            print(case, {k: float(v) for k, v in computed.items() if k.startswith("out_loss")})
    path = Path(__file__).with_name("diffusion_torch.npz")
    np.savez_compressed(path, **arrays)
    print(f"{path.name}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
