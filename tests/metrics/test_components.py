"""Metrics of some components: `only` and `scale`, names, units, and what is said where units are mixed."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROUND
from metrics.issue_checks import no_issue, only_issue
from small_experiment import cli

from rmpc_bench import load_config, load_trials
from rmpc_bench.metrics.consistency import Nees
from rmpc_bench.metrics.departures import Departures
from rmpc_bench.metrics.estimation import EstimationMse
from rmpc_bench.metrics.innovation import InnovationMse, Nis, Whiteness
from rmpc_bench.metrics.input import InputPeak, InputPower, InputRms, InputRoughness, InputVariation
from rmpc_bench.metrics.runaway import Runaway
from rmpc_bench.metrics.tracking import Iae, Mae, Mse, Rmse, SettlingTime, SteadyStateError, Tracking
from rmpc_bench.plants.linear import design as linear
from rmpc_bench.simulation.closed_loop import metric_remarks
from rmpc_bench.types import ConfigError, MetricLayout, Record

A = np.diag([0.9, 0.8])
PLANT = linear(0.5, 2, A=A.tolist(), B=np.eye(2).tolist(), C=np.eye(2).tolist())


class Reactor(type(PLANT)):
    """Names and units as in the issue."""

    names = {"x.0": "CA", "x.1": "T", "y.0": "CA", "y.1": "T", "u.0": "F", "u.1": "Tc"}
    units = {"x.0": "mol/l", "x.1": "K", "y.0": "mol/l", "y.1": "K", "u.0": "l/min", "u.1": "K"}


REACTOR = object.__new__(Reactor)
REACTOR.__dict__.update(vars(PLANT))
LAYOUT = MetricLayout(2, plant=REACTOR)
ERRORS = np.array([[0.1, 4.0], [0.3, 2.0], [9.0, 9.0]])
RECORD = Record.of_run(x=np.zeros((3, 2)), x_hat=ERRORS, u=np.ones((2, 2)))._replace(experiment=LAYOUT)
P = np.array([[0.04, 0.1], [0.1, 4.0]])


@pytest.mark.parametrize(
    ("metric", "value", "unit"),
    [
        (EstimationMse(), 5.025, ""),
        (EstimationMse(only=["CA"]), 0.05, "(mol/l)^2"),
        (EstimationMse(only=[1]), 10.0, "K^2"),
        (EstimationMse(scale={"CA": 0.1, "T": 2.0}), 3.75, ""),
        (EstimationMse(scale=[0.1, 2.0]), 3.75, ""),
        (EstimationMse(only=["T"], scale={"T": 2.0}), 2.5, ""),
        (Rmse(of="estimate", only=["T"]), 10.0**0.5, "K"),
        (Nees(only=["CA"]), 1.25, ""),
    ],
)
def test_values_of_the_issue(metric, value, unit):
    """Oracle: the numbers of the page, errors CA .1, .3 and T 4, 2; two more by hand."""
    no_issue(metric, LAYOUT._replace(methods=()))
    record = RECORD._replace(P=np.broadcast_to(P, (3, 2, 2)))
    np.testing.assert_allclose(metric.evaluate(record), [value], **ROUND)
    assert metric.unit(LAYOUT) == unit


METRICS = [
    *(Mse(), Rmse(), Mae(), Iae(), SteadyStateError(), Tracking(), Tracking(norm="peak"), Departures(size=1.0)),
    *(Mse(of="estimate"), Mae(of="state"), EstimationMse(), SettlingTime(band=3.0), Runaway(beyond=1.0)),
    *(InputPower(), InputRoughness(), InputVariation(), InputRms(), InputPeak()),
    *(InnovationMse(), Nis(), Whiteness(lags=2)),
]


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: f"{metric.name}-{getattr(metric, 'of', '')}")
@pytest.mark.parametrize("components", [[1], [2, 0]])
def test_it_is_the_metric_of_the_other_record(metric, components, rng):
    """Oracle: a record that has these components only, and divided ones; components that do not count are NaN."""
    n_runs, N = 3, 30
    y, x, x_hat = rng.standard_normal((3, n_runs, N + 1, 3))
    r, u = rng.standard_normal((N + 1, 3)), rng.standard_normal((n_runs, N, 3))
    e, S = rng.standard_normal((n_runs, N + 1, 3)), rng.standard_normal((n_runs, N + 1, 3, 3))
    S = S @ S.swapaxes(-1, -2) + np.eye(3)
    scale = [2.0, 0.5][: len(components)]

    def record(indices, divisors):
        parts = [each[..., indices] / divisors for each in (x, y, x_hat, u, r)]
        info = {"e": e[..., indices] / divisors, "S": S[..., indices, :][..., indices].reshape(n_runs, N + 1, -1)}
        return Record(0.5, *parts, info=info, experiment=MetricLayout(N))

    hidden = [i for i in range(3) if i not in components]
    for each in (x, y, x_hat, u):
        each[..., hidden] = np.nan
    whole = record([0, 1, 2], np.ones(3))
    given = replace(metric, only=components).evaluate(whole)
    np.testing.assert_allclose(given, metric.evaluate(record(components, np.ones(len(components)))), **ROUND)
    assert not np.isnan(given).any()
    if hasattr(metric, "scale"):
        given = replace(metric, only=components, scale=scale).evaluate(whole)
        np.testing.assert_allclose(given, metric.evaluate(record(components, np.array(scale))), **ROUND)


@pytest.mark.parametrize(
    ("metric", "key", "message"),
    [
        (Mse(only=["Tc"]), "only", "'Tc' is not a known output; did you mean 'T'"),
        (Mse(only=[2]), "only", "there is no y.2: the plant has 2 outputs"),
        (EstimationMse(only=[]), "only", "must name a state, and each one once"),
        (InputPower(only=["F", 0]), "only", "must name an input, and each one once"),
        (Mse(scale={"CA": 1.0}), "scale", "has no number for T"),
        (Mse(scale={"CA": 1.0, "T": 1.0}, only=["T"]), "scale", "'CA' is not a known output"),
        (Mse(scale={"CA": 1.0, "T": 1.0, "y.0": 2.0}), "scale", "must name each output once"),
        (Mse(scale=[1.0]), "scale", "has 1 entries, and 2 components count"),
        (Tracking(scale=[1.0, 1.0], unit_="mm"), "unit", "a scaled error has no unit"),
    ],
)
def test_what_cannot_be_chosen(metric, key, message):
    """Oracle: the rules of the keys."""
    only_issue(metric, LAYOUT, key, message)


def test_remark_on_units():
    """Oracle: the sentence of the page; its share by hand: 20 of 20.1."""
    text = EstimationMse().remark(RECORD, LAYOUT)
    assert text == (
        "estimation_mse adds squares of mol/l and K; T makes 99.5 % of it in the first run: use `only` or `scale`"
    )
    assert Rmse(of="estimate").remark(RECORD, LAYOUT).startswith("rmse adds squares of mol/l and K; T makes 99.5 % ")
    assert Mae(of="estimate").remark(None, LAYOUT) == "mae adds sizes of mol/l and K: use `only` or `scale`"
    for metric in (InputPeak(), Tracking(norm="peak"), Tracking(norm="bias")):
        units = "l/min and K" if isinstance(metric, InputPeak) else "mol/l and K"
        text = f"{metric.name} is the largest of sizes in {units}: use `only` or `scale`"
        assert metric.remark(RECORD, LAYOUT) == text
    for metric in (EstimationMse(only=["T"]), EstimationMse(scale=[1.0, 1.0]), Nees(), SettlingTime(), Departures()):
        assert metric.remark(RECORD, LAYOUT) == ""


TEXT = """
version: 1
name: reactor
runs: 3
time: {step: 0.1, steps: 20}
plant:
  ode: reactor.py:rhs
  output: reactor.py:output
  states: {CA: mol/l, T: K}
  inputs: {Tc: K}
  outputs: {C_m: mol/l, T_m: K}
model: {linearise: plant, at: {x: [0, 0], u: 0}, noise: {process: [1e-4, 0.1], measurement: [1e-2, 1]}}
noise: same
initial: {x: [0.1, 5], P: [0.01, 4]}
methods: {KF: {estimator: {kind: kalman}}}
metrics: METRICS
figures: []
"""
RHS = """
def rhs(x, u, p):
    return [-x[0] + 0.01 * x[1], -0.5 * x[1] + u[0]]


def output(x, p):
    return [x[0], x[1]]
"""


def written(folder, metrics):
    """File of the experiment."""
    (folder / "reactor.py").write_text(RHS, encoding="utf-8")
    path = folder / "reactor.yaml"
    path.write_text(TEXT.replace("METRICS", metrics), encoding="utf-8")
    return path


def test_names_units_and_the_line_under_the_table(tmp_path):
    """Default names have the components; stored values are those of the configuration, by an index or a name."""
    metrics = (
        "[estimation_mse, {kind: estimation_mse, only: [CA]}, {kind: nees, only: [T]}, {kind: mse, only: [T_m]}, "
        "{kind: estimation_mse, only: [0, T], name: both}, {kind: estimation_mse, name: own, only: [1]}]"
    )
    path = written(tmp_path, metrics)
    config = load_config(path)
    infos = [(info.name, info.unit) for info in config.experiment.metric_infos]
    assert infos == [
        ("estimation_mse", ""), ("estimation_mse_CA", "(mol/l)^2"), ("nees_T", ""), ("mse_T_m", "K^2"),
        ("both", ""), ("own", "K^2"),
    ]  # fmt: skip
    again = load_config(path, overrides=["metrics=[{kind: estimation_mse, only: [CA]}]"])
    assert again.resolved["metrics"] == [{"kind": "estimation_mse", "name": "estimation_mse_CA", "only": ["CA"]}]
    shown = " ".join(cli("check", path).stdout.split())
    words = (
        r"estimation_mse adds squares of mol/l and K; T makes [\d.]+ % of it in the first run: use `only` or `scale`"
    )
    assert re.search(words, shown) and "both adds squares" in shown
    result = cli("run", path, "-o", tmp_path / "out", "--jobs", "1")
    assert result.exit_code == 0, result.stderr
    summary = (tmp_path / "out" / "tables" / "summary.md").read_text(encoding="utf-8")
    assert re.search(words, summary) and re.search(words, " ".join((result.stdout + result.stderr).split()))
    trials = load_trials(tmp_path / "out")
    rows = [{name: trials.column(name, "KF")[run] for name, _ in infos} for run in range(3)]
    for row in rows:
        np.testing.assert_allclose(row["estimation_mse"], (row["estimation_mse_CA"] + row["own"]) / 2, **ROUND)
        assert row["both"] == row["estimation_mse"]
    share = float(re.search(r"T makes ([\d.]+) %", summary)[1])
    # The sentence has three digits.
    np.testing.assert_allclose(share, 100 * rows[0]["own"] / (2 * rows[0]["estimation_mse"]), rtol=5e-3)


def test_the_sentence_of_a_law_that_knows_a_delay(tmp_path):
    """The run behind it has the reference over the delay, too: r(k)..r(k+4+Hp)."""
    path = written(tmp_path, "[estimation_mse]")
    noise, law = "{process: same, measurement: same, input: {delayed: 4}}", "{kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 0.1}"
    text = path.read_text(encoding="utf-8").replace("noise: same", f"noise: {noise}\ncontroller: {law}")
    path.write_text(text, encoding="utf-8")
    [text] = metric_remarks(load_config(path).experiment)
    assert re.search(r"T makes [\d.]+ % of it in the first run", text)


def test_the_old_word_is_refused_with_the_new_one(tmp_path):
    """`components` of earlier versions; trials that were stored with it are found under the same hash."""
    with pytest.raises(
        ConfigError, match=r"metrics.0.components: 'components' is not a known key; did you mean 'only'"
    ):
        load_config(written(tmp_path, "[{kind: tracking, components: [1]}]"))
    config = load_config(written(tmp_path, "[{kind: tracking, only: [1]}]"))
    data = config.points[0].metrics["tracking_1"]
    assert json.loads(json.dumps(data))["components"] == [1] and "only" not in data
