"""Metric over a swept value, read back from the artists."""

import math

import numpy as np
import pytest
from conftest import ROUND
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from rmpc_bench.figures.axes import FAR
from rmpc_bench.figures.files import save_as
from rmpc_bench.figures.style import COLOURS, REFERENCE
from rmpc_bench.figures.sweep_lines import SweepLines
from rmpc_bench.types import DesignError, MetricInfo

RATIO, LENGTH = MetricInfo("ratio", "", "one"), MetricInfo("length", "m", "lower")
HORIZON, SET = "controller.horizon", "controller.set"


@pytest.fixture
def sweep(make_trials, make_sweep):
    """Ratio N times a run's own factor for A, twice that for B; the horizons are not in order."""
    factors = np.array([0.5, 1.0, 4.0, 2.0, 8.0])

    def table(N, scale=1.0):
        values = {"A": list(scale * N * factors), "B": list(2.0 * scale * N * factors)}
        return make_trials({"ratio": values, "length": values}, (RATIO, LENGTH))

    grid = [(name, N) for name in ("stacked", "product") for N in (20, 10, 100)]
    return make_sweep(
        *[({SET: name, HORIZON: str(N)}, table(N, 1.0 if name == "stacked" else 0.1)) for name, N in grid]
    )


def draw(trials, **keys):
    return SweepLines(**{"path": HORIZON, "drawn": "bars", **keys}).draw(trials)


def title(axes):
    return axes.get_title().replace("\n", " ")


def lines(axes):
    """Colour -> (x, y) of the lines with markers."""
    return {to_hex(line.get_color()): line.get_xydata().T for line in axes.lines if line.get_marker() != "None"}


def bars(axes):
    """Colour -> rows x, low, high of the bars."""
    found = {}
    for made in axes.collections:
        assert isinstance(made, LineCollection)
        ends = np.array([path.vertices for path in made.get_paths()])
        found[to_hex(made.get_color()[0])] = np.stack([ends[:, 0, 0], ends[:, 0, 1], ends[:, 1, 1]])
    return found


def test_a_panel_for_every_other_coordinate(sweep):
    """Medians and quartiles over N, ascending, one line per method; the panels in the order of the sweep."""
    figure = draw(sweep)
    stacked, product = figure.axes
    assert stacked.get_xscale() == "log" and list(product.get_xticks()) == [10.0, 20.0, 100.0]
    quartiles = np.quantile([0.5, 1.0, 4.0, 2.0, 8.0], [0.5, 0.25, 0.75])
    N = np.array([10.0, 20.0, 100.0])
    for axes, scale in ((stacked, 1.0), (product, 0.1)):
        for color, factor in zip(COLOURS[:2], (1.0, 2.0), strict=True):
            middle, low, high = scale * factor * np.outer(quartiles, N)
            np.testing.assert_allclose(lines(axes)[color], [N, middle], **ROUND)
            np.testing.assert_allclose(bars(axes)[color], [N, low, high], **ROUND)
    assert title(stacked) == "set=stacked; medians, bars: interquartile range, 5 runs"
    assert title(product) == "set=product" and product.get_xlabel() == "horizon of the controller"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["A", "B"]


def test_the_best_value_of_a_ratio(sweep):
    """A line at 1 for a metric that is best there, none for one that is better when lower."""
    for metric, wanted in (("ratio", [1.0, 1.0]), ("length", None)):
        axes = draw(sweep, metric=metric, at=[{SET: "stacked"}]).axes[0]
        found = [list(line.get_ydata()) for line in axes.lines if line.get_color() == REFERENCE]
        assert found == ([wanted] if wanted else [])
        assert axes.get_ylabel() == ("ratio" if metric == "ratio" else "length [m]")


def test_a_part_of_the_sweep(sweep):
    """Points and methods are chosen; means with standard errors on a logarithmic axis."""
    figure = draw(
        sweep, at=[{SET: "product", HORIZON: 100}, {SET: "product", HORIZON: 10}], order=["B"], spread="se", log=True
    )
    (axes,) = figure.axes
    values = 0.2 * np.array([0.5, 1.0, 4.0, 2.0, 8.0])
    se = values.std(ddof=1) / math.sqrt(5.0)
    ((color, line),) = lines(axes).items()
    assert color == COLOURS[1] and axes.get_yscale() == "log"
    np.testing.assert_allclose(line, [[10.0, 100.0], [10.0 * values.mean(), 100.0 * values.mean()]], **ROUND)
    np.testing.assert_allclose(
        bars(axes)[color][1], [10.0 * (values.mean() - se), 100.0 * (values.mean() - se)], **ROUND
    )
    assert title(axes) == "set=product; means, bars: standard errors, 5 runs"


def test_failed_and_infinite_runs(make_trials, make_sweep):
    """Failed runs do not count, an infinite bar ends at the edge, and without a finite median there is a gap."""
    columns = [["diverged", 1.0, 3.0], [1.0, 1.0, math.inf], [math.inf, math.inf, 1.0], ["diverged"] * 3]
    tables = [make_trials({"ratio": {"A": values}}, (RATIO,)) for values in columns]
    (axes,) = draw(make_sweep(*[({HORIZON: str(N)}, table) for N, table in enumerate(tables)])).axes
    np.testing.assert_array_equal(lines(axes)[COLOURS[0]], [[0, 1, 2, 3], [2.0, 1.0, math.nan, math.nan]])
    # The upper quartile of two numbers and inf is not finite.
    assert bars(axes)[COLOURS[0]][2, 1] == FAR
    assert axes.get_ylim()[1] < 5.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"path": None}, f"must name one of the swept paths: {SET}, {HORIZON}"),
        (
            {"path": "controller.horizn"},
            f"'controller.horizn' is not a known path of the sweep; did you mean '{HORIZON}'?",
        ),
        ({"path": HORIZON, "show": "change", "log": True}, "changes may be negative"),
    ],
)
def test_wrong_paths(sweep, given, message):
    """A path that is not swept, or not one of numbers."""
    with pytest.raises(DesignError) as error:
        draw(sweep, **given)
    assert str(error.value).startswith(message) and error.value.parameter == ("log" if "log" in given else "path")


def test_no_sweep_and_too_many_panels(make_trials, make_sweep):
    """Nothing to draw over, or more panels than a figure has room for."""
    table = make_trials({"ratio": {"A": [1.0, 2.0]}}, (RATIO,))
    with pytest.raises(DesignError, match="nothing is swept in this configuration"):
        draw(table, path=None)
    grid = make_sweep(*[({"k": str(k), HORIZON: str(N)}, table) for k in range(7) for N in (1, 2)])
    with pytest.raises(DesignError, match=r"7 panels do not fit into one figure \(at most 6\)"):
        draw(grid)
    with pytest.raises(DesignError, match="7 panels do not fit"):
        draw(grid, at=[{HORIZON: 1}])


def test_same_bytes(sweep, tmp_path):
    """Drawn twice, saved twice."""
    for stem in ("one", "other"):
        save_as(draw(sweep), tmp_path / f"{stem}.svg")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "other.svg").read_bytes()
