"""What the paper says, against what it says elsewhere."""

import pytest

from jaxcam.reports import paper


def test_every_gain_of_the_papers_table_is_what_its_text_says():
    gain = [paper.success(p, t, True) - paper.success(p, t, False) for p in paper.POLICIES
            for t in paper.TASKS]  # fmt: skip
    assert min(gain) == pytest.approx(0.4)  # "increases success rates for all models in all tasks"
    assert max(gain) == pytest.approx(34.8)
    assert paper.success("act", "a task of ours", True) is None
    assert paper.success("a policy of ours", "lift", True) is None
