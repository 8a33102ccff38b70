"""Reports of files that somebody else wrote, and folders that somebody else's files are in."""

import json
import shutil

import pytest
from places import REPO
from running import exit_code

from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError, DatasetError
from jaxcam.reports.comparison import write_comparison
from jaxcam.reports.packs.folder import write_results
from jaxcam.reports.reading import read_runs
from jaxcam.reports.run_page import write_report
from jaxcam.runs.identity import resolve

PUBLISHED = REPO / "results" / "push-randomized"


def foreign(folder, **changes):
    """A folder of rows alone, of two policies on eight pairs."""
    folder.mkdir(parents=True)
    said = {"task": "lift", "scene": "randomized", "policy": "act", "seed": 0, "step": 10}
    rows = [
        {**said, "conditioning": way, "run": way, "pair": pair, "success": pair < 4, "status": "ok",
         "azimuth_deg": 9.0 * pair, "elevation_deg": 40.0, **changes}
        for way in ("none", "late") for pair in range(8)
    ]  # fmt: skip
    (folder / "rows.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def test_a_name_does_not_leave_the_folder(tmp_path):
    odd = "/../../../x$\\frac{\x1b[31m<b>=1"
    out = tmp_path / "a" / "b" / "out"
    write_comparison(read_runs([foreign(tmp_path / "rows", task=odd)]), out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "rows"]
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b"]
    for name in ("report.md", "report.tex"):
        assert "\x1b" not in (out / name).read_text("utf-8")
    assert "<b>" not in (out / "report.html").read_text("utf-8")
    assert r"\frac" not in (out / "report.tex").read_text("utf-8")


def test_formulas_are_no_cells(tmp_path):
    write_comparison(read_runs([foreign(tmp_path / "rows", task="=1+1")]), tmp_path / "out")
    assert "\n'=1+1," in (tmp_path / "out" / "report.csv").read_text("utf-8")


ODD = [None, "", "x" * 400, "\n", "é|`]("]


@pytest.mark.parametrize("field", ["task", "scene", "policy", "conditioning", "run", "renderer"])
@pytest.mark.parametrize("value", ODD, ids=range(len(ODD)))
def test_any_name_can_be_reported(tmp_path, field, value):
    runs = read_runs([foreign(tmp_path / "rows", **{field: value})])
    assert write_comparison(runs, tmp_path / "out").is_file()


def test_markup_in_a_folders_name_is_a_name(tmp_path, capsys):
    rows = foreign(tmp_path / "rows")
    assert exit_code("report", rows, "--out", tmp_path / "out[" / "red]") == 0
    assert "out[/red]/report.html" in "".join(capsys.readouterr().out.split())


@pytest.fixture
def written(tmp_path):
    return shutil.copytree(PUBLISHED, tmp_path / "report")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"success": None}, "a second outcome"),
        ({"pair": 900, "weights_sha": "0" * 16}, "weights '0000000000000000', expected"),
    ],
)
def test_rows_that_were_put_into_a_report_are_refused(written, changes, message):
    file = written / "rows.jsonl"
    lines = [
        json.loads(line) | {"weights_sha": "1" * 16}
        for line in file.read_text("utf-8").splitlines()
    ]
    more = lines[3] | changes
    more["success"] = (not lines[3]["success"]) if more["success"] is None else more["success"]
    file.write_text("".join(json.dumps(line) + "\n" for line in [*lines, more]), "utf-8")
    with pytest.raises(DatasetError, match=rf"line {len(lines) + 1}: .*{message}"):
        read_runs([written])
    (written / "runs.json").unlink()
    lines = [line | {"run": "a"} for line in [*lines, more]]
    file.write_text("".join(json.dumps(line) + "\n" for line in lines), "utf-8")
    with pytest.raises(DatasetError, match="not of the run of those before it"):
        read_runs([written])


def content(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


def test_a_report_of_nothing_leaves_what_is_there(written):
    before = content(written)
    assert exit_code("report", "--out", written) == 2
    assert content(written) == before


def test_a_report_of_other_runs_does_not_replace_rows(written, tmp_path):
    before = content(written)
    other = read_runs([foreign(tmp_path / "rows")])
    with pytest.raises(ConfigError, match="rollouts of 2 runs that would be lost, such as push"):
        write_comparison(other, written)
    with pytest.raises(ConfigError, match="would be lost"):
        write_comparison(read_runs([written], "validation"), written, "validation")
    assert content(written) == before
    write_comparison([*read_runs([written]), *other], written)
    assert len(json.loads((written / "runs.json").read_text())) == 4


def test_a_report_does_not_replace_what_it_did_not_write(tmp_path):
    rows = foreign(tmp_path / "rows")
    before = content(rows)
    with pytest.raises(ConfigError, match="was not written by this command"):
        write_comparison(read_runs([rows]), rows)
    assert content(rows) == before
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text("{}")
    with pytest.raises(ConfigError, match="is the folder of a run"):
        write_comparison(read_runs([rows]), tmp_path / "run")


def test_a_folder_with_links_to_itself_is_read_once(tmp_path):
    foreign(tmp_path / "all" / "rows")
    for name in ("one", "two"):
        (tmp_path / "all" / name).symlink_to(tmp_path / "all", target_is_directory=True)
    assert len(read_runs([tmp_path / "all"])) == 2


@pytest.mark.parametrize("text", ["", "{", "[]", "7", "null", "{}", "[" * 10**5, "\\xff"])
def test_a_record_of_weights_that_is_damaged_is_told(tmp_path, text):
    config = resolve(TrainConfig(weights="resnet18.pth"), accelerator=False)
    (tmp_path / "config.json").write_text(to_json(config))
    (tmp_path / "weights.json").write_text(text)
    with pytest.raises(ConfigError, match=r"weights.json is damaged"):
        read_runs([tmp_path])
    (tmp_path / "weights.json").write_text('{"kind": null, "sha256": "123456789"}')
    assert read_runs([tmp_path])[0].settings["weights"] == "resnet18 12345678"


def test_a_page_shows_no_files_from_elsewhere(tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(b"my secret")
    run = tmp_path / "run"
    for name in ("plots", "videos"):
        (run / name).mkdir(parents=True)
    (run / "config.json").write_text(to_json(resolve(TrainConfig(), accelerator=False)))
    for name in ("plots/loss.png", "env.txt", "videos/a.mp4"):
        (run / name).symlink_to(secret)
    page = write_report(run).read_text("utf-8")
    assert "my secret" not in page
    assert "bXkgc2VjcmV0" not in page  # in base64
    assert "a.mp4" not in page


def test_a_report_that_was_cut_short_is_written_by_the_same_command(tmp_path, monkeypatch):
    runs, out = read_runs([foreign(tmp_path / "rows")]), tmp_path / "out"

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("jaxcam.reports.comparison.to_markdown", killed)
        with pytest.raises(KeyboardInterrupt):
            write_comparison(runs, out)
    assert (out / "figures").is_dir()
    assert "has not finished" in (out / "report.html").read_text("utf-8")
    assert exit_code("report", tmp_path / "rows", "--out", out) == 0
    assert "has not finished" not in (out / "report.html").read_text("utf-8")


def test_rows_and_runs_of_a_report_change_together(written, monkeypatch):
    before = content(written)

    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("jaxcam.files.whole.os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_results(written, read_runs([written]))
    assert content(written).items() >= before.items()


def test_a_report_among_runs_does_not_hide_them(tmp_path):
    foreign(tmp_path / "all" / "one", task="push")
    write_comparison(read_runs([tmp_path / "all"]), tmp_path / "all")
    foreign(tmp_path / "all" / "two")
    tasks = sorted(run.settings["task"] for run in read_runs([tmp_path / "all"]))
    assert tasks == ["lift", "lift", "push", "push"]
