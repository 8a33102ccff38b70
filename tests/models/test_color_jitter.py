"""Other colours: what torchvision's four moves give one after the other, and nothing else moves."""

import jax
import numpy as np
import pytest

from jaxcam.models.color_jitter import HUE, color_jitter

GREY = np.array([0.299, 0.587, 0.114])
STRENGTH = 0.4


@pytest.fixture(scope="module")
def batch():
    rng = np.random.default_rng(0)
    # Of middling colours, which no move takes out of 0 to 255.
    image = rng.integers(90, 130, (6, 2, 8, 9, 3)).astype(np.uint8)
    return {"image": image, "K": np.ones((6, 2, 3, 3), np.float32), "action": np.arange(6)}


@pytest.fixture(scope="module")
def changed(batch):
    return jax.tree.map(np.asarray, jitter(batch, jax.random.key(3)))


@jax.jit
def jitter(batch, key):
    return color_jitter(batch, key, strength=STRENGTH)


def turned(image, turn):
    """Hues of [..., 3] turned by a share of a whole turn, by complex numbers in the YIQ plane."""
    chroma = image @ np.array([0.596 + 0.211j, -0.274 - 0.523j, -0.322 + 0.312j])
    chroma = chroma * np.exp(2j * np.pi * turn)
    yiq = np.stack([image @ GREY, chroma.real, chroma.imag], -1)
    axes = np.array([GREY, [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
    return yiq @ np.linalg.inv(axes).T


def test_the_moves_are_made_one_after_the_other(batch, changed):
    drawn = jax.random.uniform(jax.random.key(3), (6, 2, 4), minval=-STRENGTH, maxval=STRENGTH)
    for place in np.ndindex(6, 2):
        brightness, contrast, saturation = 1 + np.asarray(drawn[place][:3], float)
        image = batch["image"][place] * brightness
        image = contrast * image + (1 - contrast) * (image @ GREY).mean()
        image = turned(image, HUE * float(drawn[place][3]))
        image = saturation * image + (1 - saturation) * (image @ GREY)[..., None]
        np.testing.assert_allclose(changed["image"][place], image, atol=1e-3)


def test_cameras_and_targets_stay(batch, changed):
    assert changed["image"].dtype == np.float32
    np.testing.assert_array_equal(changed["K"], batch["K"])
    np.testing.assert_array_equal(changed["action"], batch["action"])


def test_every_picture_has_its_own_colours(batch):
    same = batch | {"image": np.broadcast_to(batch["image"][:1, :1], batch["image"].shape)}
    image = np.asarray(jitter(same, jax.random.key(0))["image"])
    means = image.mean((-3, -2)).reshape(-1, 3)
    assert len(np.unique(means.round(3), axis=0)) == 12


def test_colours_stay_colours():
    extreme = {"image": np.array([0, 255], np.uint8).repeat(24).reshape(1, 4, 4, 3)}
    image = np.asarray(jitter(extreme, jax.random.key(1))["image"])
    assert image.min() >= 0
    assert image.max() <= 255


def test_strength_0_leaves_the_batch(batch):
    assert color_jitter(batch, jax.random.key(0), strength=0.0) is batch
