"""What belongs into each of the paper's figures."""

from made_runs import BY_FIELD, arms_of, make_studies

from jaxcam.reports.studies import panels


def test_a_figure_has_the_arms_that_differ_in_its_setting_alone(tmp_path):
    make_studies(tmp_path)
    arms = arms_of(tmp_path)
    (scene,) = panels(BY_FIELD["scene"], arms)
    # Token is there in one scene only, so it compares nothing.
    assert {v: list(some) for v, some in scene.arms.items()} == {
        "randomized": ["twin of late", "late"], "fixed": ["twin of late", "late"]
    }  # fmt: skip
    (ways,) = panels(BY_FIELD["conditioning"], arms)
    assert {v: list(some) for v, some in ways.arms.items()} == {
        "token": ["token"], "late": ["twin of late", "late"]
    }  # fmt: skip
    (cameras,) = panels(BY_FIELD["n"], arms)
    assert list(cameras.arms) == [3, 30]
    assert cameras.title == "Lift\nACT, laptop preset"
    assert panels(BY_FIELD["action_space"], arms) == []


def test_one_conditioning_beside_its_twin_is_no_figure_of_encodings(runs):
    assert panels(BY_FIELD["conditioning"], arms_of(runs)) == []
