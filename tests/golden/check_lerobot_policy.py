"""Hold policies that jaxcam exported against LeRobot's own classes: the same actions must come out.

LeRobot brings PyTorch, so this takes two environments; last with LeRobot 0.4.4 (Python 3.11)::

    pip install '.[smolvla]'
    python tests/golden/check_lerobot_policy.py make out
    python3.11 -m venv lerobot-env
    lerobot-env/bin/pip install lerobot==0.4.4
    lerobot-env/bin/python tests/golden/check_lerobot_policy.py check out

`make` exports policies of LeRobot's default sizes with random weights and statistics, together with
observations and the actions that jaxcam gives for them. `check` loads each with `from_pretrained`,
pipelines too, strictly, and prints the largest difference, relative to the largest action.
"""

import argparse
from pathlib import Path

import numpy as np

CASES = {
    "act": ("act", {}, 2, 0.0),
    "act_ensemble": ("act", {"chunk": 8, "execute": 0}, 1, 0.01),
    "act_pre_norm": ("act", {"pre_norm": True, "image_scaling": "unit"}, 1, 0.0),
    "diffusion": ("diffusion", {"sampler": "ddim", "sample_steps": 10}, 1, 0.0),
    "diffusion_per_view": (
        "diffusion",
        {"sampler": "ddim", "sample_steps": 10, "encoder_per_view": True, "crop": 84},
        2,
        0.0,
    ),
}
"""Policy, changes to its preset lerobot, views, rate of temporal ensembling."""
BATCH, SIDE, STEPS = 2, 96, 5
TOLERANCE = 1e-4


def make(folder: Path) -> None:
    """Export every case from jaxcam."""
    from dataclasses import asdict, replace

    import jax

    from jaxcam.config.train import TrainConfig
    from jaxcam.interop.lerobot.pipelines import STATISTICS
    from jaxcam.interop.lerobot.policy import export_policy
    from jaxcam.models import FAMILIES, PolicySpec, make_policy
    from jaxcam.runs.identity import resolve
    from jaxcam.sim.ensemble import ensemble
    from jaxcam.training.checkpoint import PolicyInputs

    rng = np.random.default_rng(0)

    def spread(path: tuple, leaf: jax.Array) -> np.ndarray:
        """Also what starts at 0 or 1 is to be told apart."""
        return np.asarray(leaf + 0.1 * rng.normal(size=leaf.shape) * (leaf.ndim < 2), np.float32)

    for name, (kind, changes, views, rate) in CASES.items():
        settings = replace(FAMILIES[kind].presets["lerobot"], **changes)
        spec = PolicySpec(7, 11, views, SIDE, SIDE, settings.chunk, settings.obs_steps)
        stats = {}
        for what, size in (("action", 7), ("proprio", 11)):
            low, width = rng.normal(size=size), rng.uniform(0.5, 2, size)
            for k, v in zip(
                STATISTICS, (low + width / 2, width / 3, low, low + width), strict=True
            ):
                stats[f"{what}_{k}"] = v.astype(np.float32)
        policy = make_policy(settings, spec, stats)
        params = jax.tree_util.tree_map_with_path(spread, policy.init(jax.random.key(1)))
        config = TrainConfig(policy=kind, preset="lerobot", views=views, ensemble=rate)
        config = resolve(config, accelerator=False)
        inputs = PolicyInputs(config, asdict(settings), asdict(spec), stats, params, 0)
        export_policy(inputs, folder / name)
        image = rng.integers(0, 256, (STEPS, BATCH, views, 12, 12, 3)).repeat(8, 3).repeat(8, 4)
        proprio = rng.normal(size=(STEPS, BATCH, 11)).astype(np.float32)
        camera = np.broadcast_to(np.eye(4, dtype=np.float32), (BATCH, views, 4, 4))
        key, actions, mean = jax.random.key(2), [], 0.0
        noise = jax.random.normal(jax.random.split(key)[0], (BATCH, settings.chunk, 7))
        act = jax.jit(policy.act)
        for t in range(STEPS):
            steps = [max(0, t - back) for back in reversed(range(settings.obs_steps))]
            obs = {
                "image": image[steps].astype(np.uint8).swapaxes(0, 1),
                "proprio": proprio[steps].swapaxes(0, 1),
                "K": np.stack([camera[..., :3, :3]] * len(steps), 1),
                "base_from_camera": np.stack([camera] * len(steps), 1),
            }
            obs = obs if settings.obs_steps > 1 else {k: v[:, 0] for k, v in obs.items()}
            chunk = np.asarray(act(params, obs, key))
            if rate:
                now, mean = ensemble(mean + np.zeros_like(chunk), chunk, np.array(t), rate)
                chunk = now[:, None]
            actions.append(chunk[:, 0])
        np.savez(
            folder / f"{name}.npz",
            image=image.astype(np.uint8),
            proprio=proprio,
            noise=noise,
            actions=actions,
        )
        print(f"{name}: exported")


def check(folder: Path) -> None:
    """Load every case with LeRobot and compare; every step is a policy call of its own."""
    import torch
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
    from lerobot.policies.factory import make_pre_post_processors

    for name, (kind, _, views, rate) in CASES.items():
        path = str(folder / name)
        policy = (ACTPolicy if kind == "act" else DiffusionPolicy).from_pretrained(
            path, strict=True
        )
        before, after = make_pre_post_processors(policy.config, pretrained_path=path)
        given, computed = np.load(folder / f"{name}.npz"), []
        noise = {"noise": torch.from_numpy(given["noise"])} if kind == "diffusion" else {}
        policy.reset()
        for image, proprio in zip(given["image"], given["proprio"], strict=True):
            obs = {"observation.state": torch.from_numpy(proprio)}
            for v in range(views):
                picture = torch.from_numpy(image[:, v]).permute(0, 3, 1, 2) / 255
                obs[f"observation.images.view_{v}"] = picture
            if not rate:
                policy._queues["action"].clear() if kind == "diffusion" else policy.reset()
            computed.append(after(policy.select_action(before(obs), **noise)).numpy())
        error = np.abs(np.stack(computed) - given["actions"]).max() / np.abs(given["actions"]).max()
        print(f"{name}: {len(policy.state_dict())} arrays, relative error {error:.1e}", flush=True)
        assert error < TOLERANCE, error


def main() -> None:
    """Make or check."""
    parser = argparse.ArgumentParser(description="Hold exports against LeRobot's classes.")
    parser.add_argument("what", choices=("make", "check"))
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    (make if args.what == "make" else check)(args.folder)


if __name__ == "__main__":
    main()
