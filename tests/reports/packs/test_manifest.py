"""`pack.json` is what was written, or refused with a word that says what to do."""

import json
import os
import random

import pytest
from odd_files import COUNT, ODD, flipped, odd_texts, places, replaced
from packs import foreign, pack_of, resealed

from jaxcam.errors import ConfigError, DatasetError, JaxcamError
from jaxcam.reports.packs.manifest import PackLabel, read_manifest_of
from jaxcam.runs.manifests import seal, without_seal


@pytest.fixture
def folder(tmp_path):
    return pack_of(
        tmp_path / "pack", [foreign()], authors="A. Person", link="https://a.org/x?y=1"
    ).folder


def test_a_manifest_says_whose_it_is_of_what_and_by_what(folder):
    manifest = read_manifest_of(folder)
    assert (manifest.name, manifest.authors, manifest.split) == ("pack", "A. Person", "test")
    assert {"jaxcam", "jax", "mujoco", "robosuite"} <= manifest.versions.keys()
    (pairs,) = manifest.pairs
    assert (pairs.task, pairs.scene, pairs.views) == ("lift", "randomized", 1)
    assert pairs.digests == {str(p): f"{p:016x}" for p in range(8)}
    assert manifest.digest == json.loads((folder / "pack.json").read_text())["sha256"]


@pytest.mark.parametrize("name", ["rows.jsonl", "runs.json"])
def test_files_that_were_changed_or_are_gone_are_named(folder, name):
    path = folder / name
    content = path.read_bytes()
    path.write_bytes(content[:-1] + b" ")
    with pytest.raises(DatasetError, match=rf"{name} is not the file that was packed.*--pack"):
        read_manifest_of(folder)
    path.unlink()
    with pytest.raises(DatasetError, match=f"has no {name}, so it is no whole pack"):
        read_manifest_of(folder)
    path.symlink_to("/etc/passwd")
    with pytest.raises(DatasetError, match=f"{name} is a link"):
        read_manifest_of(folder)


@pytest.mark.parametrize("name", ["rows.jsonl", "runs.json", "pack.json"])
def test_giants_and_pipes_are_not_read(folder, name):
    os.truncate(folder / name, 1 << 40)
    with pytest.raises(DatasetError, match=f"{name} has 1099512 MB, but at most"):
        read_manifest_of(folder)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(DatasetError, match=f"has no {name}"):
        read_manifest_of(folder)


@pytest.mark.parametrize("number", [2, 10**400])
def test_a_newer_format_asks_for_a_newer_jaxcam(folder, number):
    resealed(folder / "pack.json", format=number, more="things")
    with pytest.raises(ConfigError, match=r"a newer jaxcam wrote; this one reads 1. Update jaxcam"):
        read_manifest_of(folder)


@pytest.mark.parametrize("number", [0, True, "1", None, 1.0])
def test_a_format_that_is_none_is_refused(folder, number):
    resealed(folder / "pack.json", format=number)
    with pytest.raises(DatasetError, match=r"format is .*, expected 1"):
        read_manifest_of(folder)


OTHERS = {
    "files": {"../rows.jsonl": {"size": 1, "sha256": ""}, "runs.json": {"size": 1, "sha256": ""}},
    "pairs": [{"task": "a", "scene": "b", "views": 1, "digests": {"0": "x"}}],
    "link": "javascript:alert(1)",
    "name": "two\nlines",
    "authors": "x" * 401,
    "split": "training",
    "versions": ["jaxcam"],
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_values_are_refused_under_a_right_seal(folder, name):
    resealed(folder / "pack.json", **{name: OTHERS[name]})
    with pytest.raises(DatasetError, match=r"pack.json is not what jaxcam writes: .*--pack"):
        read_manifest_of(folder)


def test_a_manifest_is_refused_or_equal(folder):
    path, healthy = folder / "pack.json", read_manifest_of(folder)
    content, refused = path.read_bytes(), 0
    texts = [text.encode("utf-8", "surrogatepass") for text in odd_texts([json.loads(content)])]
    for damaged in [*texts, *flipped(content)]:
        path.write_bytes(damaged)
        try:
            assert read_manifest_of(folder) == healthy
        except JaxcamError as error:
            refused += 1
            str(error).encode()
    assert refused > COUNT


def test_odd_values_under_a_right_seal_are_refused_or_read(folder):
    path = folder / "pack.json"
    manifest = without_seal(json.loads(path.read_text()))
    drawn, refused = random.Random(2), 0
    for _ in range(COUNT):
        place = drawn.choice([p for p in places(manifest) if p])
        path.write_text(json.dumps(seal(replaced(manifest, place, drawn.choice(ODD)))))
        try:
            read_manifest_of(folder)
        except JaxcamError:
            refused += 1
    assert refused > COUNT / 2


@pytest.mark.parametrize(
    "link", ["javascript:alert(1)", "https://", "ftp://a.org", 'https://a.org/"x y']
)
def test_a_link_leads_to_a_page(link):
    with pytest.raises(ConfigError, match="The link of a pack is one such as"):
        PackLabel("a", link=link)


def test_a_pack_has_a_name():
    with pytest.raises(ConfigError, match="--pack-name"):
        PackLabel(" ")
