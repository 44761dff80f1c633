"""Sets reported by estimators: from the YAML to the metric, the figure and the claim."""

import numpy as np
import pytest
from conftest import ROUND
from scipy import stats
from small_experiment import write

from rmpc_bench import load_config, run
from rmpc_bench.claims.verdict import judge
from rmpc_bench.figures.signals import Signals
from rmpc_bench.types import ConfigError

SYSTEM = "A: [['0.9 + 0.1*sin(k)', 0.2], [0, 0.7]], B: [[1], [0.3]], C: [[0.2, 1]]"
N, RUNS = 15, 8
KEYS = {
    "name": "reported",
    "runs": str(RUNS),
    "time": f"{{steps: {N}}}",
    "uncertainty": None,
    "plant": f"{{kind: linear, {SYSTEM}}}",
    "model": f"{{kind: linear, {SYSTEM}, P_w: 0.25, M_w: [[5, 2], [2, 5]], P_v: 0.25, M_v: 5}}",
    "noise": "{process: {gaussian: {std: 0.8}}, measurement: {gaussian: {std: 1}}}",
    "initial": "{x: {gaussian: {mean: [6, -4], std: 2}}, x_hat: [6, -4], P: 1, M: 4}",
    "reference": None,
    "controller": None,
    "methods": "{KF: {estimator: {kind: kalman}}, ESM: {estimator: {kind: set-membership}}, "
    "MIX: {estimator: {kind: mixed}}}",
    "evaluate": "[runs, ensemble]",
    "record": "{runs: all, signals: [x, x_hat, u]}",
    "metrics": "[inside, {kind: inside, name: sure, level: 50%}, {kind: cost, Q_x: [10, 1], R_u: 1}]",
    "figures": "[{kind: signals, signals: [tube]}]",
    "claims": "[{says: s, source: p, check: 'mean(entry(var(e[KF]), 0)) > 0', finding: confirmed}]",
}


def load(tmp_path, **keys):
    """Load the experiment with some keys replaced."""
    return load_config(write(tmp_path, **(KEYS | keys)))


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Return the trials of the experiment."""
    directory = tmp_path_factory.mktemp("reported")
    return run(load(directory), directory=directory / "out", jobs=1).trials


@pytest.mark.parametrize(("metric", "level"), [("inside", 0.95), ("sure", 0.5)])
def test_every_method_is_judged_by_its_reported_set(trials, metric, level):
    """Oracle: the recorded trajectories and the stored series, M where there is one, else P; k = 0..N-1."""
    for name in trials.methods:
        quantity = "P" if name == "KF" else "M"
        S = trials.matrix_series(quantity, name) * (stats.chi2.ppf(level, 2) if quantity == "P" else 1.0)
        signals = trials.traces[name].signals
        e = (signals["x_hat"] - signals["x"])[:, :N]
        sizes = [[e[i, k] @ np.linalg.solve(S[k], e[i, k]) for k in range(N)] for i in range(RUNS)]
        np.testing.assert_allclose(trials.column(metric, name), (np.array(sizes) <= 1.0).mean(axis=1), **ROUND)
    assert 0.0 < trials.column("sure", "KF").mean() < trials.column("inside", "KF").mean() < 1.0


def test_the_cost_is_that_of_the_recorded_run(trials):
    """Oracle: the recorded states; no input is applied."""
    x = trials.traces["MIX"].signals["x"]
    np.testing.assert_allclose(trials.column("cost", "MIX"), (x[:, 1:] ** 2 @ [10.0, 1.0]).sum(axis=1), **ROUND)


def test_claims_of_the_width_of_the_runs_and_of_the_size_of_sets(trials, tmp_path):
    """Oracle: variances over the runs by NumPy; determinants and traces of the series."""
    x = trials.traces["MIX"].signals["x"]
    e = x - trials.traces["MIX"].signals["x_hat"]
    M = trials.matrix_series("M", "MIX")[1:]
    expected = {
        "mean(entry(var(x[MIX]), 0))": x.var(axis=0, ddof=1)[:, 0].mean(),
        "mean(entry(since(std(e[MIX]), 3), 1))": e.std(axis=0, ddof=1)[3:, 1].mean(),
        "mean(det(since(M[MIX], 1)))": np.linalg.det(M).mean(),
        "mean(trace(since(M[MIX], 1)))": np.trace(M, axis1=1, axis2=2).mean(),
    }
    checks = [f"{text} ~ {float(value)!r} +- {ROUND['rtol'] * float(value)!r}" for text, value in expected.items()]
    entries = [f"{{says: s, source: p, check: '{check}'}}" for check in checks]
    claims = load(tmp_path, claims=f"[{', '.join(entries)}]").claims
    for claim, value in zip(claims, expected.values(), strict=True):
        verdict = judge(claim, trials)
        assert verdict.comparisons[0].left == pytest.approx(value, rel=ROUND["rtol"]), claim.check
        # The runs do not know a variance to rounding; the sets of the design are exact.
        assert verdict.finding == ("confirmed" if "M[MIX]" in claim.check[0] else "inconclusive")


def test_tubes_of_real_trials(trials):
    """A column per method that reports a set or a covariance, a row per state."""
    assert len(Signals(signals=["tube"]).draw(trials).axes) >= 4


@pytest.mark.parametrize(
    ("metric", "path", "message"),
    [
        (
            "{kind: inside, of: set}",
            "metrics.0.of",
            "needs the set M of the estimate, which the estimator of 'KF' does",
        ),
        ("{kind: inside, of: gaussian}", "metrics.0.of", "needs the covariance P of the estimate, which the estimator"),
        ("{kind: inside, level: 100%}", "metrics.0.level", "must be < 1"),
        ("{kind: cost, Q_x: [1, 2, 3], R_u: 1}", "metrics.0.Q_x", "shape (3,) does not fit"),
        ("{kind: cost, Q_x: 1}", "metrics.0", "'R_u' is missing"),
        ("{kind: certificate, at: 3}", "metrics.0", "needs a controller that certifies its cost, such as minimax-lq"),
    ],
)
def test_what_no_method_could_answer(tmp_path, metric, path, message):
    """Refused at load, at its place."""
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, metrics=f"[{metric}]", claims="[]")
    (problem,) = caught.value.problems
    assert problem.path == path and message in problem.message
