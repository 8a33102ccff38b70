"""Success by direction: which cell a camera is in, and what a cell says."""

from run_rows import evaluation

from jaxcam.reports.packs.directions import direction_maps
from jaxcam.reports.style import BLUE, VERMILION
from jaxcam.results.rows import Row


def seen_from(*places):
    """A rollout for each (azimuth, elevation, outcome)."""
    return [
        Row(pair=i, status="ok", success=won, azimuth_deg=az, elevation_deg=el)
        for i, (az, el, won) in enumerate(places)
    ]  # fmt: skip


def test_a_camera_is_in_a_cell_of_its_own_and_in_both_margins():
    (drawn,) = direction_maps([seen_from((-90, 30, True), (90, 60, False))])
    words = {(cell.x, cell.y): (cell.words, cell.colour.upper()) for cell in drawn.cells}
    won, lost = "100 % [21, 100] on 1 camera", "0 % [0, 79] on 1 camera"
    assert words == {
        (0, 0): (f"azimuth -90° to -60°: {won}", BLUE.upper()),
        (55, 0): (f"azimuth 60° to 90°: {lost}", VERMILION.upper()),
        (0, 36): (f"azimuth -90° to -60°, elevation 30° to 40°: {won}", BLUE.upper()),
        (69, 36): (f"elevation 30° to 40°: {won}", BLUE.upper()),
        (55, 14): (f"azimuth 60° to 90°, elevation 50° to 60°: {lost}", VERMILION.upper()),
        (69, 14): (f"elevation 50° to 60°: {lost}", VERMILION.upper()),
    }
    assert (drawn.width, drawn.height) == (79, 46)
    assert drawn.words.count("azimuth") == 2


def test_rollouts_on_one_camera_are_one_trial():
    (drawn,) = direction_maps([seen_from(*[(5, 45, won) for won in (True, True, False, False)])])
    assert {cell.words.partition(": ")[2] for cell in drawn.cells} == {"50 % [5, 95] on 1 camera"}


def test_all_maps_of_a_board_have_the_same_ranges():
    far = seen_from((-130, 80, True))
    near, other = direction_maps([evaluation([True, False] * 20), far])
    assert (near.width, near.height) == (other.width, other.height) == (101, 68)
    assert direction_maps([[Row(pair=0, status="ok", success=True)], []]) == [None, None]
