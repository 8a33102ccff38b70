"""Sheets: what is read from them and what is refused."""

import copy

import pytest
from places import REPO
from sheets import SHEET, write_sheet

from jaxcam.errors import ConfigError
from jaxcam.robot.trials.sheet import read_sheet


def test_a_sheet_is_read(tmp_path):
    sheet = read_sheet(write_sheet(tmp_path))
    assert [policy.name for policy in sheet.policies] == ["ACT with poses", "ACT without"]
    assert sheet.placements == ("1", "2", "3", "4", "5", "6", "7")
    assert (sheet.used, sheet.robot, sheet.seed) == (2, "none", 0)


def test_the_example_is_one():
    sheet = read_sheet(REPO / "examples/robot/sheet.yaml")
    assert (len(sheet.policies), len(sheet.placements), sheet.used) == (2, 7, 2)


def cameras(**changes):
    return {"cameras": SHEET["cameras"] | changes}


def policy(**changes):
    policies = copy.deepcopy(SHEET["policies"])
    policies[1] |= changes
    return {"policies": policies}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"polices": []}, "Unknown setting 'polices', did you mean 'policies'"),
        ({"half": None}, "has no 'half'"),
        ({"half": " "}, "half is empty"),
        ({"seconds": "long"}, "seconds must be float"),
        ({"seconds": 0}, "seconds must be finite and more than 0"),
        ({"seed": -1}, "seed must be at least 0"),
        ({"listen": 70000}, "listen must be at most 65535"),
        ({"policies": []}, "policies is empty"),
        ({"policies": "ACT"}, "policies must be tuple"),
        ({"policies": ["ACT"]}, "policy 1: expected {name: …, url: …}, got 'ACT'"),
        (policy(addres="x"), "policy 2: Unknown setting 'addres'"),
        (policy(name="ACT with poses"), "the name 'ACT with poses' is there twice"),
        (policy(url="ws://127.0.0.1:1/"), "the url 'ws://127.0.0.1:1' is there twice"),
        (policy(url="127.0.0.1:2"), "policy 'ACT without': url '127.0.0.1:2' is no address"),
        (policy(execute=0), "execute must be at least 1"),
        (policy(url="ws://[::1"), "policy 'ACT without': url 'ws://[::1' is no address"),
        (policy(url="ws://127.0.0.1:99999"), "'ws://127.0.0.1:99999' is no address"),
        (policy(name=" "), "policy 2: name is empty"),
        (policy(name="ACT with poses "), "the name 'ACT with poses' is there twice"),
        (policy(name="a\nb"), "policy 2: name 'a\\\\nb' has more than one line"),
        (policy(key_file=""), "policy 2: key_file is empty"),
        ({"robot": ""}, "robot is empty"),
        ({"prompt": ""}, "prompt is empty"),
        ({"starts": []}, "starts is empty"),
        ({"starts": ["a", ""]}, "starts is empty, or has one that is"),
        ({"starts": ["a", "a "]}, "the start 'a' is there twice"),
        ({"starts": ["a", "a"]}, "the start 'a' is there twice"),
        (cameras(nmaes=["left"]), "cameras: Unknown setting 'nmaes', did you mean 'names'"),
        (cameras(names=[]), "names is empty"),
        (cameras(names=["left", "left"]), "the name 'left' is there twice"),
        (cameras(use=4), "use is 4, of 3 cameras"),
        (cameras(use=0), "use is 0, of 3 cameras"),
        (cameras(file=None), "placements without 'file'"),
        (cameras(names=["left", " ", "top"]), "cameras: names is empty, or has one that is"),
        (cameras(names=["arm/left", "right"]), "the name 'arm/left' has a slash"),
        (cameras(file=""), "cameras: file is empty"),
        (cameras(placements=[""]), "cameras: placements is empty, or has one that is"),
        (cameras(placements=[1, "1"]), "the placement '1' is there twice"),
        ({"repeats": 1000, "starts": [str(i) for i in range(200)], "cameras": None}, "400,000 rol"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, changes, words):
    with pytest.raises(ConfigError, match=words.replace("[", r"\[")) as refused:
        read_sheet(write_sheet(tmp_path, **changes))
    assert "sheet.yaml" in str(refused.value) or "must be" in str(refused.value)


@pytest.mark.parametrize("text", ["- 1", "a: [", "", "\x00", "1: 2"])
def test_what_is_no_sheet_is_refused(tmp_path, text):
    path = tmp_path / "sheet.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"sheet\.yaml"):
        read_sheet(path)
    with pytest.raises(ConfigError, match="no such file"):
        read_sheet(tmp_path / "none.yaml")
