"""The leaderboard's page: what is on it, that nothing in it runs, and its script in a browser."""

import base64
import hashlib
import json
import re
import shutil
import subprocess
from urllib.parse import unquote

import pytest
from packs import foreign, ours, pack_of
from running import exit_code
from web_page import Page

from jaxcam.errors import ConfigError
from jaxcam.reports.packs.page import write_leaderboard

EVIL = '"><script>alert(1)</script><img src=x onerror=alert(2)>'


@pytest.fixture
def packs(tmp_path):
    return [
        pack_of(tmp_path / "packs" / "a", ours(tmp_path / "runs")),
        pack_of(tmp_path / "packs" / "b", [foreign("Pi", 0.5), foreign("Pi", task="push")]),
    ]


def test_the_command_writes_a_page_over_packs(packs, tmp_path, capsys):
    page = tmp_path / "site" / "board.html"
    for _ in range(2):  # it may be written anew
        assert exit_code("report", tmp_path / "packs", "--leaderboard", page) == 0
    assert "(4 settings of 2 packs)" in "".join(capsys.readouterr().out.splitlines())
    read = Page(page)
    assert read.attributes("section", "data-task") == [None, "Lift", "Push"]
    assert [v for v in read.attributes("tr", "data-success") if v] == [
        "75.0",
        "50.0",
        "25.0",
        "50.0",
    ]
    assert [float(v) for v in read.attributes("tr", "data-difference") if v] == [0, -25, -50, 0]
    texts = [v for v in read.attributes("tr", "data-differences") if v]
    assert [len(json.loads(text)) for text in texts] == [3, 3, 3, 1]
    assert read.attributes("option", "value") == ["", None, None, "0", "1", "2", "0"]
    own = ["name", "success", "difference", "rollouts"]
    assert read.attributes("button", "data-column") == ["name", "board0", "board1", *own, *own]
    assert [(v, w) for v, w in zip(*(read.attributes("tr", f"data-board{i}") for i in (0, 1)),
                                   strict=True) if v] == [("50.0", "50.0")]  # fmt: skip
    assert "Lift, randomized scene" in read.text
    assert "azimuth -90° to -60°" in read.text


def test_nothing_comes_from_the_network_and_only_our_script_runs(packs, tmp_path):
    page = tmp_path / "board.html"
    write_leaderboard(page, packs)
    text = page.read_text("utf-8")
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    (policy,) = re.findall(r'Content-Security-Policy" content="(.*?)"', text)
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert (rules["default-src"], rules["script-src"]) == ("'none'", f"'sha256-{digest}'")
    assert "http" not in text.replace("http-equiv", "").replace("http://www.w3.org", "")


def test_names_in_packs_are_texts(tmp_path):
    policy = foreign(EVIL, task=EVIL, note=EVIL)
    pack = pack_of(tmp_path / "a", [policy], EVIL, authors=EVIL, link="https://a.org/'\"><b>")
    page = tmp_path / "board.html"
    write_leaderboard(page, [pack])
    read = Page(page)
    assert page.read_text("utf-8").count("<script") == 1
    assert not [tag for tag, attrs in read.tags if tag == "img" or "onerror" in attrs]
    assert read.attributes("a", "href") == ["https://a.org/'\"><b>"]
    assert EVIL in read.text


def test_a_page_that_is_not_ours_is_left(packs, tmp_path):
    page = tmp_path / "index.html"
    page.write_text("mine")
    with pytest.raises(ConfigError, match=r"jaxcam did not write it. Choose another --leaderboard"):
        write_leaderboard(page, packs)
    assert page.read_text() == "mine"


CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
CLICKS = """<script>
const [first] = document.querySelectorAll(".board");
const lines = () => [...first.querySelectorAll("tbody tr")].map((tr) =>
  [tr.dataset.success, tr.dataset.difference, tr.querySelector(".against b").innerText].join("|"));
const log = [lines()];
const choose = (select, value) => {
  select.value = value;
  select.dispatchEvent(new Event("change"));
};
const click = (name) => first.querySelector(`[data-column=${name}]`).click();
choose(first.querySelector("select"), 2);
log.push(lines());
click("difference"); click("difference");
log.push(lines());
choose(document.querySelector("#task"), "Push");
log.push([...document.querySelectorAll(".board")].map((s) => s.hidden));
log.push(compare("", "1", true) > 0, compare("", "1", false) > 0, compare("10", "9", false) > 0,
  compare("b", "a", false) > 0);
document.body.innerHTML = "";
document.body.dataset.log = encodeURIComponent(JSON.stringify(log));
</script></body>"""


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium to run the page's script")
def test_sorting_comparing_and_filtering_in_a_browser(packs, tmp_path):
    page = tmp_path / "board.html"
    write_leaderboard(page, packs)
    text = re.sub(r"<meta http-equiv[^>]*>", "", page.read_text("utf-8"))  # so that ours runs, too
    (tmp_path / "clicked.html").write_text(text.replace("</body>", CLICKS), "utf-8")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", (tmp_path / "clicked.html").as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    escaped = re.search(r'data-log="([^"]*)"', done.stdout)[1]
    first, compared, ordered, hidden, *truths = json.loads(unquote(escaped))
    assert [line.split("|")[:2] for line in first] == [
        ["75.0", "0.0"],
        ["50.0", "-25.0"],
        ["25.0", "-50.0"],
    ]
    assert [line.split("|")[1] for line in compared] == ["50", "25", "0"]
    assert compared[2].endswith("|reference")
    assert [line.split("|")[0] for line in ordered] == ["25.0", "50.0", "75.0"]
    assert hidden == [True, False]
    assert truths == [True] * 4
