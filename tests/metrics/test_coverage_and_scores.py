"""Coverage, CRPS and log score against plain loops, SciPy, quadrature and closed forms; what is refused."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, SOLVER, within_stat
from metrics.estimate_records import LAYOUT, NX, N, method, plant, trajectories
from metrics.issue_checks import no_issue, only_issue
from scipy import integrate, stats

from rmpc_bench.metrics.consistency import Coverage, Crps, LogScore, Nees
from rmpc_bench.simulation.recording import Recorder
from rmpc_bench.types import Record

WINDOWS = (({}, range(0, N)), ({"to": "N"}, range(0, N + 1)), ({"from_": 1.0, "to": 1.5}, range(2, 4)))


def errors(block, i, k):
    """Error and reported covariance of a run at a sample."""
    return block.x_hat[i, k] - block.x[i, k], block.P[i, k] if block.P.ndim == 4 else block.P[k]


def averages(block, samples, of_one):
    """Average of a function of error and covariance over the samples of every run."""
    return [np.mean([of_one(*errors(block, i, k)) for k in samples]) for i in range(len(block.x))]


@pytest.mark.parametrize("per_run", [False, True])
def test_coverage_against_plain_loops(per_run, rng):
    """Oracle: loops with a linear solve, and quantiles of scipy.stats."""
    block = trajectories(rng, 40, per_run=per_run)
    block = block._replace(P=8.0 * block.P)
    for level in (0.5, 0.9):
        inner, width = stats.chi2.ppf(level, NX), stats.norm.ppf((1 + level) / 2)
        for bounds, samples in WINDOWS:
            joint = averages(block, samples, lambda e, P, limit=inner: e @ np.linalg.solve(P, e) <= limit)
            np.testing.assert_allclose(Coverage(level=level, **bounds).evaluate(block), joint, **ROUND)
            second = averages(block, samples, lambda e, P, z=width: abs(e[1]) <= z * np.sqrt(P[1, 1]))
            found = Coverage(level=level, of="x.1", **bounds).evaluate(block)
            np.testing.assert_allclose(found, second, **ROUND)
            assert 0 < np.mean(joint) < 1 and 0 < np.mean(second) < 1


@pytest.mark.parametrize("per_run", [False, True])
def test_log_score_is_that_of_scipy(per_run, rng):
    """Oracle: scipy.stats.multivariate_normal, which takes another decomposition (condition 10)."""
    block = trajectories(rng, per_run=per_run)
    for bounds, samples in WINDOWS:
        wanted = averages(block, samples, lambda e, P: -stats.multivariate_normal(cov=P).logpdf(e))
        np.testing.assert_allclose(LogScore(**bounds).evaluate(block), wanted, **ROUND)


def crps(e, sd):
    """CRPS by its definition: the integral of (F(t) - 1{t >= x})^2, here with x = 0."""
    law = stats.norm(e, sd)
    below = integrate.quad(lambda t: law.cdf(t) ** 2, e - 12 * sd, 0.0, epsabs=1e-13, limit=200)[0]
    above = integrate.quad(lambda t: law.sf(t) ** 2, 0.0, e + 12 * sd, epsabs=1e-13, limit=200)[0]
    return below + above


@pytest.mark.parametrize("per_run", [False, True])
def test_crps_is_the_integral_of_its_definition(per_run, rng):
    """Oracle: quadrature of the definition of the score."""
    block = trajectories(rng, 2, per_run=per_run)
    wanted = averages(block, range(0, N), lambda e, P: crps(e[2], np.sqrt(P[2, 2])))
    np.testing.assert_allclose(Crps(of="x.2").evaluate(block), wanted, **SOLVER)


@pytest.mark.parametrize("s", [0.5, 1.0, 1.5])
def test_coverage_of_a_scaled_covariance(s, rng):
    """Oracle: two states, P times s^2: 1 - (1 - p)^(s^2)."""
    P = np.array([[2.0, 0.6], [0.6, 0.5]])
    e = rng.multivariate_normal(np.zeros(2), P, (4000, 6))
    block = Record(
        1.0, np.zeros(e.shape), e[..., :1], e, np.zeros((4000, 5, 1)), e[0, :, :1], np.tile(s**2 * P, (6, 1, 1))
    )
    for level in (0.5, 0.9, 0.95):
        assert within_stat(Coverage(level=level).evaluate(block), 1 - (1 - level) ** s**2)
        inside = 2 * stats.norm.cdf(s * stats.norm.ppf((1 + level) / 2)) - 1
        assert within_stat(Coverage(level=level, of="x.1").evaluate(block), inside)


def one(metric, e, P, x=None):
    """Value of one run with one error at both samples."""
    x = np.tile(np.zeros(len(e)) if x is None else np.asarray(x, dtype=float), (1, 2, 1))
    y = np.zeros((1, 2, 1))
    P = np.tile(np.asarray(P, dtype=float), (2, 1, 1))
    return metric.evaluate(Record(1.0, x, y, x + np.asarray(e, dtype=float), np.zeros((1, 1, 1)), y[0], P))[0]


FLAT = [[9.0, 9.0], [9.0, 9.0]]


@pytest.mark.parametrize(
    ("e", "P", "joint", "second"),
    [
        ([4.9, 4.9], FLAT, 1, 1),  # rank 1: the quantile is 1.64^2 = 2.71, that of two degrees is 4.61
        ([5.0, 5.0], FLAT, 0, 0),
        ([3.0, 3.1], FLAT, 0, 1),  # beside the range
        ([1.0, 0.0], [[1.0, 0.0], [0.0, 0.0]], 1, 1),
        ([1.0, 1e-3], [[1.0, 0.0], [0.0, 0.0]], 0, 0),
        ([0.0, 0.0], np.zeros((2, 2)), 1, 1),
        ([0.0, 1.0], np.zeros((2, 2)), 0, 0),
        ([0.5, 0.5], [[1.0, 0.0], [0.0, -1.0]], 0, 0),  # not a covariance
        ([0.5, 0.5], [[1.0, 0.2], [0.0, 1.0]], 1, 1),  # not symmetric: its symmetric part counts
        ([0.5, 0.5], [[np.nan, 0.0], [0.0, 1.0]], np.nan, 1),
        ([0.5, 0.5], [[1.0, 0.0], [0.0, np.inf]], np.nan, np.nan),
        ([0.5, np.nan], np.eye(2), np.nan, np.nan),
    ],
)
def test_singular_and_invalid_covariances(e, P, joint, second):
    """Oracle: by hand."""
    np.testing.assert_equal(one(Coverage(), e, P), joint)
    np.testing.assert_equal(one(Coverage(of="x.1"), e, P), second)


def test_scores_of_singular_covariances():
    """Oracle: without variance CRPS is the distance, and a density does not exist."""
    assert one(Crps(of="x.1"), [0.0, -2.5], [[1.0, 0.0], [0.0, 0.0]]) == 2.5
    assert one(LogScore(), [3.0, 3.0], FLAT) == np.inf
    assert one(LogScore(), [0.0, 0.0], [[1.0, 0.0], [0.0, -1.0]]) == np.inf
    assert np.isnan(one(LogScore(), [0.0, np.nan], np.eye(2)))
    np.testing.assert_allclose(one(Crps(of="x.0"), [1e300], [[1e-300]]), 1e300, **ROUND)


def test_rounding_of_a_certain_state_is_covered():
    """Oracle: 1e-10 beside 1e6 is rounding of doubles, beside 1e-3 it is not."""
    for metric in (Coverage(), Coverage(of="x.1")):
        assert one(metric, [0.1, 1e-10], [[1.0, 0.0], [0.0, 0.0]], x=[0.0, 1e6]) == 1
        assert one(metric, [0.1, 1e-10], [[1.0, 0.0], [0.0, 0.0]], x=[0.0, 1e-3]) == 0


METRICS = (Coverage(), Coverage(of="x.0", level=0.5), Crps(of="x.0"), LogScore())


@pytest.mark.parametrize("metric", METRICS)
def test_samples_with_a_covariance_count_from_twenty_on(metric, rng):
    """Oracle: the record cut to the samples that have a P."""
    block = trajectories(rng, 3, n_steps=60, per_run=True)
    gappy = block.P.copy()
    gappy[:, ::2] = np.nan
    gappy[0, 38:] = np.nan  # 19 samples are left
    there = block._replace(P=block.P[:, 1:60:2], x=block.x[:, 1:60:2], x_hat=block.x_hat[:, 1:60:2], u=block.u[:, :30])
    there = there._replace(experiment=LAYOUT._replace(n_steps=29))
    found = metric.evaluate(block._replace(P=None, gappy_P=gappy))
    wanted = type(metric)(**{**vars(metric), "to": "N"}).evaluate(there)
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1:], wanted[1:], **ROUND)


@pytest.mark.parametrize("metric", METRICS)
def test_a_method_without_P_has_no_value_and_runs_do_not_affect_each_other(metric, rng):
    """Oracle: a row of a block equals the row alone, and what metrics share changes no bit."""
    block = trajectories(rng, 5, per_run=True)
    assert np.isnan(metric.evaluate(block._replace(P=None))).all()
    alone = [
        metric.evaluate(block._replace(x=x[None], x_hat=x_hat[None], P=P[None]))[0]
        for x, x_hat, P in zip(block.x, block.x_hat, block.P, strict=True)
    ]
    shared = block._replace(shared={})
    Nees().evaluate(shared), LogScore().evaluate(shared)
    for found in (metric.evaluate(block), metric.evaluate(shared)):
        np.testing.assert_allclose(found, alone, **EXACT)


def test_what_is_refused_before_a_run():
    """Oracle: the words of the checks; one method with P is enough."""
    layout = LAYOUT._replace(plant=plant(2))
    with_P, without = method(2, P=np.eye(2)), method(2, name="B")
    for metric in (Coverage(of="x.1"), LogScore(), Crps(of="x.0")):
        no_issue(metric, layout._replace(methods=(with_P, without)))
        only_issue(metric, layout._replace(methods=(without,)), "", "no method reports a covariance P")
    both = layout._replace(methods=(with_P,))
    only_issue(Coverage(of="x.2"), both, "of", r"there is no x\.2: choose x\.0 to x\.1")
    only_issue(Coverage(of="y.0"), both, "of", r"must be joint or x\.I")
    only_issue(Crps(of="joint"), both, "of", "must be x")
    assert Crps(of="x.0").info(layout).direction == "lower" and Coverage().info(layout).direction == "higher"


def test_a_recorder_keeps_covariances_with_gaps():
    """Oracle: a series with a gap is none for other metrics; NaN stands at the gap."""
    for at, per_run in ((0, False), (1, True), (2, False)):
        recorder = Recorder(3)
        for k in range(3):
            value = np.full((2, 1, 1), k + 1.0) if per_run else np.full((1, 1), k + 1.0)
            recorder.matrix_at(k, "P", None if k == at else value)
        assert recorder.matrix("P") is None
        wanted = np.where(np.arange(3) == at, np.nan, np.arange(3) + 1.0)
        found = recorder.matrix("P", gappy=True)
        np.testing.assert_allclose(found[..., 0, 0], np.tile(wanted, (2, 1)) if per_run else wanted, **EXACT)
    assert Recorder(3).matrix("P", gappy=True) is None
