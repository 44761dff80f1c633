"""The same method has the same colour, dashes and marker in all figures, and differs in more than colour."""

from rmpc_bench.figures.palette import DIM, line_styles

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
    assert all(styles[name].linewidth < styles["M0"].linewidth for name in METHODS[7:])
