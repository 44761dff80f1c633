"""Every registered figure passes the checks of rmpc_bench.conformance."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calibrated import coverage_trials, errors, of_squares
from data_frames import arrays
from tuned_searches import search, tuning

from rmpc_bench import registry
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.conformance import FigureExample, check_component
from rmpc_bench.types import MetricInfo

KINDS = registry.names("figures")
PARAMETERS = {
    "boxplot": [{}, {"metric": "power", "log": True, "width": 5.0}],
    "coverage": [{}, {"order": ["B"], "width": 5.0}],
    "elements": [{"signal": "Q_yw", "width": 6.0}],
    "ellipses": [{"x": "mse", "y": "power"}],
    "rows": [{}, {"show": ["mean", "share"], "metric": "power", "above": 1.5, "order": ["B"]}],
    "scatter": [
        {"x": "mse", "y": "power"},
        {"x": "y.0", "y": "y.1", "marks": 1.0},
    ],
    "signals": [
        {},
        {"signals": ["x.0", "error", "nees"], "order": ["B"]},
        {"signals": ["tube", "variance.1", "mean", "P.0,0"]},
    ],
    "sweep": [{}, {"metric": "power", "show": "value", "log": True}, {"path": ["controller.Hp", "controller.Hu"]}],
    "tuning": [{}, {"order": ["B"], "width": 5.0}],
}
"""Keys that make a figure of each kind; a new kind gets a line here."""
CASES = [(kind, keys) for kind in KINDS for keys in PARAMETERS.get(kind, [])]
RUNS, STEPS = 6, 20
METRICS = (MetricInfo("mse", "m^2", "lower"), MetricInfo("power", "V^2", "lower"))


@pytest.fixture
def results(make_trials, with_series):
    """Two methods with two metrics, recorded runs, a reported matrix, covariances and ensemble moments."""
    rng = np.random.default_rng(2)
    values = {name: {method: list(rng.uniform(1.0, 2.0, RUNS)) for method in "AB"} for name in ("mse", "power")}
    table, k = make_trials(values, METRICS), np.arange(STEPS + 1.0)
    entries = []
    for method in "AB":
        for i in (0, 1):
            entries += [(method, name, f"{i},{j}", (2.0 + k) * (i == j), 0) for name in ("P", "cov(e)") for j in (0, 1)]
            entries += [(method, name, f"{i}", np.sin(k) + i, 0) for name in ("mean(x)", "mean(x_hat)")]
    sizes = {"y": (2, STEPS + 1), "u": (1, STEPS), "x": (2, STEPS + 1), "x_hat": (2, STEPS + 1), "e": (1, STEPS + 1)}
    sizes |= {"Q_yw": (4, STEPS), "S": (1, STEPS + 1)}
    traces = {
        method: Traces(
            np.arange(RUNS),
            {name: np.abs(rng.standard_normal((RUNS, n_samples, n))) for name, (n, n_samples) in sizes.items()},
            np.zeros((STEPS + 1, 2)),
            {"Q_yw": (2, 2)},
        )
        for method in "AB"
    }
    quantities = pd.DataFrame({"run": np.arange(RUNS), "eps": rng.uniform(-1.0, 1.0, RUNS)})
    searched = [search(method, rng.uniform(size=(5, 4)), rng.uniform(size=(6, RUNS))) for method in "AB"]
    table = replace(with_series(table, *entries), traces=traces, Ts=0.5, quantities=arrays(quantities))
    return FigureExample(table.with_tuning(tuning(*searched)))


def test_every_kind_is_tested():
    """Oracle: the registry."""
    assert sorted(PARAMETERS) == KINDS


@pytest.mark.parametrize(("kind", "keys"), CASES)
def test_conformance(kind, keys, results, make_sweep):
    """Oracle: the rules of a figure."""
    if kind == "sweep":
        results = FigureExample(make_sweep(*[({"controller.Hp": value}, results.results) for value in ("5", "10")]))
    if kind == "coverage":
        rng, recorded = np.random.default_rng(4), results.results
        values = {name: of_squares(errors(rng, RUNS, rho=0.0), 1.0) for name in "AB"}
        results = FigureExample(coverage_trials(values, traces=recorded.traces, over_time=recorded.over_time))
    if "path" in keys:
        grid = [{"controller.Hp": Hp, "controller.Hu": Hu} for Hp in ("5", "10") for Hu in ("1", "2")]
        results = FigureExample(make_sweep(*[(point, results.results) for point in grid]))
    checked = check_component(registry.get("figures", kind)(**keys), results)
    assert [str(result) for result in checked if result.status == "failed"] == []
