"""Words of messages."""

from jaxcam.console.words import some


def test_the_first_names_and_how_many_more():
    assert some([1, 2]) == "1, 2"
    assert some(range(7), 3) == "0, 1, 2 and 4 more"
