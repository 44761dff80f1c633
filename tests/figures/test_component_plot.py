"""Pictures of a part, read back from the artists."""

import numpy as np

from rmpc_bench.figures.component_plot import draw_component
from rmpc_bench.types import Line, Panel

PANELS = (
    Panel("one", "$x$ [m]", "costs 5$", (Line("up", np.arange(3.0), np.array([0.0, np.nan, 2.0])),)),
    Panel("two", "t", "y", (Line("up", np.arange(2.0), np.ones(2)), Line("down", np.zeros(2), np.array([-1.0, 1.0])))),
)


def test_panels_are_drawn_as_they_are():
    figure = draw_component(PANELS)
    for axes, panel in zip(figure.axes, PANELS, strict=True):
        assert (axes.get_title(), axes.get_xlabel()) == (panel.title, panel.x_label)
        for drawn, line in zip(axes.lines, panel.lines, strict=True):
            assert np.array_equal(drawn.get_xdata(), line.x)
            assert np.array_equal(drawn.get_ydata(), line.y, equal_nan=True)
    assert figure.axes[0].get_ylabel() == r"costs 5\$"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["up", "down"]


PLAN = Panel(
    "plan", "x", "y",
    (
        Line("way", np.array([0.0, 2.0]), np.array([0.0, 1.0])),
        Line("marks", np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0]), dots=True, notes=("0 s", "$t_1$", "2 s")),
    ),
    equal=True,
)  # fmt: skip


def test_a_plan_has_equal_axes_and_marks_with_notes():
    """Dots, each with its text on the side away from the middle; a label has one colour in all panels."""
    figure = draw_component((PLAN,))
    (axes,) = figure.axes
    assert axes.get_aspect() == 1.0 and figure.get_figheight() > draw_component(PANELS[:1]).get_figheight()
    way, marks = axes.lines
    assert (way.get_marker(), marks.get_marker(), marks.get_linestyle()) == ("None", "o", "None")
    assert [text.get_text() for text in axes.texts] == ["0 s", "$t_1$", "2 s"]
    assert [text.xy for text in axes.texts] == [(0.0, 0.0), (1.0, 0.5), (2.0, 1.0)]
    asides = np.array([text.xyann for text in axes.texts])
    np.testing.assert_allclose(asides / np.hypot(*asides.T)[:, None], [[-2, -1], [0, 5**0.5], [2, 1]] / np.sqrt(5))
    box = axes.get_window_extent()
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    np.testing.assert_allclose(box.width / (right - left), box.height / (high - low), rtol=1e-9)  # of the layout
    first = Panel("one", "x", "y", (PLAN.lines[1], PLAN.lines[0]))
    one, other = draw_component((first, PLAN)).axes
    assert [line.get_color() for line in one.lines] == [line.get_color() for line in reversed(other.lines)]
