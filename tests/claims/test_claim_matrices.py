"""Excess and distance against SciPy, the definition and hand calculation; lists of columns and of series."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg, stats

from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import parse_expression
from rmpc_bench.claims.values import Value, distance, excess
from rmpc_bench.claims.verdict import judge

RNG = np.random.default_rng(4)
K, RUNS = 5, 40
CENTRE = np.array([1.0, -2.0])
X = CENTRE + RNG.normal(size=(RUNS, 2)) @ [[1.0, 0.4], [0.0, 0.8]]


def covariances(n):
    """Random covariances, one for every k."""
    root = RNG.normal(size=(K, n, n))
    return root @ root.swapaxes(1, 2)


P, Q, R = covariances(2), covariances(2), covariances(3)


@pytest.fixture
def trials(make_trials):
    """Two columns of final states, series of matrices P, Q (2 x 2) and R (3 x 3), two scalar ones, and moments."""
    tables = {"P": P, "Q": Q, "R": R, "v": 1.0 + np.arange(K), "w": np.arange(K) / 2}
    tables |= {"mean(x_hat)": np.tile(CENTRE, (K, 1)), "asymmetric": P + [[0, 1], [0, 0]], "short": P[:2]}
    rows = [
        ("A", name, ",".join(map(str, index)), k, 0, float(value[index]))
        for name, values in tables.items()
        for k, value in enumerate(values)
        for index in np.ndindex(value.shape)
    ]
    return make_trials({"x0_end": {"A": X[:, 0]}, "x1_end": {"A": X[:, 1]}}, rows)


def value(text, trials):
    """Evaluate one expression."""
    node = parse_expression(text)
    return Evaluator(trials, node).value(node)


def number(text, trials):
    """Evaluate one number."""
    return float(value(text, trials).array)


def largest(a, b):
    """Return the largest generalised eigenvalue by SciPy."""
    return linalg.eigh(a, b, eigvals_only=True)[-1]


def test_excess_of_series_is_scipys(trials):
    """At every k, against a series and against one matrix."""
    found = value("excess(P[A], Q[A])", trials)
    assert found.axis == "k"
    np.testing.assert_allclose(found.array, [largest(a, b) for a, b in zip(P, Q, strict=True)], rtol=1e-9)
    found = value("excess(P[A], [[2, 1], [1, 3]])", trials)
    np.testing.assert_allclose(found.array, [largest(a, [[2, 1], [1, 3]]) for a in P], rtol=1e-9)
    found = value("since(excess(at(P[A], 2), Q[A]), 3)", trials)
    np.testing.assert_allclose(found.array, [largest(P[2], b) for b in Q[3:]], rtol=1e-9)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("excess([[4, 0], [0, 9]], [[2, 0], [0, 18]])", 2),
        ("excess([[1, 1], [1, 1]], [[1, 0], [0, 1]])", 2),
        ("excess([[-4, 0], [0, -9]], [[2, 0], [0, 3]])", -2),
        ("excess(3, 2)", 1.5),
        ("excess([[3]], 2)", 1.5),
        # a singular second one
        ("excess([[3, 0], [0, 0]], [[2, 0], [0, 0]])", 1.5),
        ("excess([[-3, 0], [0, 0]], [[2, 0], [0, 0]])", -1.5),
        ("excess([[3, 0], [0, 1]], [[2, 0], [0, 0]])", math.inf),
        ("excess([[1, 1], [1, 1]], [[3, 3], [3, 3]])", 1 / 3),
        ("excess([[1, 1], [1, 1]], [[1, -1], [-1, 1]])", math.inf),
        ("excess([[0, 0], [0, 0]], [[0, 0], [0, 0]])", 0),
        ("excess([[1e-30, 0], [0, 0]], [[0, 0], [0, 0]])", math.inf),
        ("excess(0, 0)", 0),
        ("excess([[1, 0], [0, 1e-14]], [[2, 0], [0, 1e-14]])", 0.5),  # both are 0 up to rounding
        ("excess([[1, 0], [0, 1e-9]], [[2, 0], [0, 1e-14]])", math.inf),
    ],
)
def test_excess_by_hand(trials, text, expected):
    """Diagonal ones, rank one, and ones that are 0 in a direction."""
    assert number(text, trials) == pytest.approx(expected, rel=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 4))
def test_excess_is_the_smallest_factor_that_covers(seed, n, rank):
    """Definition: b times it minus a has no negative eigenvalue, and one that is 0; also where b is singular."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0][:, : min(rank, n)]
    inner = [root @ root.T + 0.1 * np.eye(basis.shape[1]) for root in rng.normal(size=(2, *basis.shape[1:] * 2))]
    a, b = (basis @ part @ basis.T for part in inner)
    found = float(excess(Value(a), Value(b)).array)
    left = np.linalg.eigvalsh(basis.T @ (found * b - a) @ basis)
    assert abs(left[0]) <= 1e-9 * found * np.abs(b).max()
    if basis.shape[1] < n:
        outside = a + np.eye(n)
        assert float(excess(Value(outside), Value(b)).array) == math.inf


def test_what_is_missing_is_not_a_number():
    """One sample of a series, the others being there."""
    hole = P.copy()
    hole[1, 0, 1] = np.nan
    for found in (
        excess(Value(hole, "k"), Value(Q, "k")),
        excess(Value(Q, "k"), Value(hole, "k")),
        distance(Value(np.ones((K, 2)), "k"), Value(np.array(0.0)), Value(hole, "k")),
        distance(Value(hole[:, 0], "k"), Value(np.array(0.0)), Value(P, "k")),
    ):
        assert np.isnan(found.array).tolist() == [False, True, False, False, False]


def test_distances_of_runs(trials):
    """Brute force, run by run, and the share of them that the ellipsoid contains."""
    text = "distance([x0_end[A], x1_end[A]], at(mean(x_hat[A]), 3), at(P[A], 3))"
    found = value(text, trials)
    expected = [math.sqrt((x - CENTRE) @ np.linalg.inv(P[3]) @ (x - CENTRE)) for x in X]
    assert found.axis == "runs"
    np.testing.assert_allclose(found.array, expected, rtol=1e-9)
    assert number(f"share({text} <= 1)", trials) == np.mean(np.array(expected) <= 1)
    assert number(f"max({text})", trials) == pytest.approx(max(expected))
    one = value("distance(x0_end[A], 1, 4)", trials)
    np.testing.assert_allclose(one.array, np.abs(X[:, 0] - 1) / 2, rtol=1e-12)
    mixed = value("distance([x0_end[A], 0], [1, 1], [[4, 0], [0, 1]])", trials)
    np.testing.assert_allclose(mixed.array, np.hypot((X[:, 0] - 1) / 2, 1), rtol=1e-12)


def test_distances_of_series_and_vectors(trials):
    """Over k where anything is; a number where nothing is."""
    found = value("distance([v[A], w[A]], at(mean(x_hat[A]), 0), P[A])", trials)
    gaps = np.stack([1.0 + np.arange(K), np.arange(K) / 2], axis=1) - CENTRE
    assert found.axis == "k"
    np.testing.assert_allclose(found.array, np.sqrt([d @ np.linalg.solve(p, d) for d, p in zip(gaps, P, strict=True)]))
    found = value("distance([3, 1], mean(x_hat[A]), P[A])", trials)
    np.testing.assert_allclose(found.array, np.sqrt([[2, 3] @ np.linalg.solve(p, [2, 3]) for p in P]))
    for text, expected in (
        ("distance([3, 4], 0, [[1, 0], [0, 1]])", 5),
        ("distance([3, 4], [1, 1], [[4, 0], [0, 9]])", math.sqrt(2)),
        ("distance(3, 1, 4)", 1),
        ("distance([3], [1], [[4]])", 1),
        ("distance([3, 0], 0, [[4, 0], [0, 0]])", 1.5),
        ("distance([3, 1], 0, [[4, 0], [0, 0]])", math.inf),
        ("distance([3, inf], [0, 1], [[4, 0], [0, 1]])", math.inf),
        ("distance([2, inf], [0, inf], [[4, 0], [0, 1]])", 1),
        ("distance([0, 0], 0, [[0, 0], [0, 0]])", 0),
    ):
        assert number(text, trials) == pytest.approx(expected, rel=1e-12), text


def test_distance_is_the_excess_of_the_outer_product(trials):
    """max (z'd)^2 / z'Pz = d'P^-1 d."""
    d = X[0] - CENTRE
    expected = float(excess(Value(np.outer(d, d)), Value(P[2])).array)
    found = distance(Value(X[0]), Value(CENTRE), Value(P[2]))
    assert float(found.array) ** 2 == pytest.approx(expected, rel=1e-9)


def test_the_share_of_an_ellipsoid_has_its_interval(trials):
    """The exact one, as any share against a level; other statements of distances are resampled."""
    inside = "distance([x0_end[A], x1_end[A]], at(mean(x_hat[A]), 3), [[2, 0], [0, 2]]) <= 1"
    hits = int((((X - CENTRE) ** 2).sum(axis=1) <= 2).sum())
    assert 0 < hits < RUNS
    [shown] = judge(Claim("", "", (f"share({inside}) > 0.01",)), trials).comparisons
    expected = stats.binomtest(hits, RUNS).proportion_ci(0.95, method="exact")
    assert shown.interval == pytest.approx((expected.low - 0.01, expected.high - 0.01))
    assert (shown.left, shown.n, shown.holds) == (hits / RUNS, RUNS, True)
    [shown] = judge(Claim("", "", (f"2 * share({inside}) > 0.01",)), trials).comparisons
    assert shown.interval is not None and shown.interval[0] < 2 * hits / RUNS - 0.01 < shown.interval[1]
    distances = "distance([x0_end[A], x1_end[A]], at(mean(x_hat[A]), 3), at(P[A], 3))"
    [shown] = judge(Claim("", "", (f"mean({distances}) < 1000",)), trials).comparisons
    assert shown.holds and shown.interval is not None and shown.interval[0] < shown.left - 1000 < shown.interval[1]
    [shown] = judge(Claim("", "", (f"all({distances} < 1000)",)), trials).comparisons
    assert (shown.holds, shown.interval) == (None, None)
    assert judge(Claim("", "", (f"share({inside}) >= 0",)), trials).finding == "confirmed"


def test_comparisons_of_excess_have_no_interval(trials):
    """No run enters; the entry that comes closest to failing is shown."""
    values = [largest(a, b) for a, b in zip(P, Q, strict=True)]
    [shown] = judge(Claim("", "", ("all(excess(P[A], Q[A]) <= 1)",)), trials).comparisons
    assert (shown.interval, shown.n, shown.holds) == (None, 0, max(values) <= 1)
    assert shown.left == pytest.approx(max(values))


def test_lists(trials):
    """Entry i of the list is entry i of every run, or of every k."""
    found = value("[x0_end[A], 2, 3 * x1_end[A]]", trials)
    assert (found.axis, found.entry) == ("runs", (3,))
    np.testing.assert_array_equal(found.array, np.stack([X[:, 0], np.full(RUNS, 2.0), 3 * X[:, 1]], axis=1))
    found = value("since([v[A], 1], 2)", trials)
    assert found.axis == "k"
    np.testing.assert_array_equal(found.array, [[3, 1], [4, 1], [5, 1]])
    found = value("trace([[x0_end[A], 1], [0, x1_end[A]]])", trials)
    np.testing.assert_array_equal(found.array, X.sum(axis=1))
    np.testing.assert_allclose(value("mean([x0_end[A], x1_end[A]])", trials).array, X.mean(axis=0))
    assert number("share([x0_end[A], x1_end[A]] > [1, -2])", trials) == (X > CENTRE).all(axis=1).mean()
    found = value("[1, 2 * 3]", trials)
    assert found.axis == ""
    np.testing.assert_array_equal(found.array, [1, 6])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("excess(P[A], R[A])", "entries of shapes (2, 2) and (3, 3) cannot be combined"),
        ("excess(P[A], 2)", "entries of shapes (2, 2) and (1, 1) cannot be combined"),
        ("excess(diag(P[A]), Q[A])", "excess needs square matrices, got entries of shape (2,)"),
        ("excess(asymmetric[A], Q[A])", "excess needs symmetric matrices"),
        ("excess(P[A], [[1, 0], [0, -1]])", "the last argument of excess has a negative eigenvalue, -1"),
        ("excess(P[A], short[A])", "series of 5 and 2 samples"),
        ("distance([1, 2], 0, R[A])", "needs a vector and a matrix, got entries of shapes (2,) and (3, 3)"),
        ("distance([1, 2], 0, 4)", "needs a vector and a matrix, got entries of shapes (2,) and (1, 1)"),
        ("distance([1, 2], [1, 2, 3], P[A])", "entries of shapes (2,) and (3,)"),
        ("distance([x0_end[A], v[A]], 0, [[1, 0], [0, 1]])", "column over runs and a series over k"),
        ("distance([x0_end[A], 1], 0, P[A])", "column over runs and a series over k"),
        ("distance([1, 2], 0, [[0, 1], [1, 0]])", "the last argument of distance has a negative eigenvalue"),
        ("distance([1, 2], 0, [[1, 1], [0, 1]])", "distance needs symmetric matrices"),
        ("[v[A], diag(P[A])]", "the entries of a list must have one shape, got () and (2,)"),
    ],
)
def test_reasons(trials, text, reason):
    """Shapes that do not fit, and matrices that are none of a quadratic form."""
    with pytest.raises(EvaluationError) as caught:
        value(text, trials)
    assert reason in str(caught.value)
    assert judge(Claim("", "", (f"{text} < 1",)), trials).finding == "inconclusive"
