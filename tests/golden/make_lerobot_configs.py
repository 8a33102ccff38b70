"""Write `lerobot_configs.json`: the `config.json` that LeRobot writes for each policy's defaults.

    pip install lerobot==0.6.1
    python tests/golden/make_lerobot_configs.py

Once for each version of LeRobot; what the file has of others stays. It says which settings there
are, and the test that each of them has a meaning here, or none, reads it.
"""

import json
import tempfile
from importlib.metadata import version
from pathlib import Path

from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig


def main() -> None:
    """Write every policy's defaults."""
    path = Path(__file__).parent / "lerobot_configs.json"
    by_version = json.loads(path.read_text()) if path.exists() else {}
    own = by_version[version("lerobot")] = {}
    kinds = {"act": ACTConfig, "diffusion": DiffusionConfig, "smolvla": SmolVLAConfig}
    for name, kind in kinds.items():
        with tempfile.TemporaryDirectory() as folder:
            kind(device="cpu")._save_pretrained(Path(folder))
            config = json.loads((Path(folder) / "config.json").read_text())
        own[name] = {"type": name} | config
    path.write_text(json.dumps(by_version, indent=1) + "\n")


if __name__ == "__main__":
    main()
