"""Our pages: nothing from elsewhere is in them, and no text is markup."""

import base64

import cv2
import jinja2
import numpy as np
import pytest

from jaxcam.reports.html import embedded, own_files, render


def test_links_are_no_files_of_a_folder(tmp_path):
    folder, elsewhere = tmp_path / "run", tmp_path / "secret.png"
    folder.mkdir()
    elsewhere.write_bytes(b"secret")
    for name in ("b.png", "a.png", "c.txt"):
        (folder / name).write_bytes(b"own")
    (folder / "d.png").symlink_to(elsewhere)
    (folder / "e.png").mkdir()
    assert [f.name for f in own_files(folder, "*.png")] == ["a.png", "b.png"]
    (tmp_path / "link").symlink_to(folder)
    assert own_files(tmp_path / "link", "*.png") == []
    assert own_files(tmp_path / "nowhere", "*.png") == []


@pytest.mark.parametrize(("width", "shown"), [(400, 300), (4000, 980)])
def test_a_picture_is_shown_at_three_quarters_and_fits_the_page(tmp_path, width, shown):
    file = tmp_path / "a.png"
    cv2.imwrite(str(file), np.zeros((8, width, 3), np.uint8))
    picture = embedded(file, "what it is", wide=True)
    assert picture.pixels == shown
    assert base64.b64decode(picture.data) == file.read_bytes()


def test_titles_are_no_markup_and_what_a_template_lacks_is_an_error():
    page = render("document.html", "<script>", "<i>", blocks=[])
    assert "&lt;script&gt;" in page
    assert "<i>" not in page
    with pytest.raises(jinja2.UndefinedError):
        render("document.html", "title", "subtitle")
