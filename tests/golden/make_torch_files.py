"""Write small files of tensors in PyTorch's two layouts.

`weights.pth` and `weights_legacy.pth` have the usual types, `weights_types.pth` and
`weights_types_legacy.pth` those that PyTorch stores in another way.

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
    numbers = torch.tensor([0.5, -2.0, 3.0])
    types = {
        "uint16": torch.tensor([1, 2, 60000], dtype=torch.uint16)[1:],
        "uint64": torch.tensor([1, 2**40], dtype=torch.uint64),
        "complex": numbers * 1j,
        "e4m3": numbers.to(torch.float8_e4m3fn)[1:],
        "e5m2": numbers.to(torch.float8_e5m2),
    }
    folder = Path(__file__).parent
    for name, tensors in (("weights", content), ("weights_types", types)):
        torch.save(tensors, folder / f"{name}.pth")
        legacy = folder / f"{name}_legacy.pth"
        torch.save(tensors, legacy, _use_new_zipfile_serialization=False)


if __name__ == "__main__":
    main()
