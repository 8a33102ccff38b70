"""Prompts as the tokens that SmolVLA reads."""

import re
import zlib
from collections.abc import Sequence
from dataclasses import replace

from jaxcam.errors import ConfigError
from jaxcam.models.smolvla.config import HASHED_WORDS, SmolVlaConfig

NO_TOKENS = (
    "SmolVLA reads a prompt, and needs SmolVLM2's tokenizer for it. Download tokenizer.json of "
    "HuggingFaceTB/SmolVLM2-500M-Video-Instruct from huggingface.co, pip install 'jaxcam[smolvla]' "
    "and pass the file: --model tokenizer=path/to/tokenizer.json. --preset laptop needs none."
)


def tokenize(prompt: str, file: str) -> tuple[int, ...]:
    """A prompt's tokens, with the line break at its end that SmolVLA was trained with.

    Args:
        prompt: The words.
        file: A tokenizer.json.

    Raises:
        ConfigError: The library is missing, or the file is no tokenizer.
    """
    try:
        from tokenizers import Tokenizer  # here, since only the extra `smolvla` brings it
    except ImportError as error:
        raise ConfigError(
            "Reading a tokenizer needs the package tokenizers: pip install 'jaxcam[smolvla]'"
        ) from error
    try:
        tokenizer = Tokenizer.from_file(file)
    except Exception as error:  # The library raises plain exceptions, whatever is wrong.
        raise ConfigError(f"{file} is not a tokenizer.json: {error}. {NO_TOKENS}") from error
    tokenizer.no_padding()
    tokenizer.no_truncation()
    return tuple(tokenizer.encode(prompt.rstrip("\n") + "\n").ids)


def hashed_words(prompt: str, vocabulary: int) -> tuple[int, ...]:
    """A number for each word, which follows from its letters, and 0 at the end.

    There is no list of words to keep: a word has one number in every run, so that what was learned
    of it on one task can begin another, and a dataset may ask for things that no task here does.
    Two words have one number once in `vocabulary` times; no two of the tasks' prompts do.

    Args:
        prompt: The words; case and punctuation do not count.
        vocabulary: Numbers that there are.
    """
    words = re.findall(r"\w+", prompt.lower())
    return (*(1 + zlib.crc32(word.encode()) % (vocabulary - 1) for word in words), 0)


def with_prompts(config: SmolVlaConfig, prompts: Sequence[str]) -> SmolVlaConfig:
    """The settings with their prompts as tokens, if they name a tokenizer.

    Args:
        config: Settings. A prompt in them counts more than the other ones, tokens more than both.
        prompts: What is asked for, one thing or several.

    Raises:
        ConfigError: A prompt cannot be turned into tokens, see `tokenize`, or there are several and
            tokens of one.
    """
    if config.tokens and len(prompts) > 1 and not config.prompt:
        raise ConfigError(
            f"The dataset has {len(prompts)} instructions ({prompts[0]!r}, {prompts[1]!r} ...), "
            "and the settings, or their preset, have the tokens of one. Give a tokenizer instead, "
            "--model 'tokens=()' tokenizer=path/to/tokenizer.json; with --model prompt=... all are "
            "one."
        )
    if config.tokens or not config.tokenizer:
        return config
    first, *others = prompts = [config.prompt] if config.prompt else prompts
    if config.tokenizer == HASHED_WORDS:
        tokens, *more = (hashed_words(prompt, config.vocabulary) for prompt in prompts)
    else:
        tokens, *more = (tokenize(prompt, config.tokenizer) for prompt in prompts)
    return replace(
        config,
        prompt=first,
        tokens=tokens,
        other_prompts=tuple(others),
        other_tokens=tuple(more),
    )
