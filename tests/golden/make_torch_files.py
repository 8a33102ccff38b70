"""Write `weights.pth` and `weights_legacy.pth`: small files of tensors in PyTorch's two layouts.

pip install torch==2.13.0 numpy
python tests/golden/make_torch_files.py
"""

from collections import OrderedDict
from pathlib import Path

import torch


def main() -> None:
    base = torch.arange(24, dtype=torch.float32)
    state = OrderedDict(
        plain=base.reshape(4, 6),
        turned=base.reshape(4, 6).T[1:3],
        scalar=torch.tensor(7),
        empty=torch.zeros(0, 3),
        half=torch.tensor([1.5, -2.0], dtype=torch.float16),
        brain=torch.tensor([1.5, -3.0], dtype=torch.bfloat16),
        flags=torch.tensor([True, False]),
        parameter=torch.nn.Parameter(torch.ones(2)),
    )
    state._metadata = OrderedDict(version=1)
    content = {"net": state, "step": 3, "note": "text", "list": [torch.full((1,), 9.0)]}
    folder = Path(__file__).parent
    torch.save(content, folder / "weights.pth")
    torch.save(content, folder / "weights_legacy.pth", _use_new_zipfile_serialization=False)


if __name__ == "__main__":
    main()
