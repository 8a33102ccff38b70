"""Names that somebody else wrote are names wherever they go."""

import csv
import io

import pytest
from matplotlib.figure import Figure

from jaxcam.reports.names import (
    address,
    csv_cell,
    drawn,
    file_name,
    latex,
    markdown,
    markdown_cell,
)

ODD = ["/../../../x", "..", ".hidden", "", "a/b", "a\\b", "\x00", "x" * 300, "é", "-rf", "a b"]


@pytest.mark.parametrize("text", ODD)
def test_a_file_name_stays_in_its_folder(text, tmp_path):
    name = file_name(text)
    assert (tmp_path / f"{name}.png").resolve().parent == tmp_path.resolve()
    assert not name.startswith((".", "-")) or len(name) > 1
    (tmp_path / f"map-{name}.png").touch()


def test_file_names_are_kept_where_they_can_be_and_differ_where_they_cannot():
    assert file_name("lift-act") == "lift-act"
    assert len({file_name(text) for text in ODD}) == len(ODD)


@pytest.mark.parametrize("text", ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3", "\t=1"])
def test_no_table_program_takes_a_cell_for_a_formula(text):
    out = io.StringIO()
    csv.writer(out).writerow([csv_cell(text)])
    (cell,) = next(csv.reader(io.StringIO(out.getvalue())))
    assert cell == f"'{text}"


@pytest.mark.parametrize("text", ["-0.25", "+1.5", "lift", "", "1e-5"])
def test_numbers_and_names_are_as_they_were(text):
    assert csv_cell(text) == text


def test_tex_has_no_commands_of_others():
    written = latex(r"\input{/etc/passwd} $x$ 100% #1 ~ ^ & _")
    assert written == (
        r"\textbackslash{}input\{/etc/passwd\} \$x\$ 100\% \#1 \textasciitilde{} "
        r"\textasciicircum{} \& \_"
    )


def test_markdown_has_no_tags_links_or_code_of_others():
    assert markdown("<img src=x> [a](b) `c`") == r"&lt;img src=x> [a\](b) \`c\`"
    assert markdown("&lt;b> R&D &#60; a & b") == "&amp;lt;b> R&amp;D &amp;#60; a & b"
    assert markdown_cell("a|b\n*c*") == r"a\|b<br>\*c\*"
    assert markdown("[66.3, 89.2] on 50 pairs") == "[66.3, 89.2] on 50 pairs"


def test_a_link_is_a_path():
    assert address("javascript:alert(1)") == "./javascript%3Aalert%281%29"
    assert address("runs/\udcff.mp4") == "runs/%FF.mp4"
    assert address("../runs/a b#c?/x.mp4") == "../runs/a%20b%23c%3F/x.mp4"


def test_dollars_are_drawn_as_they_are():
    figure = Figure()
    text = figure.text(0, 0, drawn(r"$\frac{$ costs $5"))
    figure.canvas.draw()
    assert text.get_window_extent().width > 0
