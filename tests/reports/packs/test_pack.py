"""Packs are written where nothing is lost, and read as they were written."""

import json
from dataclasses import replace

import pytest
from packs import foreign, ours, pack_of, resealed
from rights import no_rights
from running import exit_code

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.reports.packs.manifest import file_of_pack
from jaxcam.reports.packs.pack import read_pack


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_command_packs_runs_and_reports_on_the_pack(tmp_path, capsys):
    ours(tmp_path / "runs")
    pack = tmp_path / "pack"
    flags = ("--pack-name", "Ours <i>", "--authors", "We", "--link", "https://a.org")
    assert exit_code("report", tmp_path / "runs", "--pack", pack, *flags) == 0
    assert "act lift randomized late" in capsys.readouterr().out
    assert sorted(files(pack)) == ["pack.json", "rows.jsonl", "runs.json"]
    manifest = read_pack(pack).manifest
    assert (manifest.name, manifest.authors, manifest.link) == ("Ours <i>", "We", "https://a.org")
    before = files(pack)
    assert exit_code("report", pack, "--pack", pack, *flags) == 0  # the same again
    assert files(pack) == before
    assert exit_code("report", pack, "--out", tmp_path / "report") == 0
    assert "**" in (tmp_path / "report" / "report.md").read_text("utf-8")
    assert exit_code("report", pack, "--out", pack) == 2
    assert files(pack) == before


def test_a_pack_of_nothing_or_of_rows_without_pairs_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"no rollouts of test pairs to pack. Evaluate first"):
        pack_of(tmp_path / "a", [foreign(pairs=0)])
    run = foreign()
    old = replace(run, rows=[replace(row, pair_sha=None) for row in run.rows])
    with pytest.raises(
        ConfigError, match=r"have no digest of their pair.*Evaluate these runs anew"
    ):
        pack_of(tmp_path / "a", [old])
    assert not (tmp_path / "a").exists()


def test_a_pack_does_not_take_the_place_of_something_else(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ConfigError, match="is no folder"):
        pack_of(tmp_path / "file", [foreign()])
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.tex").write_text("mine")
    with pytest.raises(ConfigError, match=r"has 'thesis.tex' and is no pack.*another --pack"):
        pack_of(tmp_path / "folder", [foreign()])
    pack_of(tmp_path / "pack", [foreign()])
    before = files(tmp_path / "pack")
    with pytest.raises(ConfigError, match=r"would be lost.*another --pack"):
        pack_of(tmp_path / "pack", ours(tmp_path / "runs"))
    assert files(tmp_path / "pack") == before
    (tmp_path / "empty").mkdir()
    assert pack_of(tmp_path / "empty", [foreign()]).rollouts == 8


def test_a_place_without_rights_is_told(tmp_path, capsys):
    ours(tmp_path / "runs")
    (tmp_path / "shut").mkdir(mode=0o555)
    exit_code("report", tmp_path / "runs", "--pack", tmp_path / "warm")
    with no_rights():
        code = exit_code("report", tmp_path / "warm", "--pack", tmp_path / "shut" / "pack")
    assert code == 7
    assert "Permission denied" in capsys.readouterr().err


CHANGES = {
    "another pair": lambda line: line | {"pair_sha": "f" * 16},
    "no digest": lambda line: {k: v for k, v in line.items() if k != "pair_sha"},
    "another split": lambda line: line | {"split": "validation"},
    "one more pair": lambda line: line | {"pair": line["pair"] + 1},
}


@pytest.mark.parametrize("change", CHANGES)
def test_rows_of_other_pairs_than_the_manifest_says_are_refused(tmp_path, change):
    """Also where somebody has written digests and seal anew."""
    folder = pack_of(tmp_path / "pack", [foreign()]).folder
    path = folder / "rows.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    lines[-1] = CHANGES[change](lines[-1])
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    records = {
        name: vars(file_of_pack((folder / name).read_bytes()))
        for name in ("rows.jsonl", "runs.json")
    }
    resealed(folder / "pack.json", files=records)
    with pytest.raises(DatasetError, match=r"the rows are not of the pairs that pack.json lists"):
        read_pack(folder)


def test_numbers_that_are_none_are_refused(tmp_path):
    folder = pack_of(tmp_path / "pack", [foreign()]).folder
    path = folder / "rows.jsonl"
    path.write_text(path.read_text().replace('"azimuth_deg": 10.0', '"azimuth_deg": NaN'))
    records = {
        name: vars(file_of_pack((folder / name).read_bytes()))
        for name in ("rows.jsonl", "runs.json")
    }
    resealed(folder / "pack.json", files=records)
    with pytest.raises(DatasetError, match="line 2: azimuth_deg is nan, expected a finite number"):
        read_pack(folder)


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--authors", "me"], "--authors goes with --pack only"),
        (["--pack", "a", "--leaderboard", "b.html"], "not both"),
        (["--pack", "a", "--out", "b"], "leave it out"),
    ],
)
def test_flags_that_do_not_go_together(tmp_path, capsys, flags, words):
    assert exit_code("report", tmp_path, *flags) == 2
    assert words in " ".join(capsys.readouterr().err.replace("│", " ").split())
