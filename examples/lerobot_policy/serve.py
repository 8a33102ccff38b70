"""A policy of LeRobot's as a server that `python -m jaxcam.evaluate --policy` asks.

    python serve.py out/act/checkpoints/last/pretrained_model --port 8000

It runs in LeRobot's environment and needs of jaxcam only `jaxcam.client`; see README.md. It keeps
nothing between questions, since each one has all that the policy sees.
"""

import argparse
import hashlib
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from websockets.sync.server import ServerConnection, serve

from jaxcam.client import MOST_BYTES, from_wire, to_wire

IMAGES, STATE = "observation.images.", "observation.state"
Infer = Callable[[Mapping[str, Any]], np.ndarray]


def load(folder: Path, seed: int) -> tuple[Infer, dict[str, Any]]:
    """ACT or Diffusion Policy with its pipelines, as LeRobot saved them.

    Args:
        folder: `pretrained_model` of a checkpoint.
        seed: Of the noise that diffusion begins with, the same at each question.

    Returns:
        What gives the actions [T, A] for an observation, and what the server says of itself.
    """
    from lerobot.configs.policies import PreTrainedConfig  # LeRobot's environment only
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    config = PreTrainedConfig.from_pretrained(folder)
    config.device = "cuda" if torch.cuda.is_available() else "cpu"
    policy = get_policy_class(config.type).from_pretrained(folder, config=config).eval()
    before, after = make_pre_post_processors(config, pretrained_path=str(folder))
    views = [name for name in config.input_features if name.startswith(IMAGES)]

    @torch.no_grad()
    def infer(observation: Mapping[str, Any]) -> np.ndarray:
        torch.manual_seed(seed)
        batch = before(as_batch(observation, views))
        if config.type == "diffusion":  # what its own queues would hold
            batch["observation.images"] = torch.stack([batch[name] for name in views], dim=-4)
            actions = policy.diffusion.generate_actions(batch)
        else:
            actions = policy.predict_action_chunk(batch)
        return after(actions)[0, : config.n_action_steps].cpu().numpy()

    rows, columns = config.input_features[views[0]].shape[1:]
    weights = (folder / "model.safetensors").read_bytes()
    return infer, {
        "server": "lerobot",
        "policy": config.type,
        "weights": hashlib.sha256(weights).hexdigest()[:16],
        "views": [name.removeprefix(IMAGES) for name in views],
        "image_size": [rows, columns],
        "observation_steps": config.n_obs_steps,
        "execute": config.n_action_steps,
        "seed": seed,
    }


def as_batch(observation: Mapping[str, Any], views: list[str]) -> dict[str, torch.Tensor]:
    """An observation as LeRobot's pipelines take it: a batch of one, pictures from 0 to 1.

    Args:
        observation: Pictures uint8 [H, W, 3] and state [P], or several of each, oldest first.
        views: Names of the pictures.
    """
    pictures = {v: torch.tensor(observation[v]).movedim(-1, -3)[None] / 255 for v in views}
    return {STATE: torch.tensor(observation[STATE])[None], **pictures}


def handler_of(infer: Infer, metadata: Mapping[str, Any]) -> Callable[[ServerConnection], None]:
    """The protocol of openpi for one client: metadata, then an answer to each observation.

    Args:
        infer: Gives the actions for an observation; one question at a time.
        metadata: What the server says of itself.
    """
    one_at_a_time = threading.Lock()

    def handle(connection: ServerConnection) -> None:
        connection.send(to_wire(dict(metadata)))
        for message in connection:
            try:
                with one_at_a_time:
                    actions = infer(from_wire(message))
                answer: str | bytes = to_wire({"actions": actions})
            except Exception as error:  # who asks is told, and may ask again
                answer = f"{type(error).__name__}: {error}"
            connection.send(answer)

    return handle


def main() -> None:
    """Serves until Ctrl-C."""
    parser = argparse.ArgumentParser(description="Serve a policy of LeRobot's to jaxcam.")
    parser.add_argument("folder", type=Path, help="pretrained_model of a checkpoint")
    parser.add_argument("--port", type=int, default=8000)
    parser.add_argument("--action-space", default="eef_delta", help="that of the export")
    parser.add_argument("--seed", type=int, default=0, help="of the noise of diffusion")
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    infer, metadata = load(args.folder, args.seed)
    metadata["action_space"] = args.action_space
    handler = handler_of(infer, metadata)
    with serve(handler, "127.0.0.1", args.port, compression=None, max_size=MOST_BYTES) as server:
        print(f"Serving {args.folder} on ws://127.0.0.1:{args.port}", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
