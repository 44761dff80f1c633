"""Heat maps over two swept values, read back from the artists."""

import itertools

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from rmpc_bench.figures.files import save_as
from rmpc_bench.figures.heat_cells import PALETTE
from rmpc_bench.figures.heat_map import HeatMap
from rmpc_bench.report.summary import summarise
from rmpc_bench.types import DesignError, MetricInfo, ResultLayout

X, Y = "controller.Hp", "uncertainty.scale"
RUNS = 40
XS, YS = ("10", "5", "20"), ("2", "0.5")


@pytest.fixture
def sweep(make_trials, make_sweep):
    """Baseline A; B is worse to the right and equal to A on average at Hp = 10; one point is left out."""
    rng = np.random.default_rng(8)

    def table(Hp, scale):
        base = rng.lognormal(0.0, 0.3, RUNS)
        noise = rng.lognormal(0.0, 0.05, RUNS)
        noise /= np.exp(np.log(noise).mean())
        return make_trials({"mse": {"A": list(base), "B": list(base * (Hp / 10) ** scale * noise)}})

    places = [(x, y) for x, y in itertools.product(XS, YS) if (x, y) != ("20", "0.5")]
    return make_sweep(*[({X: x, Y: y}, table(float(x), float(y))) for x, y in places])


def cells(axes):
    """(column, row) -> colour of its cell, and the cells that are hatched."""
    found, hatched = {}, set()
    for patch in axes.patches:
        assert isinstance(patch, Rectangle)
        place = round(patch.get_x() + 0.5), round(patch.get_y() + 0.5)
        if patch.get_hatch():
            hatched.add(place)
        else:
            found[place] = patch.get_facecolor()
    return found, hatched


def test_cells_are_the_numbers_of_comparisons_csv(sweep):
    """Oracle: the table that is written; ascending axes, white where the sweep leaves a point out."""
    kept = summarise(sweep).compared.set_index([X, Y])
    axes, bar = HeatMap(width=5.0).draw(sweep).axes
    assert [text.get_text() for text in axes.get_xticklabels()] == ["5", "10", "20"]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["0.5", "2"]
    found, hatched = cells(axes)
    assert set(found) == {(0, 0), (0, 1), (1, 0), (1, 1), (2, 1)}
    texts = {
        tuple(map(int, text.get_position())): text.get_text().replace("\N{MINUS SIGN}", "-") for text in axes.texts
    }
    for (x, y), row in kept.iterrows():
        place = ("5", "10", "20").index(x), ("0.5", "2").index(y)
        assert float(texts[place]) == pytest.approx(row["change_pct"], abs=0.51)
        assert (place in hatched) == (row["ci_low"] <= 0 <= row["ci_high"])
    assert hatched == {(1, 0), (1, 1)}
    assert bar.get_ylabel() == "change of MSE against A [%]"


def test_no_change_and_the_margin_are_grey(sweep):
    """The scale is symmetric about 0, and its lightness rises from the lowest to the highest change."""
    import matplotlib

    axes, bar = HeatMap().draw(sweep).axes
    found, _ = cells(axes)
    assert found[1, 0] == found[1, 1] == matplotlib.colormaps[PALETTE].resampled(255)(0.5)
    low, high = bar.get_ylim()
    assert low == -high and high == pytest.approx(abs(summarise(sweep).compared["change_pct"]).max())
    edges = sorted(line.get_ydata()[0] for line in bar.lines)
    np.testing.assert_allclose(edges, [-100 / 101, 1.0], rtol=1e-9)

    def light(colour):
        return np.dot([0.2126, 0.7152, 0.0722], colour[:3])

    assert light(found[0, 1]) < light(found[0, 0]) < light(found[1, 1]) < light(found[2, 1])


def test_values(sweep):
    """Means on a scale from the least to the most, no hatch; one panel per method."""
    *panels, bar = HeatMap(show="value", width=5.0).draw(sweep).axes
    assert [axes.get_title() for axes in panels] == ["A", "B"] and bar.get_ylabel() == "MSE [rad$^{2}$]"
    means = [point.column("mse", method).mean() for point in sweep.points for method in "AB"]
    np.testing.assert_allclose(bar.get_ylim(), (min(means), max(means)), rtol=1e-12)
    assert all(not cells(axes)[1] for axes in panels)


def test_numbers_only_where_they_fit(sweep):
    """None in narrow cells, none if they are not wanted."""
    assert list(HeatMap(width=5.0, numbers=False).draw(sweep).axes[0].texts) == []
    assert len(HeatMap(width=5.0).draw(sweep).axes[0].texts) == 5
    assert list(HeatMap(width=1.6).draw(sweep).axes[0].texts) == []


def test_caption(sweep):
    """Where a method is best and worst, and how many cells are hatched."""
    caption = HeatMap().caption(sweep)
    assert caption.startswith("Change of MSE against A over Hp of the controller and scale of the uncertainty in %")
    assert "Hatched cells: the simultaneous 95 % interval contains 0." in caption
    assert "(Hp = 5, scale = 2) to +300" in caption.replace("+300.0", "+300")
    assert caption.endswith("2 of 5 cells are hatched.")
    assert HeatMap(show="value").caption(sweep).startswith("Mean MSE in rad^2 over Hp")


@pytest.mark.parametrize(
    ("keys", "message", "key"),
    [
        ({"x": "controller.Hq"}, f"'controller.Hq' is not a known path of the sweep; did you mean '{X}'?", "x"),
        ({"x": X, "y": X}, "must be another path than x", "y"),
        ({"log": True}, "changes may be negative: leave log out, or show the value", "log"),
        ({"order": ["A"]}, "must name a method besides the baseline 'A'", "order"),
        ({"order": ["Q"]}, "'Q' is not a known method; known: A, B", "order"),
    ],
)
def test_errors(sweep, keys, message, key):
    """Each names its key."""
    with pytest.raises(DesignError) as error:
        HeatMap(**keys).draw(sweep)
    assert str(error.value).startswith(message) and error.value.parameter == key


def test_other_numbers_of_paths(make_trials, make_sweep):
    """One path is too few; of three, the third must not change."""
    layout = ResultLayout(methods=("A", "B"), metrics=("mse",), points=({X: "1"}, {X: "2"}))
    assert [str(issue.message) for issue in HeatMap().check(layout)] == [f"two values must be swept (swept: {X})"]
    table = make_trials({"mse": {"A": [1.0, 2.0, 3.0], "B": [2.0, 3.0, 5.0]}})
    grid = make_sweep(*[({X: x, Y: y, "c": c}, table) for x in "12" for y in "12" for c in "12"])
    with pytest.raises(DesignError, match="must name one of the swept paths"):
        HeatMap().draw(grid)
    with pytest.raises(DesignError, match="c changes as well: choose points with `at`"):
        HeatMap(x=X, y=Y).draw(grid)
    figure = HeatMap(x=X, y=Y, at=[{"c": 2}]).draw(grid)
    assert figure.axes[0].get_title() == "B, c=2"
    with pytest.raises(DesignError, match="c differs between these points"):
        HeatMap(x=X, y=Y, at=[{"c": 2}, {"c": 1}]).draw(grid)


def test_a_metric_that_may_not_occur(make_trials, make_sweep):
    """Its value is the median; one of inf has no cell, and no cell at all is an error."""
    info = MetricInfo("t", "s", "lower", may_not_occur=True)
    tables = {
        (x, y): make_trials({"t": {"A": [1.0, 2.0, np.inf] if x == "1" else [np.inf] * 3}}, (info,))
        for x in "12"
        for y in "12"
    }
    sweep = make_sweep(*[({X: x, Y: y}, table) for (x, y), table in tables.items()])
    found, _ = cells(HeatMap(show="value").draw(sweep).axes[0])
    assert set(found) == {(0, 0), (0, 1)}
    with pytest.raises(DesignError, match="no method has a value of t"):
        HeatMap(show="value", at=[{X: 2}]).draw(sweep)


def test_same_bytes(sweep, tmp_path):
    """Drawn twice, saved twice."""
    for stem in ("one", "other"):
        save_as(HeatMap().draw(sweep), tmp_path / f"{stem}.svg")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "other.svg").read_bytes()
