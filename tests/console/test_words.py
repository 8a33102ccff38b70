"""Words of messages."""

from jaxcam.console.words import plain_line, printable, some


def test_the_first_names_and_how_many_more():
    assert some([1, 2]) == "1, 2"
    assert some(range(7), 3) == "0, 1, 2 and 4 more"


def test_a_terminal_is_not_steered():
    assert plain_line("a\x1b[31mred\r\n") == r"a\x1b[31mred\r\n"
    assert plain_line("é · –") == "é · –"
    assert printable("a\r\n\x1b[2J\u202eb") == "a\\r\n\\x1b[2J\\u202eb"
