"""Reports of many runs are whole, and nothing is hidden."""

import csv
import json
import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from made_runs import arms_of, make_run, make_studies
from places import REPO
from running import exit_code
from web_page import Page

from jaxcam.config.commands import ReportConfig
from jaxcam.console.terminal import Terminal
from jaxcam.errors import ConfigError
from jaxcam.reports.arms import group
from jaxcam.reports.comparison import main as comparison_main
from jaxcam.reports.comparison import write_comparison
from jaxcam.reports.reading import read_runs
from jaxcam.reports.tables import gains_table, table_one
from jaxcam.results.actions import ActionErrors
from jaxcam.runs.action_errors import errors_file


def test_a_report_is_whole(runs, tmp_path):
    (runs / "late" / "videos").mkdir()
    (runs / "late" / "videos" / "failures-test-004000.mp4").write_bytes(b"film")
    out = tmp_path / "out"
    page = Page(write_comparison(read_runs([runs]), out))
    text = " ".join(page.text.split())
    sources = page.attributes("img", "src")
    assert len(sources) == 2  # gains and map
    assert all(src.startswith("data:image/png;base64,") for src in sources)
    (link,) = page.attributes("a", "href")
    assert (out / link).read_bytes() == b"film"
    assert not re.search(r"https?://|<script", (out / "report.html").read_text())
    assert "2 of 2 settings have fewer rollouts than the protocol asks for" in text
    assert "1 of 10 checkpoints; 1 of 3 seeds; 8 of 50 pairs" in text
    markdown = (out / "report.md").read_text()
    for path in re.findall(r"!\[.*?\]\((.*?)\)", markdown):
        assert (out / path).stat().st_size > 1000
    for file in ("report.md", "report.tex", "report.html"):
        assert (out / file).read_text().count("n = 8 of 1500") == 2
    with open(out / "report.csv") as file:
        none, late = sorted(csv.DictReader(file), key=lambda r: r["conditioning"] != "none")
    assert (float(none["success"]), float(none["paper"]), none["gain"]) == (0.25, 0.336, "")
    assert (late["gain"], late["gain_pairs"], late["rollouts"]) == ("0.5000", "8", "8")
    assert (late["gain_over"], none["gain_over"]) == ("its twin", "")
    assert late["lacks"] == "1 of 3 seeds; 1 of 10 checkpoints; 8 of 50 pairs"


def test_a_report_can_be_read_again_and_counts_nothing_twice(runs, tmp_path):
    out = tmp_path / "out"
    first = read_runs([runs])
    write_comparison(first, out)
    for again in (read_runs([out]), read_runs([tmp_path]), read_runs([out, runs, runs])):
        assert [a.estimate for a in group(again)] == [a.estimate for a in group(first)]
        assert [a.label() for a in group(again)] == [a.label() for a in group(first)]
        assert [r.seconds for r in again] == [3600, 3600]


def test_rows_alone_are_shown_as_far_as_they_tell(runs, tmp_path):
    folder = tmp_path / "old"
    folder.mkdir()
    rows = [json.loads(line) for way in ("none", "late")
            for line in (runs / way / "eval" / "rows.jsonl").read_text().splitlines()]  # fmt: skip
    kept = ("task", "scene", "policy", "conditioning", "seed", "step", "split", "pair", "success",
            "status")  # fmt: skip
    lines = (json.dumps({k: row[k] for k in kept}) + "\n" for row in rows)
    (folder / "rows.jsonl").write_text("".join(lines))
    arms = arms_of(folder)
    assert {arm.label() for arm in arms} == {"settings not recorded"}
    (gain,) = gains_table(arms).rows
    assert gain[4] == "image only, not known to be its twin"
    assert gain[6].startswith("+50.0")
    assert not any("(+50.0)" in cell for row in table_one(arms).rows for cell in row)
    write_comparison(read_runs([folder]), tmp_path / "out")


def test_rollouts_that_did_not_finish_are_told(tmp_path):
    lost = {"task": "lift", "scene": "randomized", "policy": "act", "conditioning": "keypoints",
            "seed": 0, "run": "a", "step": 4000, "split": "test", "pair": 8, "success": None,
            "status": "error", "engine": "native", "width": 50}  # fmt: skip
    make_run(tmp_path / "a", rows=[lost])
    write_comparison(read_runs([tmp_path]), tmp_path / "out")
    assert "did not finish and count in no rate: 1." in (tmp_path / "out" / "report.md").read_text()


def test_a_report_draws_the_figures_that_there_are_runs_for(tmp_path):
    make_studies(tmp_path)
    write_comparison(read_runs([tmp_path]), tmp_path / "out")
    made = {p.name for p in (tmp_path / "out" / "figures").iterdir()}
    assert {"fixed_randomized.png", "encodings.png", "cameras.png", "gains.png"} <= made


def test_nothing_evaluated_yet(tmp_path):
    folder = make_run(tmp_path / "a", pairs=1)
    (folder / "eval" / "rows.jsonl").unlink()
    (arm,) = arms_of(tmp_path)
    assert math.isnan(arm.estimate.value)
    assert arm.lacks == ["not evaluated"]
    text = Page(write_comparison(read_runs([tmp_path]), tmp_path / "out")).text
    assert "Runs: 1" in text


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs Chromium")
def test_the_page_has_no_console_errors(runs, tmp_path):
    page = write_comparison(read_runs([runs]), tmp_path / "out")
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
             f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom"]  # fmt: skip
    done = subprocess.run(["chromium", *flags, page.as_uri()], capture_output=True, text=True,
                          check=True, timeout=120)  # fmt: skip
    assert "Table I of the paper" in done.stdout
    assert "CONSOLE" not in done.stderr


def test_nothing_is_written_over_what_is_not_a_report_or_by_an_empty_one(tmp_path, capsys):
    results, other = tmp_path / "results", tmp_path / "other"
    shutil.copytree(REPO / "results" / "lift", results)
    other.mkdir()
    (other / "runs.json").write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert exit_code("report", results, "--out", other) == 2
    assert exit_code("report", "--out", results) == 2  # no runs: not an empty report
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_runs_on_recorded_data_show_errors_of_their_actions(runs, tmp_path, capsys):
    folder = make_run(tmp_path / "cups", pairs=0, task="recorded", dataset="cups")
    rows = [
        ActionErrors(step, "new cameras", 5, 0.05, ("x",), np.ones(1), np.full((2, 1, 1), error))
        for step, error in ((1, 0.9), (2, 0.4))
    ]
    lines = "".join(json.dumps(row.to_json()) + "\n" for row in rows)
    errors_file(folder).write_text(lines)
    comparison_main(ReportConfig((str(runs), str(folder)), out=str(tmp_path / "out")), Terminal())
    assert "errors of its actions are in the report" in capsys.readouterr().out
    text = (tmp_path / "out" / "report.md").read_text()
    assert "| cups | new cameras | 5°, 5 cm off | 0.40 [0.40, 0.40] | 2 |" in text
    assert "0.90" not in text


def test_an_image_only_run_of_another_network_is_no_twin(tmp_path):
    make_run(tmp_path / "none", rate=0.25, conditioning="none")  # the twin of keypoints
    make_run(tmp_path / "late", rate=0.75, conditioning="late")
    write_comparison(read_runs([tmp_path]), tmp_path / "out")
    text = (tmp_path / "out" / "report.md").read_text()
    assert "+50.0" not in text
    assert "another network (twin of keypoints)" in text
    assert "--conditioning none --model twin_of=late" in text
    assert not (tmp_path / "out" / "figures" / "gains.png").exists()


def test_memory_stands_beside_generalisation_and_in_no_number_with_it(tmp_path):
    """Success on cameras that training saw, of an arm and of its twin."""
    folder, out = tmp_path / "runs", tmp_path / "out"
    twin = {"conditioning": "none", "model": ("twin_of=late",)}
    for name, held_out, known, settings in (
        ("none", 0.25, 0.5, twin), ("late", 0.5, 1.0, {"conditioning": "late"})
    ):  # fmt: skip
        made = make_run(folder / name, rate=known, split="train", **settings)
        rows = made / "eval" / "rows.jsonl"
        seen_rows = rows.read_text()
        shutil.rmtree(made)
        make_run(made, rate=held_out, **settings)
        rows.write_text(rows.read_text() + seen_rows)
    assert exit_code("report", folder, "--out", out) == 0
    text = (out / "report.md").read_text()
    (line,) = [row for row in text.splitlines() if "| late |" in row and "100.0 [" in row]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[4].startswith("100.0 [")
    assert cells[6].startswith("50.0 [")
    assert cells[8].startswith("-50.0 [")
    assert cells[9].startswith("+50.0 [")
    gains = [row for row in text.splitlines() if "| its twin |" in row]
    assert gains
    assert not any("100.0" in row for row in gains)
    assert all("| 8 |" in row for row in gains)  # pairs, of held-out cameras alone
    # The report keeps both, and says the same when it is read again.
    assert exit_code("report", out, "--out", tmp_path / "again") == 0
    assert (tmp_path / "again" / "report.md").read_text() == text
    with pytest.raises(ConfigError, match="would be lost"):
        write_comparison(read_runs([folder]), out)
