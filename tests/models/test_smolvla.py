"""SmolVLA's parts and rules; its numbers are in `models/test_smolvla_parity.py`."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import nnx
from policy_inputs import jit, make_batch, make_stats, moved, shapes, start

from jaxcam.config.names import TaskName, names_of
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models import PolicySpec, make_policy
from jaxcam.models.conditioning import with_conditioning
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS, SmolVlaConfig
from jaxcam.models.smolvla.flow import draw_time, integrate, line, time_embedding
from jaxcam.models.smolvla.prompt import tokenize, with_prompt
from jaxcam.models.smolvla.siglip import Siglip
from jaxcam.models.smolvla.smollm import rope
from jaxcam.models.smolvla.stack import through
from jaxcam.pipeline.sources import source_of
from jaxcam.pipeline.train import policy_of
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_task
from jaxcam.training.state import make_optimizer

TINY = replace(
    SMOLVLA_PRESETS["tiny"], chunk=4, image_size=32, layers=1, vision_layers=1, remat=False
)
SPEC = PolicySpec(3, 5, 1, 32, 32, 4)


@cache
def policy(config=TINY):
    return make_policy(config, SPEC, make_stats())


def test_time_embedding_is_the_golden_one():
    embedded = np.asarray(time_embedding(jnp.array([0.1], jnp.float32), 720))[0]
    golden = {0: 0.0, 1: -0.14747328557070905, 359: 0.15643446504023087, 360: 1.0}
    golden |= {361: -0.9890660392728992, 719: 0.9876883405951378}
    for channel, value in golden.items():
        # The golden numbers are for 0.1, and float32's 0.1 is 1.5e-9 more.
        assert embedded[channel] == pytest.approx(value, abs=4e-6)


def test_times_are_beta_distributed():
    times = np.asarray(draw_time(jax.random.key(0), 200_000))
    assert times.min() >= 0.001
    assert times.max() <= 1
    assert times.mean() == pytest.approx(0.6004, abs=3e-3)
    assert times.std() == pytest.approx(0.2616, abs=3e-3)


def test_euler_follows_a_straight_line_exactly():
    rng = np.random.default_rng(0)
    action, noise = (jnp.asarray(rng.normal(size=(2, 4, 3)), jnp.float32) for _ in range(2))
    x, velocity = line(action, noise, jnp.array([0.25, 1.0]))
    np.testing.assert_allclose(x[1], noise[1])
    np.testing.assert_allclose(x[0], action[0] + 0.25 * velocity[0], rtol=1e-5, atol=1e-6)
    asked = []
    with jax.disable_jit():
        found = integrate(lambda x, t: asked.append(float(t[0])) or velocity, noise, 10)
    np.testing.assert_allclose(found, action, atol=1e-5)
    np.testing.assert_allclose(asked, np.arange(10, 0, -1) / 10, rtol=1e-6)


def test_rotary_scores_depend_on_distance_only():
    rng = np.random.default_rng(0)
    q, k = (jnp.asarray(rng.normal(size=(1, 1, 1, 16)), jnp.float32) for _ in range(2))

    def score(i, j):
        return float((rope(q, np.array([i])) * rope(k, np.array([j]))).sum())

    assert score(7, 3) == pytest.approx(score(104, 100), abs=1e-4)
    assert abs(score(7, 3) - score(7, 4)) > 1e-2


def test_paper_size_is_that_of_the_published_model():
    config = replace(SMOLVLA_PRESETS["lerobot"], tokens=(1,))
    spec = PolicySpec(7, 8, 1, 256, 256, 50)
    stats = {f"action_{k}": np.ones(7) for k in ("mean", "std")}
    stats |= {f"proprio_{k}": np.ones(8) for k in ("mean", "std")}
    parts = shapes(make_policy(config, spec, stats))
    count = {k: sum(x.size for x in jax.tree.leaves(v)) for k, v in parts.items()}
    # Published with a head over words and a last norm, which nothing here asks for.
    assert sum(count.values()) + 49280 * 960 + 960 == pytest.approx(450.05e6, abs=5e3)
    assert count["vision"] == pytest.approx(86.43e6, abs=5e3)
    assert count["connector"] == 12288 * 960


@pytest.mark.parametrize(
    "changes", [{"attention": "joint"}, {"attention": "interleaved", "layers": 2, "remat": True}]
)
def test_trains(changes):
    config = replace(TINY, conditioning="none", twin_of="none", **changes)
    subject, batch = policy(config), make_batch(size=32)
    batch["is_pad"] = np.zeros((2, 4), bool)
    tx = optax.adam(3e-3)

    def step(carry, _):
        params, opt = carry
        (loss, _), grads = jax.value_and_grad(subject.loss, has_aux=True)(params, batch, None)
        updates, opt = tx.update(grads, opt)
        return (optax.apply_updates(params, updates), opt), loss

    params = jax.tree.map(jnp.asarray, start(subject))
    losses = jit(lambda c: jax.lax.scan(step, c, length=60)[1])((params, tx.init(params)))
    assert float(losses[-1]) < 0.3 * float(losses[0])


def test_rematerialisation_changes_no_number():
    blocks = [nnx.Linear(4, 4, rngs=nnx.Rngs(i)) for i in range(3)]

    def run(x, *, remat):
        def step(layer, x, item):
            return jax.nn.silu(layer(x)) + item, x.sum()

        x, sums = through(blocks, step, x, jnp.arange(3.0), remat=remat)
        return x.sum() + (sums * jnp.arange(3.0)).sum()

    x = jnp.ones((2, 4))
    for function in (run, jax.grad(run)):
        np.testing.assert_allclose(function(x, remat=True), function(x, remat=False), rtol=1e-6)
    programs = [str(jax.make_jaxpr(partial(run, remat=remat))(x)) for remat in (False, True)]
    assert ["prevent_cse" in program for program in programs] == [False, True]


def test_expert_alone_is_trained():
    config = replace(TINY, train="expert", conditioning="none", twin_of="none")
    subject = policy(config)
    params = start(subject)
    grads = jit(jax.grad(lambda p: subject.loss(p, make_batch(size=32), None)[0]))(params)
    moved_parts = {k for k, v in grads.items() if float(optax.tree.norm(v)) > 0}
    assert moved_parts == params.keys() - {"vision", "connector", "embed", "text"}
    run = resolve(TrainConfig(policy="smolvla", preset="lerobot"), accelerator=False)
    tx = make_optimizer(run, subject.trained)
    state = jax.eval_shape(tx.init, params)
    size = {k: sum(x.size for x in jax.tree.leaves(v)) for k, v in params.items()}
    trained = sum(n for k, n in size.items() if k in moved_parts)
    assert sum(x.size for x in jax.tree.leaves(state)) == pytest.approx(2 * trained, abs=4)


@pytest.mark.parametrize("conditioning", ["token", "late"])
def test_conditioned_policy_looks_at_the_cameras_and_its_twin_does_not(conditioning):
    config = replace(with_conditioning(TINY, conditioning))
    batch, key = make_batch(size=32), jax.random.key(1)
    subject, twin = policy(config), policy(with_conditioning(config, "none"))
    params = start(subject)
    assert jax.tree.map(jnp.shape, params) == jax.tree.map(jnp.shape, shapes(twin))
    act, blind = jit(subject.act), jit(twin.act)
    assert not np.allclose(act(params, batch, key), act(params, moved(batch), key))
    np.testing.assert_array_equal(blind(params, batch, key), blind(params, moved(batch), key))
    assert act(params, batch, key).shape == (2, 4, 3)


def test_padded_actions_change_no_loss_of_the_paper():
    subject, batch = policy(replace(TINY)), make_batch(size=32)
    noisy = dict(batch, action=np.where(batch["is_pad"][..., None], 9.0, batch["action"]))
    loss, params = jit(lambda p, b: subject.loss(p, b, None)[0]), start(subject)
    assert float(loss(params, batch)) == pytest.approx(float(loss(params, noisy)), rel=1e-5)


def test_bfloat16_is_close_to_float32():
    config = replace(TINY, conditioning="none", twin_of="none")
    batch, params = make_batch(size=32), start(policy(config))
    losses = [
        float(jit(policy(replace(config, compute_dtype=d)).loss)(params, batch, None)[0])
        for d in ("float32", "bfloat16")
    ]
    assert losses[0] == pytest.approx(losses[1], rel=0.05)
    assert losses[0] != losses[1]


def test_tower_takes_patches_row_by_row():
    tower = Siglip(32, 8, 16, 1, 2, 16, rngs=nnx.Rngs(0), dtype=jnp.float32)
    image = np.zeros((1, 32, 32, 3), np.float32)
    plain = tower(image, remat=False)
    image[0, 8:16, 24:32] = 1  # The second row's last patch.
    assert np.abs(tower(image, remat=False) - plain).max(-1)[0].argmax() == 7


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tokens": (0,) * 49}, "has 49 tokens; SmolVLA takes 48"),
        ({"tokens": (8,)}, "Tokens must be 0 to 7"),
        ({"conditioning": "early"}, "no conditioning 'early', only none, token, late"),
        ({"image_size": 33}, "not a multiple of patch 8 times shuffle 4"),
        ({"heads": 4, "kv_heads": 3}, "heads of kv_heads"),
        ({"attention": "interleaved", "layers": 3}, "come in pairs, got 3"),
        ({"attention": "cross"}, "Unknown attention 'cross'"),
    ],
)
def test_settings_that_cannot_work(changes, message):
    with pytest.raises(ConfigError, match=message):
        replace(TINY, **changes)


@pytest.mark.parametrize(
    ("changes", "sizes", "message"),
    [
        ({"tokens": ()}, {}, "tokenizer.json"),
        ({}, {"width": 64}, "square images, got 32x64"),
        ({"state_width": 4}, {}, "has 5 numbers, SmolVLA takes 4"),
        ({"action_width": 2}, {}, "have 3 numbers, SmolVLA predicts 2"),
        ({"chunk": 5}, {}, "predicts 5 actions"),
        ({}, {"height": 96, "width": 96}, "ray-map of 3x3 cells does not fit 4x4"),
    ],
)
def test_sizes_that_do_not_fit(changes, sizes, message):
    with pytest.raises(ConfigError, match=message):
        make_policy(replace(TINY, **changes), replace(SPEC, **sizes), make_stats())


@pytest.fixture(scope="module")
def tokenizer(tmp_path_factory):
    """A tokenizer.json that knows the words of every task."""
    tokenizers = pytest.importorskip("tokenizers")
    words = sorted({word for task in names_of(TaskName) for word in make_task(task).prompt.split()})
    numbers = {word: i for i, word in enumerate(["[UNK]", "\n", *words])}
    made = tokenizers.Tokenizer(tokenizers.models.WordLevel(numbers, unk_token="[UNK]"))
    made.pre_tokenizer = tokenizers.pre_tokenizers.Sequence(
        [
            tokenizers.pre_tokenizers.Split(" ", "removed"),
            tokenizers.pre_tokenizers.Split("\n", "isolated"),
        ]
    )
    made.enable_padding(length=20)
    file = tmp_path_factory.mktemp("tokenizer") / "tokenizer.json"
    made.save(str(file))
    return made, str(file)


@pytest.mark.parametrize("task", names_of(TaskName))
def test_training_on_any_task_reads_that_tasks_prompt(tokenizer, task):
    made, file = tokenizer
    changes = ("tokens=()", f"tokenizer={file}", f"vocabulary={made.get_vocab_size()}")
    run = TrainConfig(task=task, policy="smolvla", preset="tiny", model=changes)
    settings = policy_of(source_of(run), resolve(run, accelerator=False)).config
    made.no_padding()
    assert settings.prompt == make_task(task).prompt
    assert settings.tokens == tuple(made.encode(settings.prompt + "\n").ids)
    assert 0 not in settings.tokens, "a word is unknown"


def test_prompt_of_the_user_counts_more_than_the_tasks(tokenizer):
    file = tokenizer[1]
    assert tokenize("Lift the cube", file) == tokenize("Lift the cube\n", file)
    config = with_prompt(SmolVlaConfig(tokenizer=file, prompt="Lift the cube"), "Move the can")
    assert config.tokens == tokenize("Lift the cube", file) != tokenize("Move the can", file)


def test_what_is_no_tokenizer_is_refused(tokenizer, tmp_path):
    with pytest.raises(ConfigError, match="is not a tokenizer"):
        tokenize("Lift", str(tmp_path / "none.json"))


def test_known_tokens_need_no_file():
    config = SmolVlaConfig(tokenizer="gone.json", tokens=(1, 2))
    assert with_prompt(config, "Lift the cube") is config
