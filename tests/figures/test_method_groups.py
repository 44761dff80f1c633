"""Files of every kind: same bytes, any name of a method, and groups of a method, by which a page can hide it."""

import re
from dataclasses import replace
from itertools import product
from xml.etree import ElementTree

import numpy as np
import pytest

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.figures.boxplot import Boxplot
from rmpc_bench.figures.elements import Elements
from rmpc_bench.figures.ellipses import Ellipses
from rmpc_bench.figures.files import save_as
from rmpc_bench.figures.rows import Rows
from rmpc_bench.figures.scatter import Scatter
from rmpc_bench.figures.signals import Signals
from rmpc_bench.figures.sweep import Sweep
from rmpc_bench.types import DesignError, MetricInfo

METHODS = ("A", "B")
N, RUNS = 8, 20
FLAT = MetricInfo("length", "m", "lower"), MetricInfo("power", "W", "lower")


@pytest.fixture
def point(make_trials, with_series):
    """Two methods with metrics, moments, covariances and recorded runs."""
    rng = np.random.default_rng(1)
    base = np.exp(rng.normal(size=RUNS))
    columns = {"A": list(base), "B": list(0.5 * base * np.exp(0.1 * rng.normal(size=RUNS)))}
    table = make_trials({"length": columns, "power": {"A": columns["B"], "B": columns["A"]}}, FLAT)
    entries = []
    for name, i in product(METHODS, (0, 1)):
        entries += [(name, f"mean({signal})", f"{i}", rng.normal(size=N + 1), 0) for signal in ("x", "x_hat")]
        entries += [(name, "P", f"{i},{j}", [1.0 if i == j else 0.2], 0) for j in (0, 1)]
    x = rng.normal(size=(RUNS, N + 1, 2)).cumsum(axis=1)
    signals = {name: {"x": x, "x_hat": x + rng.normal(size=x.shape), "S": x[:, :, [0, 1, 1, 0]]} for name in METHODS}
    shapes = {"S": (2, 2)}
    traces = {name: Traces(np.arange(RUNS), each, np.zeros((N + 1, 1)), shapes) for name, each in signals.items()}
    return replace(with_series(table, *entries), traces=traces, Ts=0.5)


@pytest.fixture
def sweep(make_sweep, point):
    return make_sweep(*[({"plant.a": text}, replace(point, traces={})) for text in ("1", "2", "3")])


FIGURES = {
    "boxplot": Boxplot(),
    "rows": Rows(),
    "scatter": Scatter(x="length", y="power"),
    "paths": Scatter(x="x.0", y="x.1"),
    "ellipses": Ellipses(x="length", y="power"),
    "signals": Signals(signals=["x.0", "tube", "error", "nees"]),
    "elements": Elements(signal="S"),
    "changes of a sweep": Sweep(),
    "values of a sweep": Sweep(show="value"),
}
NAMES = ("$Q'Q$", "$x_{k|k}$", "n" * 60, "long " * 12, 'it\'s "quoted"', "<b>", "a$b", "5 %")


def without_method(file, name):
    """Return the SVG without the groups of a method and without definitions, which draw nothing themselves."""
    tree = ElementTree.fromstring(file.read_text(encoding="utf-8"))
    for parent in [*tree.iter()]:
        for child in list(parent):
            if child.get("data-method") == name or child.tag.endswith("defs"):
                parent.remove(child)
    return ElementTree.tostring(tree, encoding="unicode")


@pytest.mark.parametrize("name", FIGURES)
def test_nothing_of_a_hidden_method_is_left(tmp_path, point, sweep, name):
    """Neither its colour nor its name in a legend or beside an axis; the other method stays.

    Drawn twice, a figure has the same bytes.
    """
    for number in (1, 2):
        figure = FIGURES[name].draw(sweep if "sweep" in name else point)
        for ending in ("svg", "pdf"):
            save_as(figure, tmp_path / f"{number}.{ending}")
    for ending in ("svg", "pdf"):
        assert (tmp_path / f"1.{ending}").read_bytes() == (tmp_path / f"2.{ending}").read_bytes()
    left = without_method(tmp_path / "1.svg", "B")
    assert "var(--m2)" not in left
    assert "var(--m1)" in left or name in ("rows", "boxplot", "changes of a sweep")
    texts = re.findall(r">\s*(?:<[^>]*tspan[^>]*>)?([^<>\s][^<>]*)<", left)
    assert not [text for text in texts if text.strip() in ("B", "B (exact)")]


@pytest.mark.parametrize("name", FIGURES)
def test_what_a_check_finds_is_an_error_of_drawing(point, sweep, name):
    """`test_checks` has what each kind of figure requires."""
    for key, value, words in (
        ("order", ["D"], "'D' is not a known method"),
        ("height", 0.5, "must be at least 1 inch"),
    ):
        with pytest.raises(DesignError, match=words) as error:
            replace(FIGURES[name], **{key: value}).draw(sweep if "sweep" in name else point)
        assert error.value.parameter == key


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["rows", "boxplot", "lines", "cells"])
def test_any_name_of_a_method_can_be_drawn(tmp_path, make_trials, make_sweep, kind, name):
    table = make_trials({"length": {"A": [1.0, 2.0, 3.0], name: [1.1, 2.5, 2.9]}}, FLAT[:1])
    path, texts = ("plant.a", "12") if kind == "lines" else ("name", "pq")
    trials = make_sweep(*[({path: text}, table) for text in texts]) if kind in ("lines", "cells") else table
    figure = {"rows": Rows(), "boxplot": Boxplot()}.get(kind, Sweep()).draw(trials)
    for ending in ("svg", "pdf"):
        save_as(figure, tmp_path / f"a.{ending}")
    assert "<b>" not in (tmp_path / "a.svg").read_text(encoding="utf-8")
