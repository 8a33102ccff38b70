"""How settings name what a policy is told of its cameras."""

from dataclasses import replace

import numpy as np
import pytest

from jaxcam.config.presets import PRESETS
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models import ACT_PRESETS, FAMILIES, policy_settings
from jaxcam.models.conditioning import NOMINAL_POSE, VisionConfig, with_conditioning
from jaxcam.runs.identity import resolve


def test_none_keeps_the_network_it_is_compared_with():
    laptop = ACT_PRESETS["laptop"]
    twin = with_conditioning(laptop, "none")
    assert (twin.conditioning, twin.network) == ("none", laptop.network)
    assert with_conditioning(with_conditioning(laptop, "late"), "none").network == "late"
    assert with_conditioning(twin, "early").network == "early"


def test_presets_say_which_network_an_image_only_policy_shares():
    """Reports learn from the settings alone whose twin a run is."""
    for (policy, name), preset in PRESETS.items():
        settings = FAMILIES[policy].presets[name]
        assert with_conditioning(settings, "none").network == preset.conditioning, (policy, name)


def test_a_policy_that_is_told_its_camera_is_nobodys_twin():
    config = TrainConfig(preset="laptop", conditioning="late", model=("twin_of=early",))
    with pytest.raises(ConfigError, match="twin_of is for --conditioning none, not late"):
        policy_settings(resolve(config, accelerator=False), ())
    twin = replace(config, conditioning="none")
    settings = policy_settings(resolve(twin, accelerator=False), ())
    assert (settings.conditioning, settings.network) == ("none", "early")


@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        ({"ray_frame": "grip"}, "--ray-frame grip"),
        ({"rays_from": "nominal"}, "--rays-from nominal"),
        ({"pose_noise": "1,1"}, "--pose-noise 1,1"),
    ],
)
def test_heat_maps_are_taught_by_true_cameras_only(cameras, words):
    taught = TrainConfig(preset="laptop", model=("heatmap_weight=1",))
    assert policy_settings(resolve(taught, accelerator=False), ()).heatmap_weight == 1
    with pytest.raises(ConfigError, match=f"true poses and intrinsics in the base, which {words}"):
        policy_settings(resolve(replace(taught, **cameras), accelerator=False), ())


def test_nominal_pose_is_a_camera_that_looks_at_the_table():
    pose = np.array(NOMINAL_POSE)
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    # The table's centre, in the base frame, lies 0.95 m ahead in the middle of the image.
    centre = np.linalg.inv(pose) @ [0.56, 0.0, 0.8 - 0.912, 1.0]
    np.testing.assert_allclose(centre, [0, 0, 0.95, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "hint"),
    [
        ({"conditioning": "keypoint"}, "keypoints"),
        ({"twin_of": "lat"}, "late"),
        ({"encoder": "resnet"}, "resnet18"),
        ({"compute_dtype": "bf16"}, "bfloat16"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest(changes, hint):
    with pytest.raises(ConfigError, match=f"did you mean '{hint}'"):
        VisionConfig(**changes)
