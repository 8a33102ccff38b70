"""Every block of code in README and docs: Python runs, commands parse, data loads.

Where one cannot, `<!-- not run: why -->` stands above it.
"""

import json
import re
import shlex
import tomllib

import pytest
import yaml
from pages import PAGES, blocks_of
from places import REPO

from jaxcam.__main__ import command
from jaxcam.config.flags import parse

BLOCKS = [block for page in PAGES for block in blocks_of(page)]
TO_READ = {"text", "mermaid", "toml", "diff"}
"""Languages in which nothing is to be run."""
OTHERS = {
    "cd", "git", "lint-imports", "mkdocs", "pre-commit", "pyright", "pytest", "ruff", ".ci/run",
}  # fmt: skip
"""Programs whose words are not looked at."""
EXTRAS = tomllib.loads((REPO / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def run_here(language):
    """Blocks of a language that are run."""
    return [b for b in BLOCKS if b.language == language and not b.reason]


def test_every_block_says_what_it_is():
    known = {"python", "bash", "json", "yaml"} | TO_READ
    assert [str(block) for block in BLOCKS if block.language not in known] == []
    assert len(BLOCKS) > 60
    assert {b.language for b in BLOCKS if b.reason} <= {"python", "bash"}


PAGES_WITH_PYTHON = sorted({block.page for block in run_here("python")})


@pytest.mark.parametrize("page", PAGES_WITH_PYTHON, ids=lambda page: page.stem)
def test_python_runs(page, demos, tmp_path, monkeypatch):
    """The blocks of a page one after the other, as a reader would type them."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data/lift-randomized-n3m1-200+10-seed0.hdf5").symlink_to(demos.path)
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in run_here("python"):
        if block.page == page:
            exec(compile("\n" * (block.line - 1) + block.text, page, "exec"), names)
    assert len(names) > 1  # `__builtins__` is there always


def commands(text):
    """The commands of a shell's lines, each as its words."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.shlex(line, posix=True, punctuation_chars="&|;")
        words.whitespace_split = True
        one = []
        for word in [*words, ";"]:
            if not set(word) <= set("&|;"):
                one.append(word)
            elif one:
                yield one
                one = []


def without_launcher(words):
    """A command without what starts it: variables, and Slurm."""
    while words and (re.fullmatch(r"[A-Z_]+=.*", words[0]) or words[0] in ("srun", "--ntasks=4")):
        words = words[1:]
    return words


def check_extras(words):
    """The extras that `pip install` names are there."""
    for word in words:
        for extra in ",".join(re.findall(r"^\.\[(.*)\]$", word)).split(","):
            assert not extra or extra in EXTRAS, word


@pytest.mark.parametrize("block", run_here("bash"), ids=str)
def test_a_command_is_understood(block):
    """Settings of ours are made of its flags; of other programs the files are there."""
    for words in commands(block.text):
        match without_launcher(words):
            case ["python", "-m", name, *rest] if name.startswith("jaxcam."):
                understood(name.removeprefix("jaxcam."), rest)
            case ["jaxcam", name, *rest]:
                understood(name, rest)
            case ["python", script, *_] if script.endswith(".py"):
                assert (REPO / script).is_file(), script
            case ["pip", "install", *rest]:
                check_extras(rest)
            case [program, *_]:
                assert program in OTHERS, words


def understood(name, words):
    """Makes a command's settings; `SystemExit` if there is no such flag or value."""
    kind = command(name)[0].settings
    if "--help" not in words:
        assert parse(kind, [word for word in words if word != "..."]) is not None


@pytest.mark.parametrize("block", [*run_here("json"), *run_here("yaml")], ids=str)
def test_data_loads(block):
    read = json.loads if block.language == "json" else yaml.safe_load
    assert isinstance(read(block.text), dict)
