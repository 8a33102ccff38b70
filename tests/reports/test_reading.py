"""Runs, results and packs are read from where they are, or refused with a word."""

import shutil
from dataclasses import replace

import pytest
from made_runs import make_run
from packs import foreign, ours, pack_of
from places import REPO

from jaxcam.errors import ConfigError, DatasetError
from jaxcam.reports.arms import group
from jaxcam.reports.packs.folder import write_results
from jaxcam.reports.reading import read_packs, read_runs


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


def test_links_that_lead_back_are_followed_once(tmp_path):
    shutil.copytree(REPO / "results" / "lift", tmp_path / "results" / "lift")
    for name in ("a", "b"):
        (tmp_path / "results" / name).symlink_to(tmp_path / "results")
    assert len(read_runs([tmp_path])) == len(read_runs([tmp_path / "results" / "lift"]))


def moved(run):
    """The same run on other pairs."""
    return replace(run, rows=[replace(r, pair_sha=f"f{r.pair:015x}") for r in run.rows])


def test_packs_stand_beside_runs_and_each_other(tmp_path):
    runs = ours(tmp_path / "runs")
    pack_of(tmp_path / "packs" / "a", runs)
    pack_of(tmp_path / "packs" / "b", [foreign()])
    both = read_runs([tmp_path / "packs"])
    assert [run.settings["policy"] for run in both] == ["act", "act", foreign().name]
    assert [run.rows for run in both][-1][0].policy == foreign().name
    assert len(read_runs([tmp_path / "packs", tmp_path / "runs"])) == 3
    assert all(not run.rows for run in read_runs([tmp_path / "packs"], "validation"))


@pytest.mark.parametrize("read", [read_packs, read_runs])
def test_packs_of_other_pairs_are_refused_with_both_and_the_pair(tmp_path, read):
    pack_of(tmp_path / "mine", ours(tmp_path / "runs"))
    pack_of(tmp_path / "yours", [moved(foreign())])
    words = (
        r"mine \(jaxcam .*, mujoco .*, robosuite .*\) and .*yours \(.* were evaluated on "
        r"different pairs of the same number: pair 0 of lift, randomized, test, is 0{16} in the "
        r"one and f0{15} in the other.*Evaluate both with one version, or leave one of them out"
    )
    with pytest.raises(ConfigError, match=words):
        read([tmp_path / "mine", tmp_path / "yours"])


def acted(run, sha):
    """The same run of weights with this digest."""
    return replace(run, rows=[replace(row, weights_sha=sha) for row in run.rows])


@pytest.mark.parametrize(
    ("shas", "marks"),
    [
        (("a" * 16, "b" * 16), [{"digest": "a" * 8}, {"digest": "b" * 8}]),
        (("a" * 16,) * 2, [{"digest": "a" * 8, "evaluation": n} for n in (1, 2)]),
        ((None, None), [{"evaluation": 1}, {"evaluation": 2}]),
    ],
)
def test_two_policies_of_one_name_are_two_arms_of_a_report(tmp_path, shas, marks):
    packs = [tmp_path / "a", tmp_path / "b"]
    for pack, rate, sha in zip(packs, (0.5, 0.25), shas, strict=True):
        pack_of(pack, [acted(foreign(rate=rate), sha)])
    (one,), base = read_runs(packs[:1]), foreign().settings
    assert not {"digest", "evaluation"} & one.settings.keys()
    runs = read_runs([*packs, packs[0]])
    marked = [{k: v for k, v in r.settings.items() if k not in one.settings} for r in runs]
    assert marked == marks
    assert [arm.estimate.value for arm in group(runs)] == [0.5, 0.25]
    write_results(tmp_path / "report", runs)
    again = read_runs([tmp_path / "report", *packs])
    assert [run.settings for run in again] == [run.settings for run in runs]
    assert base.items() <= again[0].settings.items()
    assert len(read_packs(packs)) == 2


def test_a_policy_and_more_of_its_rollouts_are_one(tmp_path):
    half, whole = acted(foreign(pairs=4), "a" * 16), acted(foreign(pairs=8, rate=0.25), "a" * 16)
    pack_of(tmp_path / "a", [half])
    pack_of(tmp_path / "b", [whole])
    (run,) = read_runs([tmp_path])
    assert (len(run.rows), "digest" in run.settings) == (8, False)


def test_a_leaderboard_is_of_packs_and_of_each_once(tmp_path):
    ours(tmp_path / "runs")
    with pytest.raises(
        ConfigError, match=r"late is no pack.*report .*late --pack FOLDER makes one"
    ):
        read_packs([tmp_path / "runs"])
    with pytest.raises(ConfigError, match="nothing is no pack"):
        read_packs([tmp_path / "nothing"])
    pack_of(tmp_path / "packs" / "a", [foreign()])
    shutil.copytree(tmp_path / "packs" / "a", tmp_path / "packs" / "copy")
    assert len(read_packs([tmp_path / "packs", tmp_path / "packs" / "a"])) == 1


def test_what_lies_in_a_packs_folder_is_not_read(tmp_path):
    pack_of(tmp_path / "a", [foreign()])
    make_run(tmp_path / "a" / "hidden")
    assert [run.name for run in read_runs([tmp_path])] == [foreign().name]


def test_a_damaged_pack_is_refused_by_a_report_too(tmp_path):
    pack_of(tmp_path / "a", [foreign()])
    rows = tmp_path / "a" / "rows.jsonl"
    rows.write_text(rows.read_text().replace("false", "true"))
    with pytest.raises(DatasetError, match="is not the file that was packed"):
        read_runs([tmp_path])
