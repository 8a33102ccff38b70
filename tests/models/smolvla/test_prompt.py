"""Prompts: from words to tokens."""

from dataclasses import replace

import pytest

from jaxcam.config.names import TaskName, names_of
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.models.smolvla.config import SMOLVLA_PRESETS, SmolVlaConfig
from jaxcam.models.smolvla.prompt import hashed_words, tokenize, with_prompts
from jaxcam.pipeline.sources import source_of
from jaxcam.pipeline.train import policy_of
from jaxcam.runs.identity import resolve
from jaxcam.sim import make_task


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
    config = with_prompts(
        SmolVlaConfig(tokenizer=file, prompt="Lift the cube"), ("Move the can", "Roll")
    )
    assert config.tokens == tokenize("Lift the cube", file) != tokenize("Move the can", file)


def test_what_is_no_tokenizer_is_refused(tokenizer, tmp_path):
    with pytest.raises(ConfigError, match="is not a tokenizer"):
        tokenize("Lift", str(tmp_path / "none.json"))


def test_known_tokens_need_no_file():
    config = SmolVlaConfig(tokenizer="gone.json", tokens=(1, 2))
    assert with_prompts(config, ("Lift the cube",)) is config


def test_several_prompts_are_told_by_number(tokenizer):
    file = tokenizer[1]
    prompts = ("Lift the cube", "Roll the ball to the target")
    config = with_prompts(SmolVlaConfig(tokenizer=file), prompts)
    assert (config.prompt, config.other_prompts) == (prompts[0], prompts[1:])
    assert (config.tokens, *config.other_tokens) == tuple(tokenize(p, file) for p in prompts)
    one = with_prompts(SmolVlaConfig(tokenizer=file, prompt="Move the can"), prompts)
    assert (one.prompt, one.other_prompts, one.other_tokens) == ("Move the can", (), ())


def test_words_without_a_file_have_numbers_of_their_own():
    """Of all tasks' prompts no two words share one, and every run gives a word the same."""
    config = SMOLVLA_PRESETS["laptop"]
    prompts = [make_task(task).prompt for task in names_of(TaskName)]
    words = {word for prompt in prompts for word in prompt.lower().split()}
    numbers = {word: hashed_words(word, config.vocabulary) for word in words}
    assert len({*numbers.values()}) == len(words)
    assert all(len(n) == 2 and 0 < n[0] < config.vocabulary and n[1] == 0 for n in numbers.values())
    several = with_prompts(config, prompts)
    assert (several.prompt, *several.other_prompts) == tuple(prompts)
    lift, push = (prompts.index(p) for p in ("Lift the cube", "Push the cube to the target"))
    tokens = (several.tokens, *several.other_tokens)
    assert tokens[lift][1:3] == tokens[push][1:3]  # "the cube"
    assert tokens[lift] == hashed_words("LIFT, the  cube!\n", config.vocabulary)
    assert with_prompts(config, ["Lift the cube"]).tokens == tokens[lift]


def test_tokens_of_one_prompt_do_for_several_only_where_all_are_one():
    prompts = ("Lift the cube", "Roll the ball to the target")
    with pytest.raises(ConfigError, match=r"2 instructions .*'tokens=\(\)"):
        with_prompts(SMOLVLA_PRESETS["tiny"], prompts)
    one = replace(SMOLVLA_PRESETS["tiny"], prompt="Lift the cube")
    assert with_prompts(one, prompts) is one
