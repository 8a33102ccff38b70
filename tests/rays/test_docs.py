"""The snippets of docs/conventions.md run, in order, and give what their comments say."""

import re

import numpy as np
from places import REPO

PAGE = REPO / "docs/conventions.md"


def test_snippets_run():
    snippets = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(snippets) >= 4
    names = {}
    exec(compile("\n".join(snippets), str(PAGE), "exec"), names)
    assert names["rays"].shape == (4, 84, 84, 6)
    assert names["poses"].shape == (4, 4, 4)
    assert (names["small"].height, names["small"].width) == (84, 84)
    assert names["bent"].shape == (4, 84, 84, 6)
    assert names["views"].shape == (2, 84, 84, 6)
    assert names["tokens"].shape == (4, 6, 6, 6)
    np.testing.assert_allclose(names["K_mjcf"], [[50, 0, 28], [0, 60, 27], [0, 0, 1]])
    assert names["K_here"][0, 2] == 32
    assert names["points"].shape == (4, 84, 84, 3)
    assert names["cameras_of_demo"][5].tolist() == [5, 6, 7]
