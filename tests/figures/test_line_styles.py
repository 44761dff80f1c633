"""The same method has the same colour, dashes, marker and hatch in all figures, and differs in more than colour."""

import itertools

import pytest

from rmpc_bench.figures.line_styles import MARKED_FROM, legend_sample, line_styles

METHODS = [f"M{number}" for number in range(35)]


def looks(names: list[str]) -> dict[str, tuple[object, ...]]:
    styles = line_styles(METHODS, names)
    return {name: (each.color, each.linestyle, each.marker, each.hatch) for name, each in styles.items()}


def test_a_method_keeps_its_style_when_others_are_left_out() -> None:
    few, many = looks(["M7", "M3"]), looks(METHODS)
    assert few == {name: many[name] for name in ("M7", "M3")}


def test_the_style_does_not_depend_on_the_order_of_drawing() -> None:
    assert looks(["M2", "M1", "M0"]) == {name: looks(METHODS)[name] for name in ("M0", "M1", "M2")}


def test_no_two_of_35_methods_look_alike_without_colour() -> None:
    without_colour = {name: (str(dashes), marker) for name, (_, dashes, marker, _) in looks(METHODS).items()}
    for one, other in itertools.combinations(METHODS, 2):
        assert without_colour[one] != without_colour[other], (one, other)


def test_up_to_five_methods_differ_in_dashes_marker_and_hatch() -> None:
    for place in (1, 2, 3):
        values = [str(look[place]) for look in looks(METHODS[:5]).values()]
        assert len(set(values)) == 5


def test_many_lines_over_time_have_markers_that_do_not_coincide() -> None:
    styles = line_styles(METHODS, METHODS[:MARKED_FROM])
    starts = {each.marks(200)["markevery"][0] for each in styles.values()}
    assert len(starts) == MARKED_FROM
    assert not line_styles(METHODS, METHODS[: MARKED_FROM - 1])["M0"].marks(200)
    sample = legend_sample(styles["M1"])
    assert sample.get_marker() == styles["M1"].marker


@pytest.mark.parametrize("shown", [1, 2])
def test_rough_lines_which_have_no_dashes_differ_in_markers(shown: int) -> None:
    style = line_styles(METHODS, METHODS[:shown])["M0"]
    assert bool(style.marks(200, rough=True)) == (shown > 1)
