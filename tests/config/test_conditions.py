"""Conditions: texts of one meaning are one, and what cannot be is refused with a sentence."""

import numpy as np
import pytest

from jaxcam.config.conditions import (
    FOVY,
    Conditions,
    degrees_and_cm,
    lens_spans,
    of_task,
    several,
    span,
)
from jaxcam.config.datasets import CollectConfig
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError


@pytest.mark.parametrize(
    ("name", "text", "kept"),
    [
        ("pose_noise", "1.0,0.50", "1,0.5"),
        ("pose_noise", "0,0", ""),
        ("pose_drift", " 2,0 ", "2,0"),
        ("fovy", "35.0:55", "35:55"),
        ("fovy", "45:45", "45"),
        ("fovy", "nominal", ""),
        ("aspect", "1:1", ""),
        ("centre", "0", ""),
        ("lens", "opencv:-0.30:0,0.1:0.10", "opencv:-0.3:0,0.1"),
        ("lens", "opencv:0:0", ""),
        ("lens", "opencv:0,-0:0", ""),
        ("lens", "opencv:-0.3:-0,0,0:0", "opencv:-0.3:0"),
        ("lens", "fisheye:0,0", "fisheye:0"),
        ("lens", "fisheye:0,0.1,0", "fisheye:0,0.1"),
        ("centre", "-0:0", ""),
        ("centre", "-0:0.1", "0:0.1"),
        ("pose_noise", "-0,1", "0,1"),
        ("pose_drift", "0,-0", ""),
    ],
)
def test_texts_of_one_meaning_become_one(name, text, kept):
    assert getattr(Conditions(**{name: text}), name) == kept


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("pose_noise", "1", "DEG,CM"),
        ("pose_noise", "1,-1", "up to 180 degrees"),
        ("pose_noise", "1,nan", "DEG,CM"),
        ("pose_drift", "181,0", "pose_drift must be DEG,CM"),
        ("fovy", "55:35", "LOW:HIGH"),
        ("fovy", "0:35", "from 1 to 170"),
        ("fovy", "1:2:3", "LOW:HIGH"),
        ("lens", "opencv", "1 to 5 coefficients"),
        ("lens", "fisheyes:0:1", "fisheye"),
        ("lens", "fisheye:0,0,0,0,0", "1 to 4"),
    ],
)
def test_what_cannot_be_is_refused(name, text, words):
    with pytest.raises(ConfigError, match=words):
        Conditions(**{name: text})


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("pose_noise", "0.00001,0.000000000001"),
        ("lens", "opencv:-0.00001:0.00001"),
        ("fovy", "45.000000000001"),
        ("pose_drift", "99.123456789,999.9"),
    ],
)
def test_what_is_kept_can_be_read_again(name, text):
    kept = Conditions(**{name: text})
    assert getattr(kept, name) == text
    assert Conditions(**{name: getattr(kept, name)}) == kept


def test_texts_are_read():
    assert degrees_and_cm("") == (0, 0)
    assert degrees_and_cm("1,0.5") == (1, 0.5)
    assert span("", "fovy", FOVY) is None
    assert span("45", "fovy", FOVY) == (45, 45)
    assert lens_spans("fisheye:-0.1:0.1,0.02") == ("fisheye", ((-0.1, 0.1), (0.02, 0.02)))


def test_several_are_all_combinations_once():
    usual = Conditions(fovy="35:55")
    made = several(usual, {"pose_noise": ("0,0", "1,1", "1.0,1"), "pose_drift": ("", "2,2")})
    assert [(c.pose_noise, c.pose_drift) for c in made] == [
        ("", ""), ("", "2,2"), ("1,1", ""), ("1,1", "2,2")
    ]  # fmt: skip
    assert {c.fovy for c in made} == {"35:55"}
    assert several(usual, {}) == [usual]


def test_the_task_s_own_field_of_view_is_no_condition():
    assert of_task(Conditions(fovy="45"), 45.0) == Conditions()
    assert of_task(Conditions(fovy="44:45"), 45.0).fovy == "44:45"
    assert of_task(Conditions(fovy="57.2958"), float(np.rad2deg(1.0))) == Conditions()
    assert of_task(Conditions(fovy="57.3"), float(np.rad2deg(1.0))).fovy == "57.3"


def test_rows_have_none_of_what_is_usual():
    said = Conditions(pose_noise="1,1").said
    assert said.pop("eval_pose_noise") == "1,1"
    assert set(said.values()) == {None}
    assert Conditions(pose_noise="1,1", fovy="45").words == "pose_noise 1,1 fovy 45"


def test_a_run_is_evaluated_with_its_own_cameras_unless_it_says_others():
    config = TrainConfig(fovy="35:55", lens="opencv:-0.1")
    assert config.conditions == Conditions(fovy="35:55", lens="opencv:-0.1")
    assert TrainConfig(fovy="35:55", eval_fovy="25:75").conditions.fovy == "25:75"
    assert TrainConfig(fovy="35:55", eval_fovy="nominal").conditions == Conditions()
    assert CollectConfig(aspect="1.0").aspect == ""
    with pytest.raises(ConfigError, match="--pose-noise"):
        TrainConfig(pose_noise_per="camera")
