"""Series of the designs, read back from the artists."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.figures.files import save
from rmpc_bench.figures.series import Series
from rmpc_bench.figures.style import COLOURS
from rmpc_bench.types import DesignError


def series(trials, **keys):
    return Series(**keys).draw(trials)


THREE = {"mse": {"A": [1.0], "B": [2.0], "C": [3.0]}}


def rows(method, quantity, component, values, n=0):
    columns = {"method": method, "quantity": quantity, "component": component, "n": n, "value": values}
    return pd.DataFrame({**columns, "k": np.arange(len(values))})


@pytest.fixture
def trials(make_trials):
    """A gain of two components, constant for A, and a scalar that only B and C have."""
    k = np.arange(31.0)
    parts = [rows("A", "L", f"{i},0", [0.5 + i]) for i in (0, 1)]
    parts += [
        rows(method, "L", f"{i},0", (i + 1) * k / scale) for method, scale in (("B", 5), ("C", 50)) for i in (0, 1)
    ]
    parts += [rows(method, "theta", "", 1e-3 * (1 + k)) for method in "BC"]
    parts += [
        rows("B", "theta", "", 7 + k, n=100),
        rows("B", "var", "", 1 + k, n=50),
        rows("B", "var", "", 2 + k, n=100),
    ]
    parts += [rows("B", "P", f"{i},{j}", k) for i in range(4) for j in range(4)]
    return replace(make_trials(THREE), series=pd.concat(parts, ignore_index=True))


def line(figure, panel, method):
    (found,) = (line for line in figure.axes[panel].lines if line.get_color() == COLOURS["ABC".index(method)])
    return found.get_xdata(), found.get_ydata()


def test_a_component_over_k(trials):
    """What the table says; a constant goes through the whole panel."""
    figure = series(trials, quantity="L", component="1,0")
    for method, scale in (("B", 5), ("C", 50)):
        x, y = line(figure, 0, method)
        assert np.array_equal(x, np.arange(31)) and np.array_equal(y, 2 * np.arange(31) / scale)
    x, y = line(figure, 0, "A")
    assert (list(x), list(y)) == ([0, 30], [1.5, 1.5])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("$k$", "$L_{1,0}$")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["A", "B", "C"]


def test_all_components_are_panels(trials):
    """Where none is chosen and they fit."""
    figure = series(trials, quantity="L")
    assert [axes.get_ylabel() for axes in figure.axes] == ["$L_{0,0}$", "$L_{1,0}$"]
    assert line(figure, 1, "B")[1][-1] == 2 * line(figure, 0, "B")[1][-1] == 12


def test_the_exact_values_count(trials):
    """Not those from runs; of those the ones from most runs, where there are no exact ones."""
    assert line(series(trials, quantity="theta"), 0, "B")[1][0] == 1e-3
    assert line(series(trials, quantity="var"), 0, "B")[1][0] == 2


def test_seconds_where_the_sampling_time_is_known(trials):
    """Whether or not runs are recorded; the window is in the units of the axis."""
    figure = series(replace(trials, Ts=0.5), quantity="L", component="0,0", from_=5.0, to=10.0)
    x, y = line(figure, 0, "B")
    assert np.array_equal(x, 0.5 * np.arange(10, 21)) and np.array_equal(y, np.arange(10, 21) / 5)
    assert figure.axes[0].get_xlabel() == "$t$ [s]" and figure.axes[0].get_xlim() == (5, 10)
    assert list(line(figure, 0, "A")[0]) == [5, 10]
    figure = series(trials, quantity="L", component="0,0", from_=5.0, to=10.0)
    assert list(line(figure, 0, "B")[0]) == [5, 6, 7, 8, 9, 10]


def test_a_series_that_ends_before_the_window(trials):
    """It is left out."""
    short = pd.concat([trials.series, rows("A", "theta", "", np.ones(5))], ignore_index=True)
    figure = series(replace(trials, series=short), quantity="theta", from_=10)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["B", "C"]


def test_logarithmic_where_all_values_are_positive(trials):
    """Else linear, and said so."""
    assert series(trials, quantity="theta", log=True).axes[0].get_yscale() == "log"
    axes = series(trials, quantity="L", component="0,0", log=True).axes[0]
    assert axes.get_yscale() == "linear" and "linear" in axes.get_ylabel()
    assert series(trials, quantity="L", component="0,0", from_=1, log=True).axes[0].get_yscale() == "log"


def test_methods_and_points(trials, make_sweep):
    """The order of the configuration; a point of a sweep."""
    figure = series(trials, quantity="L", component="0,0", order=["C"])
    assert len(figure.axes[0].lines) == 1 and figure.axes[0].lines[0].get_color() == COLOURS[2]
    sweep = make_sweep(({"model.d": "1"}, trials), ({"model.d": "2"}, trials))
    assert series(sweep, quantity="theta", at={"model.d": 2}).axes[0].get_title() == "d=2"
    assert series(sweep, quantity="theta").axes[0].get_title() == "d=1 (first of 2 points)"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"quantity": "M"}, "'M' is not a series of these methods (available: L, theta, var, P)"),
        ({"quantity": "L", "component": "2,0"}, "'2,0' is not a component of L: the components are 0,0 to 1,0"),
        ({"quantity": "L", "component": 2}, "2 is not a component of L: the components are 0,0 to 1,0"),
        ({"quantity": "P"}, "16 components do not fit into one figure (at most 6): choose one with `component`"),
        ({"quantity": "theta", "order": ["A", "B"]}, "'A' has no theta (those that have: B, C)"),
        ({"quantity": "L", "order": ["D"]}, "'D' is not a known method; known: A, B, C"),
        ({"quantity": "L", "from_": 30.0}, "fewer than two samples lie between `from` and `to` (there are 0 to 30)"),
    ],
)
def test_errors_show_the_choices(trials, given, message):
    """A figure that cannot be drawn is left out with a reason."""
    with pytest.raises(DesignError) as error:
        series(trials, **given)
    assert str(error.value).startswith(message) and error.value.parameter in {
        *(name.rstrip("_") for name in given),
        "component",
    }


def test_no_series_at_all(make_trials):
    """Methods without designs that tell something."""
    with pytest.raises(DesignError, match=r"'L' is not a series of these methods \(available: none\)"):
        series(make_trials(THREE), quantity="L")


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    paths = [save(series(trials, quantity="L"), tmp_path, stem) for stem in ("one", "other")]
    assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]


def test_keys():
    """A component is a text, or a number where it has one index."""
    for text, component in (("2,0", "2,0"), ("2", 2)):
        problems = []
        tree = parse(f"{{quantity: L, component: '{text}', log: true}}".replace("'2'", "2"), "f.yaml")
        keys = validate(model_of("figures", "series"), tree, [], problems)
        assert not problems and keys.component == component and keys.log
    assert validate(model_of("figures", "series"), parse("{log: true}", "f.yaml"), [], problems) is None
    assert [problem.message for problem in problems] == ["'quantity' is missing"]
