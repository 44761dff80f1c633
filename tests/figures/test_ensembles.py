"""Means and variances of the ensemble, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest

from rmpc_bench.figures.line_styles import paler
from rmpc_bench.figures.means import Means
from rmpc_bench.figures.style import COLOURS
from rmpc_bench.types import DesignError


def means(trials, **keys):
    return Means(**keys).draw(trials)


THREE = {"mse": {"A": [1.0, 2.0], "B": [2.0, 3.0], "C": [3.0, 4.0]}}
K = np.arange(31.0)
BLACK = "#000000"


def variance(method, i):
    return 4.0 + ("AB".index(method) + 1) * (i + 1) * K


def rough(values):
    return values * (1 + 0.1 * (-1.0) ** K)


def x_hat(method, i):
    return np.sin(K / 5) + i + "AB".index(method)


@pytest.fixture
def trials(make_trials, with_series):
    """Two methods with moments and P, that of A constant; exact and from 500 runs; C has none."""
    entries = []
    for method in "AB":
        for i in (0, 1):
            entries += [(method, "cov(e)", f"{i},{j}", variance(method, i) * (i == j), 0) for j in (0, 1)]
            entries += [(method, "cov(e)", f"{i},{i}", rough(variance(method, i)), 500)]
            entries += [(method, "P", f"{i},{i}", [9.0 + i] if method == "A" else 9.0 + i + K, 0)]
            entries += [(method, "mean(x)", f"{i}", K + i, 0), (method, "mean(x)", f"{i}", rough(K + i), 500)]
            entries += [(method, "mean(x_hat)", f"{i}", x_hat(method, i), 0)]
            entries += [(method, "mean(x_hat)", f"{i}", rough(x_hat(method, i)), 500)]
    return with_series(make_trials(THREE, labels={"B": "robust"}), *entries)


def only(trials, keep):
    """The table with the rows that `keep` says."""
    return replace(trials, series=trials.series[keep(trials.series)])


def drawn(figure, panel, color, **wanted):
    """Values of the lines of a panel that have a colour and these properties, those below first."""
    lines = [line for line in figure.axes[panel].lines if line.get_color() == color]
    lines = [line for line in lines if all(getattr(line, f"get_{name}")() == value for name, value in wanted.items())]
    return [np.array(line.get_xydata()) for line in sorted(lines, key=lambda line: line.get_zorder())]


def legend(figure):
    """Texts of the legend, without the empty ones that end a row."""
    return [text for text in (text.get_text() for text in figure.legends[0].get_texts()) if text]


def sample(figure, text):
    """The line that stands for a text of the legend."""
    (legend,) = figure.legends
    return next(
        line for line, each in zip(legend.get_lines(), legend.get_texts(), strict=True) if each.get_text() == text
    )


def test_means(trials):
    """The true state is black and one for all methods; exact, and paler from runs."""
    figure = means(trials)
    for i in (0, 1):
        (pale,), (black,) = drawn(figure, i, paler(BLACK)), drawn(figure, i, BLACK)
        assert np.array_equal(black[:, 1], K + i) and np.array_equal(pale[:, 1], rough(K + i))
        for color, method in zip(COLOURS, "AB", strict=False):
            (pale,), (solid,) = drawn(figure, i, paler(color)), drawn(figure, i, color)
            assert np.array_equal(solid[:, 1], x_hat(method, i)) and np.array_equal(pale[:, 1], rough(x_hat(method, i)))
    assert sorted(legend(figure)) == ["A", "exact", "from 500 runs", "robust", "true state"]
    assert sample(figure, "true state").get_color() == BLACK
    assert [axes.get_ylabel() for axes in figure.axes] == ["mean $x_0$", "mean $x_1$"]


@pytest.mark.parametrize(("factor", "n_true"), [(1 + 1e-13, 1), (1.5, 2)])
def test_a_true_state_of_every_method(trials, factor, n_true):
    """Under feedback it depends on the method: dotted; a difference by rounding, or by chance in the runs, is none."""
    series = trials.series.copy()
    its = (series["method"] == "B") & (series["quantity"] == "mean(x)")
    series.loc[its & (series["n"] == 0), "value"] *= factor
    series.loc[its & (series["n"] > 0), "value"] *= 1.1
    figure = means(replace(trials, series=series))
    dotted = [line[:, 1] for color in COLOURS for line in drawn(figure, 0, color, linestyle="--")]
    assert "true state" in legend(figure)
    if n_true == 1:
        assert len(drawn(figure, 0, BLACK)) == 1 and not dotted
    else:
        assert drawn(figure, 0, BLACK) == [] and np.array_equal(dotted, [K, 1.5 * K])
        assert sample(figure, "true state").get_linestyle() == "--"


def test_exact_of_one_method_only(trials):
    """The other one is marked in the legend."""
    figure = means(only(trials, lambda table: (table["n"] > 0) | (table["method"] == "A")))
    assert sorted(legend(figure)) == ["A", "exact", "from 500 runs", "robust (from 500 runs)", "true state"]


@pytest.mark.parametrize(
    ("figure", "given", "message"),
    [
        (means, {"component": 2}, "there is no state 2 (they count from 0 to 1)"),
        (means, {"order": ["C"]}, "'C' has no mean(x), mean(x_hat) (those that have: A, B)"),
        (means, {"from_": 30.0}, "fewer than two samples lie between `from` and `to` (there are 0 to 30)"),
        (means, {"width": 0.5}, "must be at least 1 inch (got 0.5)"),
    ],
)
def test_errors_show_the_choices(trials, figure, given, message):
    """A figure that cannot be drawn is left out with a reason."""
    with pytest.raises(DesignError) as error:
        figure(trials, **given)
    assert str(error.value) == message and error.value.parameter in {name.rstrip("_") for name in given}
