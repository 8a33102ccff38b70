"""The snippets of docs/conventions.md run, in order, and give what their comments say."""

import re

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
    assert names["points"].shape == (4, 84, 84, 3)
    assert names["cameras_of_demo"][5].tolist() == [5, 6, 7]
