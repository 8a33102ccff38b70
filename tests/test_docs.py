"""What README and docs name exists: files, modules, links, and each package with its sentence."""

import ast
import re
from urllib.parse import urlsplit

import pytest
from pages import PAGES, blocks_of
from places import REPO

from jaxcam.config.names import TaskName, names_of
from jaxcam.envs import env_id

PATH = re.compile(r"(?:jaxcam|tests|benchmarks|examples|grids|constraints|\.ci)/[\w./-]*\w")
MODULE = re.compile(r"(?:from |import |python -m )(jaxcam(?:\.[a-z_]\w*)*)")
ENVIRONMENTS = {env_id(task) for task in names_of(TaskName)}
"""Gymnasium's names, which look like paths."""
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")
REPORTS = sorted((REPO / "results").glob("*/report.md"))
OUTWARD = re.compile(r"https?:[^\s<>)\]`\"']*")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_names_exists(page):
    text = page.read_text(encoding="utf-8")
    # A recipe's new files are in its blocks.
    heads = (b.text.partition("\n")[0] for b in blocks_of(page) if b.language == "python")
    made = {head.removeprefix("# ") for head in heads}
    modules = {name.replace(".", "/") for name in MODULE.findall(text)}
    missing = {
        name
        for name in modules
        if not ((REPO / name).is_dir() or (REPO / f"{name}.py").exists() or f"{name}.py" in made)
    }
    paths = set(PATH.findall(text)) - ENVIRONMENTS - made
    missing |= {name for name in paths if not (REPO / name).exists()}
    missing |= {name for name in LINK.findall(text) if not (page.parent / name).exists()}
    assert missing == set()


@pytest.mark.parametrize("page", REPORTS, ids=lambda page: page.parent.name)
def test_a_report_that_is_kept_links_to_what_is_kept(page):
    """Not to videos in a folder of runs that was on one machine."""
    links = LINK.findall(page.read_text(encoding="utf-8"))
    assert [name for name in links if not (page.parent / name).exists()] == []


def test_the_readme_is_read_to_its_end():
    assert len((REPO / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_addresses_are_addresses(page):
    """By their form: nothing is asked of the network."""
    for address in OUTWARD.findall(page.read_text(encoding="utf-8")):
        url = urlsplit(address)
        assert re.fullmatch(r"(localhost|127\.0\.0\.1|[\w-]+(\.[\w-]+)+)(:\d+)?", url.netloc), (
            address
        )


def test_the_architecture_names_each_package_with_its_sentence():
    page = (REPO / "docs/architecture.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| `([\w/]+)` \| (.+?) \|", page, re.MULTILINE))
    packages = {}
    for path in sorted((REPO / "jaxcam").rglob("*/__init__.py")):
        sentence = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        name = path.parent.relative_to(REPO / "jaxcam").as_posix()
        packages[name] = sentence.partition("\n")[0]
    assert listed == packages
