"""Documents in three formats, which read no markup in their words."""

from web_page import Page

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
