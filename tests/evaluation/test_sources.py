"""Where foreign policies are: which functions and servers are taken."""

import sys

import numpy as np
import pytest
from policy_servers import policy_server

from jaxcam.errors import ConfigError, NoServerError
from jaxcam.evaluation.sources import PolicyFunction, PolicyServer


def write(folder, monkeypatch, text):
    (folder / "my_policy.py").write_text(text)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])
    monkeypatch.delitem(sys.modules, "my_policy", raising=False)


GOOD = "def infer(o): return o\ninfer.metadata = {'execute': 4}\nnumber = 3\nclass Odd: pass\n"


def test_a_function_is_known_by_its_file_and_what_it_says(tmp_path, monkeypatch):
    write(tmp_path, monkeypatch, GOOD)
    source = PolicyFunction("my_policy:infer")
    assert source.metadata == {"execute": 4}
    monkeypatch.delitem(sys.modules, "my_policy")
    assert PolicyFunction("my_policy:infer").sha == source.sha
    write(tmp_path, monkeypatch, GOOD + "# changed\n")
    assert PolicyFunction("my_policy:infer").sha != source.sha


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("localhost:8000", "Did you mean ws://localhost:8000"),
        ("my_policy", "expected ws://HOST:PORT"),
        ("http://a", "expected ws://HOST:PORT"),
        ("my_polcy:infer", "no module 'my_polcy'"),
        ("my_policy:infr", "did you mean 'infer'"),
        ("my_policy:number", "number is int; expected a function"),
        ("my_policy:Odd", "the class Odd has no infer"),
    ],
)
def test_what_is_no_policy_is_refused(tmp_path, monkeypatch, address, message):
    write(tmp_path, monkeypatch, GOOD)
    with pytest.raises(ConfigError, match=message):
        PolicyFunction(address)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import nothing_of_the_kind", "no module 'nothing_of_the_kind', which my_policy imports"),
        ("1 / 0", "cannot be imported: ZeroDivisionError"),
        ("import sys; sys.exit(0)", "cannot be imported: SystemExit"),
        (
            "class P:\n  infer = print\n  metadata = property(lambda self: 1 / 0)\ninfer = P()",
            "its metadata cannot be read: division by zero",
        ),
        ("def infer(o): return o\ninfer.metadata = 3", "its metadata is no dict"),
    ],
)
def test_a_module_that_cannot_be_used_is_told(tmp_path, monkeypatch, text, message):
    write(tmp_path, monkeypatch, text)
    with pytest.raises(ConfigError, match=message):
        PolicyFunction("my_policy:infer")


def test_a_class_that_cannot_be_made_is_told(tmp_path, monkeypatch):
    write(tmp_path, monkeypatch,
          "class P:\n  def __init__(self, a): pass\n  def infer(self, o): pass")  # fmt: skip
    with pytest.raises(ConfigError, match=r"P\(\) failed: TypeError"):
        PolicyFunction("my_policy:P").talk("actions")


def test_a_server_is_known_by_what_it_says_wherever_it_is():
    said = {"name": "a", "mean": np.float32([1, 2]), b"odd": float("nan")}
    shas = []
    for _ in range(2):
        with policy_server(lambda o: o, {"name": "a", "mean": np.float32([1, 2])}) as address:
            shas.append(PolicyServer(address).sha)
    with policy_server(lambda o: o, {"name": "b"}) as address:
        assert PolicyServer(address).sha != shas[0]
    assert shas[0] == shas[1]
    with policy_server(lambda o: o, said) as address:
        assert PolicyServer(address).metadata == {"name": "a", "mean": [1, 2], "b'odd'": "nan"}


def test_a_server_of_ours_is_asked_as_many_at_once_as_it_answers_at_once():
    with policy_server(lambda o: o, {"width": 12}) as address:
        assert PolicyServer(address).at_once == 12
        assert PolicyServer(address, at_once=3).at_once == 3
    with policy_server(lambda o: o, {"width": "wide"}) as address:
        assert PolicyServer(address).at_once == 1


def test_no_server_is_told():
    with pytest.raises(NoServerError, match=r"No policy server answers at ws://127\.0\.0\.1:9:"):
        PolicyServer("ws://127.0.0.1:9", patience=0.1)
