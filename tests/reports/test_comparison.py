"""Reports of many runs: what is compared with what, what counts, and that nothing is hidden."""

import csv
import json
import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib.colors import to_hex
from places import REPO
from running import exit_code
from web_page import Page

from jaxcam.config.fields import to_json
from jaxcam.config.train import TrainConfig
from jaxcam.errors import ConfigError
from jaxcam.reports import paper
from jaxcam.reports.arms import group, read_runs
from jaxcam.reports.comparison import write_comparison
from jaxcam.reports.document import (
    Document,
    Heading,
    Link,
    Table,
    Text,
    to_html,
    to_latex,
    to_markdown,
)
from jaxcam.reports.studies import STUDIES, panels
from jaxcam.reports.study_figures import COLOURS, bars, curves
from jaxcam.reports.tables import gains_table, paper_value, table_one
from jaxcam.results.differences import paired_difference
from jaxcam.runs.identity import resolve

BY_FIELD = {study.field: study for study in STUDIES}


def make_run(folder, *, rate=0.5, checkpoints=1, pairs=8, split="test", rows=(), **settings):
    """The folder of a finished run with pairs that succeed up to the rate."""
    config = resolve(TrainConfig(**{"preset": "laptop", **settings}), accelerator=False)
    named = {k: getattr(config, k) for k in ("task", "scene", "policy", "conditioning", "seed")}
    angles = np.random.default_rng(0).uniform((-90, 30), (90, 60), (pairs, 2))
    written = [
        {
            **named,
            "run": folder.name,
            "step": config.steps - k * config.save_every,
            "split": split,
            "pair": p,
            "pair_sha": f"{p:016x}",
            "success": p < rate * pairs,
            "status": "ok",
            "steps": 70,
            "azimuth_deg": angles[p, 0],
            "elevation_deg": angles[p, 1],
            "distance": 1.0,
            "engine": "native",
            "width": 50,
        }
        for k in range(checkpoints)
        for p in range(pairs)
    ]
    (folder / "eval").mkdir(parents=True)
    (folder / "config.json").write_text(to_json(config))
    (folder / "metrics.jsonl").write_text(
        json.dumps({"step": config.steps, "seconds": 3600}) + "\n"
    )
    lines = "".join(json.dumps(row) + "\n" for row in [*written, *rows])
    (folder / "eval" / "rows.jsonl").write_text(lines)
    return folder


@pytest.fixture
def runs(tmp_path):
    """Image-only and late fusion on Lift, a seed each; a folder of runs."""
    folder = tmp_path / "runs"
    for way, rate in (("none", 0.25), ("late", 0.75)):
        make_run(folder / way, rate=rate, conditioning=way)
    return folder


def arms_of(folder):
    return group(read_runs([folder]))


def test_table_one_has_the_papers_numbers_beside_ours(runs):
    table = table_one(arms_of(runs))
    assert list(table.head[2:]) == list(paper.TASKS.values())
    assert table.rows[0] == ["ACT", "paper", "33.6", "26.7", "10.8", "29.9", "22.9", "28.7"]
    ours, theirs, conditioned = table.rows[1:4]
    assert ours[1] == "ours\nlaptop preset"
    assert re.fullmatch(r"25\.0\n\[\d+\.\d, \d+\.\d\]\nn = 8 of 1500", ours[2])
    assert ours[3:] == ["–"] * 5
    assert theirs[:3] == ["ACT\nw. conditioning", "paper", "60.6 (+27.0)"]
    assert conditioned[1] == "ours\nlate\nlaptop preset"
    assert conditioned[2].startswith("75.0 (+50.0)\n[")
    gain = [paper.success(p, t, True) - paper.success(p, t, False) for p in paper.POLICIES
            for t in paper.TASKS]  # fmt: skip
    assert min(gain) == pytest.approx(0.4)  # "increases success rates for all models in all tasks"
    assert max(gain) == pytest.approx(34.8)


def test_runs_whose_demonstrations_see_all_cameras_are_no_line_of_table_one(runs):
    make_run(runs / "all", rate=0.5, conditioning="late", n=30, m=0)
    arms = arms_of(runs)
    assert len(arms) == 3
    table = table_one(arms)
    assert sum("ours" in row[1] for row in table.rows) == 2
    assert not any(row[2].startswith("50.0") for row in table.rows)
    (arm,) = [arm for arm in arms if arm.settings["m"] == 0]
    assert paper_value(arm) is None


def test_gains_are_paired(runs):
    none, late = sorted(arms_of(runs), key=lambda a: a.settings["conditioning"] != "none")
    (row,) = gains_table([late, none]).rows
    delta = paired_difference(late.rows, none.rows)
    assert row[:5] == ["ACT", "Lift", "late", "laptop preset", "+27.0"]
    assert row[5].startswith(f"{100 * delta.value:+.1f} [")
    assert row[6:] == [f"= {delta.p_value:.3f}", "8", "8, 8"]


def test_arms_are_compared_only_where_nothing_else_differs(tmp_path):
    make_run(tmp_path / "a", conditioning="none")
    make_run(tmp_path / "b", conditioning="late", steps=2000)
    arms = arms_of(tmp_path)
    assert len(arms) == 2
    assert gains_table(arms) is None
    assert {arm.label() for arm in arms} == {"laptop preset", "laptop preset, steps 2000"}
    assert all("+" not in row[2] for row in table_one(arms).rows if "ours" in row[1])


def test_a_whole_protocol_counts_and_anything_less_is_told(tmp_path):
    for seed in range(3):
        make_run(tmp_path / f"w{seed}", seed=seed, checkpoints=10, pairs=50, save_every=100)
        make_run(tmp_path / f"l{seed}", seed=seed, checkpoints=9 + (seed > 0), pairs=50,
                 save_every=100, conditioning="late")  # fmt: skip
    whole, less = arms_of(tmp_path)[::-1]
    assert (whole.lacks, whole.count(), whole.estimate.n) == ([], "1500", 1500)
    assert (less.lacks, less.count()) == (["9 of 10 checkpoints"], "1450 of 1500")
    assert whole.estimate.clusters == 50


def test_the_newest_checkpoints_count_with_the_protocols_pairs(tmp_path):
    make_run(tmp_path / "a", checkpoints=12, pairs=60, save_every=100)
    (arm,) = arms_of(tmp_path)
    assert sorted({row.step for row in arm.rows}) == [*range(3100, 4001, 100)]
    assert max(row.pair for row in arm.rows) == 49


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
    assert gains_table(arms).rows[0][5].startswith("+50.0")
    write_comparison(read_runs([folder]), tmp_path / "out")


def test_runs_that_cannot_be_compared_are_refused(runs, tmp_path):
    with pytest.raises(ConfigError, match="No run in"):
        read_runs([tmp_path / "nothing"])
    make_run(tmp_path / "other" / "late", rate=0.5, conditioning="late")
    with pytest.raises(ConfigError, match="same settings and the same seed"):
        read_runs([runs, tmp_path / "other"])
    make_run(tmp_path / "new" / "late", conditioning="late", seed=1)
    file = tmp_path / "new" / "late" / "eval" / "rows.jsonl"
    file.write_text(file.read_text().replace('"pair_sha": "00', '"pair_sha": "0f'))
    with pytest.raises(ConfigError, match="different pairs of the same number"):
        read_runs([runs, tmp_path / "new"])


def test_rollouts_that_did_not_finish_are_told(tmp_path):
    lost = {"task": "lift", "scene": "randomized", "policy": "act", "conditioning": "keypoints",
            "seed": 0, "run": "a", "step": 4000, "split": "test", "pair": 8, "success": None,
            "status": "error", "engine": "native", "width": 50}  # fmt: skip
    make_run(tmp_path / "a", rows=[lost])
    write_comparison(read_runs([tmp_path]), tmp_path / "out")
    assert "did not finish and count in no rate: 1." in (tmp_path / "out" / "report.md").read_text()


def test_figures_of_the_paper(tmp_path):
    steps = {"steps": 2000}
    for way in ("none", "late"):
        for scene in ("fixed", "randomized"):
            make_run(tmp_path / f"{scene}-{way}", scene=scene, conditioning=way)
        for n in (3, 30):
            make_run(tmp_path / f"n{n}-{way}", n=n, m=0, conditioning=way, **steps)
    make_run(tmp_path / "token", conditioning="token")
    arms = arms_of(tmp_path)
    (scene,) = panels(BY_FIELD["scene"], arms)
    # Token is there in one scene only, so it compares nothing.
    assert {v: list(some) for v, some in scene.arms.items()} == {
        "randomized": ["none", "late"], "fixed": ["none", "late"]
    }  # fmt: skip
    (ways,) = panels(BY_FIELD["conditioning"], arms)
    assert list(ways.arms) == ["none", "token", "late"]
    (cameras,) = panels(BY_FIELD["n"], arms)
    assert list(cameras.arms) == [3, 30]
    assert cameras.title == "Lift\nACT, laptop preset, steps 2000"
    assert panels(BY_FIELD["action_space"], arms) == []
    axes = curves([cameras], "cameras").axes[0]
    assert axes.get_xscale() == "log"
    assert [t.get_text() for t in axes.get_xticklabels()] == ["3", "30"]
    figure = bars([scene], BY_FIELD["scene"].names)
    drawn = figure.axes[0].patches
    assert [to_hex(b.get_facecolor()) for b in drawn] == [COLOURS["none"].lower(),
                                                         COLOURS["late"].lower()] * 2  # fmt: skip
    assert all(b.get_hatch() for b in drawn)  # none has all rollouts of the protocol
    assert all(b.get_height() == 0.5 for b in drawn)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    assert figure.bbox.x0 <= legend.get_window_extent().x0
    assert legend.get_window_extent().x1 <= figure.bbox.x1
    write_comparison(read_runs([tmp_path]), tmp_path / "out")
    made = {p.name for p in (tmp_path / "out" / "figures").iterdir()}
    assert {"fixed_randomized.png", "encodings.png", "cameras.png", "gains.png"} <= made


def test_early_fusion_with_a_new_stem_is_compared_with_the_others(tmp_path):
    weights = {"weights": "w/resnet18.pth"}
    make_run(tmp_path / "a", conditioning="none", **weights)
    make_run(tmp_path / "b", conditioning="early", stem="new", **weights)
    assert len(gains_table(arms_of(tmp_path)).rows) == 1


def test_documents_escape_what_the_formats_read():
    table = Table("100 % & more", ("a_b", "c"), [["x|y", "1\n[2]"], [Link("a b", "c d.mp4"), "<1"]])
    document = Document("T", "S", [table, Text("warns", warns=True)])
    markdown, latex = to_markdown(document), to_latex(document)
    assert r"| x\|y | 1<br>[2] |" in markdown
    assert r"[a b](c%20d.mp4)" in markdown
    assert r"\caption{100 \% \& more}" in latex
    assert r"\shortstack[l]{1 \\ {[}2]}" in latex
    assert r"\textbf{a\_b}" in latex
    assert latex.count("{") == latex.count("}")


def test_html_escapes_what_documents_say(tmp_path):
    table = Table("a <i>", ("<b>",), [["<script>"], [Link('"><u>', 'x y"#.mp4')]])
    blocks = [Heading("&amp; <h1>"), Text("<s>", warns=True), table]
    path = tmp_path / "page.html"
    path.write_text(to_html(Document("<title>", "'", blocks), tmp_path))
    page = Page(path)
    assert not {"script", "u", "i", "b", "s"} & {tag for tag, _ in page.tags}
    for words in ("a <i>", "<script>", '"><u>', "&amp; <h1>", "<title>"):
        assert words in page.text
    assert page.attributes("a", "href") == ["x%20y%22%23.mp4"]


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


def test_links_that_lead_back_are_followed_once(tmp_path):
    shutil.copytree(REPO / "results" / "lift", tmp_path / "results" / "lift")
    for name in ("a", "b"):
        (tmp_path / "results" / name).symlink_to(tmp_path / "results")
    assert len(read_runs([tmp_path])) == len(read_runs([tmp_path / "results" / "lift"]))
