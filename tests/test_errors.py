"""Errors name the closest of what is known, and are of the kinds that callers catch."""

from jaxcam import errors


def test_closest_names():
    known = ["lift", "can", "square"]
    assert errors.closest("Lifft", known) == ", did you mean 'lift'? Known: lift, can, square"
    assert errors.closest("xyzzy", known) == ". Known: lift, can, square"


def test_value_errors_can_be_caught_as_such():
    for kind in (errors.ConfigError, errors.CameraError, errors.DatasetError):
        assert issubclass(kind, ValueError)
