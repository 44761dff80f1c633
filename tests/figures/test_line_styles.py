"""The same method has the same colour, dashes and marker in all figures, and differs in more than colour."""

import pytest

from rmpc_bench.figures.palette import DIM, MARKED_FROM, legend_sample, line_styles

METHODS = [f"M{number}" for number in range(9)]


def looks(names: list[str]) -> dict[str, tuple[object, ...]]:
    styles = line_styles(METHODS, names)
    return {name: (each.color, each.linestyle, each.marker) for name, each in styles.items()}


def test_a_method_keeps_its_style_when_others_are_left_out() -> None:
    few, many = looks(["M7", "M3"]), looks(METHODS)
    assert few == {name: many[name] for name in ("M7", "M3")}


def test_the_style_does_not_depend_on_the_order_of_drawing() -> None:
    assert looks(["M2", "M1", "M0"]) == {name: looks(METHODS)[name] for name in ("M0", "M1", "M2")}


def test_seven_methods_differ_in_colour_dashes_and_marker_and_more_are_thin_and_grey() -> None:
    for place in range(3):
        assert len({str(look[place]) for look in looks(METHODS[:7]).values()}) == 7
    styles = line_styles(METHODS, METHODS)
    assert {styles[name].line()["color"] for name in METHODS[7:]} == {DIM}
    assert all(styles[name].linewidth < styles["M0"].linewidth and not styles[name].marks(200) for name in METHODS[7:])


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
