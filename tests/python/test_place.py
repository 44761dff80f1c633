"""A figure in an Axes or a SubFigure of the user, and a width as a text."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from small_experiment import write

from rmpc_bench import figure, load_config, run
from rmpc_bench.types import DesignError


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    place = tmp_path_factory.mktemp("placed")
    config = load_config(write(place, record="{runs: 2, signals: [y, u, x_hat, P]}"))
    return run(config, directory=place / "out", jobs=1)


@pytest.mark.parametrize("keys", [{"kind": "boxplot"}, {"kind": "scatter", "x": "mse", "y": "input_power"}])
def test_a_figure_with_one_panel_is_drawn_into_an_axes(results, keys):
    own = figure(results, **keys)
    picture = Figure(figsize=(7, 3), layout="constrained")
    left, right = picture.subplots(1, 2)
    right.plot([0, 1], [0, 1])
    size, engine = picture.get_size_inches().copy(), picture.get_layout_engine()
    found = figure(results, ax=left, **keys)
    assert found.figure is picture and picture.axes == [left, right] and len(right.lines) == 1
    assert np.array_equal(picture.get_size_inches(), size) and picture.get_layout_engine() is engine
    [axes] = own.axes
    assert (len(left.lines), len(left.patches)) == (len(axes.lines), len(axes.patches)) != (0, 0)
    for one, other in zip(left.lines, axes.lines, strict=True):
        np.testing.assert_array_equal(one.get_xydata(), other.get_xydata())
    left.set_title("of the user")
    assert "<svg" in found._repr_svg_()


@pytest.mark.parametrize("keys", [{"kind": "rows"}, {"kind": "signals", "run": 0}])
def test_any_figure_is_drawn_into_a_subfigure(results, keys):
    picture = Figure(figsize=(8, 4), layout="constrained")
    part, other = picture.subfigures(1, 2)
    figure(results, ax=part, **keys)
    assert len(part.axes) == len(figure(results, **keys).axes) > 1 and not other.axes
    picture.draw_without_rendering()
    boxes = [axes.get_position() for axes in part.axes if axes.get_visible()]
    assert all(0 <= box.x0 < box.x1 <= 1 and 0 <= box.y0 < box.y1 <= 1 for box in boxes)
    # Twice into the same part gives one figure.
    figure(results, ax=part, **keys)
    assert len(part.axes) == len(boxes)


def test_wrong_places_and_widths_are_refused(results):
    with pytest.raises(DesignError, match="this figure has 2 panels; give a SubFigure"):
        figure(results, "rows", ax=Figure().subplots())
    with pytest.raises(DesignError, match=r"ax must be an Axes or a SubFigure of matplotlib \(got list\)"):
        figure(results, "boxplot", ax=[])
    with pytest.raises(ValueError, match="a length such as '252pt'"):
        figure(results, "boxplot", width="252 parsecs")


def test_a_width_may_be_a_text(results):
    assert figure(results, "boxplot", width="252pt").figure.get_figwidth() == pytest.approx(252 / 72.27, rel=1e-12)
