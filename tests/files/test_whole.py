"""Files that appear when they are whole, whoever else writes them, and not in another's place."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from jaxcam.errors import ConfigError
from jaxcam.files.whole import MARK, check_free, whole, write_atomically


def test_the_old_content_stays_on_failure(tmp_path, monkeypatch):
    path = tmp_path / "config.json"
    write_atomically(path, "old")

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    place = tmp_path / "deeper" / "out"

    def fails():
        with whole(place, folder=True) as part:
            (part / "half").write_text("")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert list(place.parent.iterdir()) == []
    with whole(place, folder=True) as part:
        (part / "all").write_text("")
    assert [p.name for p in place.iterdir()] == ["all"]
    with pytest.raises(ConfigError, match="is there"), whole(place, folder=True):
        pass


def test_two_that_make_one_folder_do_not_hurt_each_other(tmp_path):
    place = tmp_path / "out"

    def second():
        with whole(place, folder=True) as part:
            (part / "mine").write_text("")
            with whole(place, folder=True) as other:
                (other / "first").write_text("")

    with pytest.raises(ConfigError, match="is there by now"):
        second()
    assert [p.name for p in place.iterdir()] == ["first"]
    assert list(tmp_path.iterdir()) == [place]


def test_what_a_killed_writer_left_is_removed_and_what_another_writes_stays(tmp_path, caplog):
    page, folder = tmp_path / "page.html", tmp_path / "folder"
    (tmp_path / ".folder.0123456789ab.part").mkdir()
    for name in (".page.0123456789ab.part.html", ".folder.0123456789ab.part/half", "page.part"):
        (tmp_path / name).write_text("half")
    with whole(page) as live:
        write_atomically(page, "new")
        with whole(folder, folder=True):
            assert live.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder", "page.html", "page.part"]
    assert caplog.text.count("which a writer that was killed has left") == 2


def test_writers_of_one_file_do_not_meet_and_readers_see_it_whole(tmp_path):
    script = textwrap.dedent("""
        import sys
        from pathlib import Path
        from jaxcam.files.whole import write_atomically
        for i in range(60):
            write_atomically(Path(sys.argv[1]), sys.argv[2] * 200_000)
    """)
    path = tmp_path / "page.html"
    path.write_text("a" * 200_000)
    writers = [subprocess.Popen([sys.executable, "-c", script, str(path), c]) for c in "ab"]
    contents = set()
    while any(writer.poll() is None for writer in writers):
        text = path.read_text()
        assert len(text) == 200_000
        contents.add("".join(sorted(set(text))))
    assert [writer.wait() for writer in writers] == [0, 0]
    assert contents <= {"a", "b"}
    assert list(tmp_path.iterdir()) == [path]


def test_a_device_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path / "fifo", tmp_path):
        with pytest.raises(ConfigError, match="is no file"):
            write_atomically(path, "x")
        with pytest.raises(ConfigError, match="is no file"):
            check_free(path)
    assert (tmp_path / "fifo").is_fifo()


def test_a_place_that_cannot_be_written_is_told_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file/page.html", Path("/proc/page.html")):
        with pytest.raises(ConfigError, match="cannot be written"):
            check_free(path)
    check_free(tmp_path / "new/folder/page.html")
    with pytest.raises(ConfigError, match="is no file"):
        check_free(Path("/"))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_page_goes_where_nothing_is_or_where_one_of_ours_is(tmp_path):
    mine, ours, data = (tmp_path / name for name in ("mine.html", "ours.html", "data.hdf5"))
    mine.write_text("my notes")
    ours.write_text(f"<footer>{MARK} 1</footer>")
    data.write_bytes(b"\x89HDF\xff" + MARK.encode())
    check_free(tmp_path / "new.html", (data,))
    check_free(ours, (data,))
    with pytest.raises(ConfigError, match="jaxcam did not write it"):
        check_free(mine)
    (tmp_path / "link").symlink_to(data)
    for path in (data, tmp_path / "link"):
        with pytest.raises(ConfigError, match="is read here"):
            check_free(path, (data,))
