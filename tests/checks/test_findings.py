"""Findings, and how they are shown in a terminal."""

from io import StringIO

from jaxcam.checks.findings import bad, good, note, show, worst
from jaxcam.console.terminal import Terminal


def test_the_worst_mark_is_that_of_all():
    assert worst([]) == worst([good("a", got="x")]) == "good"
    assert worst([good("a", got="x"), note("b", got="x")]) == "note"
    assert worst([bad("c", got="x"), note("b", got="x"), good("a", got="x")]) == "bad"


def test_a_table_shows_what_is_expected_and_below_it_how_to_mend_it():
    console = Terminal(file=StringIO(), width=80)
    fix = "Write [them] anew."
    findings = (
        good("lengths", got="9 to 11"),
        note("rate", got="0.1 s", expected="0.05 s", where="demo_1", fix=fix),
        bad("gripper", got="0 to 1", fix=fix),
    )
    show(findings, console)
    text = console.file.getvalue()
    for part in ("lengths", "9 to 11", "rate, demo_1", "expected: 0.05 s"):
        assert part in text
    assert text.splitlines()[-1] == f"rate, gripper: {fix}"
