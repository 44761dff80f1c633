"""Adjusted averages: polynomials of laws, the rule of the form, and the values whose mean is compared."""

import math
from dataclasses import replace

import numpy as np
import pytest
from comparison_tables import drawn
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.adjustment import (
    FORMS,
    Basis,
    law_of,
    leave_one_out,
    n_terms,
    quantity_of,
    terms_of,
)
from rmpc_bench.analysis.intervals import standard_error, student
from rmpc_bench.analysis.pairs import pairs_of
from rmpc_bench.types.metric import AdjustKeys

UNIFORM = {"dist": "uniform", "low": -0.2, "high": 0.4}
LAWS = {
    "uniform": (UNIFORM, stats.uniform(-0.2, 0.6)),
    "truncated": ({"dist": "normal", "mean": 1.0, "std": 0.5, "truncate": 2.0}, stats.truncnorm(-2, 2, 1.0, 0.5)),
    "one-sided": ({"dist": "normal", "std": 0.5, "low": 0.25, "high": 1.0}, stats.truncnorm(0.5, 2, 0.0, 0.5)),
    "normal": ({"dist": "normal", "mean": 0.0, "std": 0.5}, stats.norm(0, 0.5)),
    "choice": (
        {"dist": "choice", "values": [3.0, -1.0, 0.5, 3.0, 9.0], "probabilities": [0.2, 0.3, 0.3, 0.2, 0.0]},
        None,
    ),
}


def adjusted(trials, averages):
    """Return the adjusted averages of A."""
    pairs = pairs_of(trials, "A", trials.primary_info)
    return trials.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, averages)


@pytest.mark.parametrize("name", LAWS)
def test_moments_of_laws(name):
    """The nodes of a law have its moments up to the order that orthonormal polynomials need: those of scipy.stats."""
    data, known = LAWS[name]
    law = law_of(data)
    for order in range(9):
        expected = (
            known.moment(order) if name != "choice" else 0.3 * (-1.0) ** order + 0.3 * 0.5**order + 0.4 * 3**order
        )
        size = float(law.weights @ np.abs(law.nodes) ** order)
        assert law.weights @ law.nodes**order == pytest.approx(expected, rel=1e-12, abs=1e-12 * max(size, 1e-3))


@pytest.mark.parametrize("name", LAWS)
def test_polynomials_are_orthonormal(name):
    """E X'X/n = I; for the uniform law they are Legendre's."""
    law = law_of(LAWS[name][0])
    quantity = quantity_of("u", law)
    assert quantity.degree == (2 if name == "choice" else 4)
    P = np.stack([np.ones(len(law.nodes)), *quantity.polynomials(law.nodes)])
    np.testing.assert_allclose(P * law.weights @ P.T, np.eye(len(P)), atol=1e-10)
    if name == "uniform":
        u = np.linspace(-0.2, 0.4, 7)
        for k, values in enumerate(quantity.polynomials(u), 1):
            legendre = np.polynomial.legendre.legval((u - 0.1) / 0.3, [0] * k + [1])
            np.testing.assert_allclose(values, math.sqrt(2 * k + 1) * legendre, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("q", "quadratic", "highest"), [(1, 30, 50), (2, 60, 150), (3, 100, 350), (4, 150, 700), (6, 280, 2100)]
)
def test_pairs_from_which_a_form_is_chosen(q, quadratic, highest):
    """The table of section A3: ten pairs per term."""
    degrees = [4] * q
    assert [10 * n_terms(degrees, form) for form in ("quadratic", "degree 4")] == [quadratic, highest]
    for form in FORMS:
        for some in (degrees, [1, 2, 4][:q], [1] * q):
            assert n_terms(some, form) == 1 + len(terms_of(some, form))


def test_rule_of_the_form(make_trials):
    """Degree 4 only where nothing else is random; fewer pairs, a limit and unknown laws make the form smaller."""
    made = drawn(make_trials, 400)
    alone = replace(made, random_besides=())
    assert made.adjustment.basis(400).form == "quadratic"
    assert [alone.adjustment.basis(n) and alone.adjustment.basis(n).form for n in (400, 200)] == ["degree 4"] * 2
    assert [drawn(make_trials, n).adjustment.basis(n).form for n in (60, 50, 49, 30)] == [
        "quadratic",
        "without interactions",
        "linear",
        "linear",
    ]
    assert drawn(make_trials, 29).adjustment.basis(29) is None
    assert drawn(make_trials, 29).adjustment.why_not(29) == "29 runs, 30 are needed for 2 quantities"
    # Pairs in less than half of the runs.
    assert made.adjustment.basis(199) is None and made.adjustment.basis(200)
    assert replace(made, adjust=AdjustKeys(None, 1)).adjustment.basis(400).form == "linear"
    named = replace(alone, adjust=["eps"]).adjustment
    assert [each.name for each in named.quantities] == ["eps"]
    # What is left out is noise.
    assert named.basis(400).form == "quadratic"
    # Who does not say what else is random may have noise.
    assert replace(made, random_besides=None).adjustment.basis(400).form == "quadratic"


def test_which_quantities(make_trials):
    """A wide normal law counts as noise unless it is asked for; a law without a spread is none, a burst has none."""
    unit = {"dist": "uniform", "low": -1, "high": 1}
    wide, narrow = ({"dist": "normal", "std": 1.0, **more} for more in ({}, {"truncate": 2.0}))
    found = drawn(make_trials, 60, laws={"eps": unit, "eta": wide}).adjustment
    assert found.left_out == {"eta": "its normal law is too wide"}
    assert [each.name for each in drawn(make_trials, 60, laws={"eps": unit, "eta": narrow}).adjustment.quantities] == [
        "eps",
        "eta",
    ]
    asked = drawn(make_trials, 60, laws={"eps": unit, "eta": wide}, adjust=["eta"]).adjustment
    assert [each.name for each in asked.quantities] == ["eta"] and asked.left_out == {"eps": "not asked for"}
    for data in ({"dist": "uniform", "low": 1, "high": 1}, {"dist": "choice", "values": [2.0, 2.0]}):
        still = drawn(make_trials, 60, laws={"eps": unit, "eta": data}).adjustment
        assert [each.name for each in still.quantities] == ["eps"] and not still.left_out
    for data in ({"dist": "normal", "std": 0.0}, {"dist": "fixed", "value": 1.0}, {}, {"dist": "choice"}, {"dist": 3}):
        some = drawn(make_trials, 60, laws={"eps": unit, "eta": data}).adjustment
        assert [each.name for each in some.quantities] == ["eps"]
    none = drawn(make_trials, 60, adjust="none").adjustment
    assert none.basis(60) is None
    assert "no uncertain quantity" in drawn(make_trials, 60, laws={}).adjustment.why_not(60)


def by_brute_force(u, form, average, a, b):
    """V from n regressions without one run each, by least squares on the products of monomials."""
    X = [np.ones(len(u))]
    total = {"degree 4": 4, "linear": 1}.get(form, 2)
    for i in range(total + 1):
        for j in range(total + 1 - i):
            if i + j and (form != "without interactions" or not i * j):
                legendre = [np.polynomial.legendre.legval(u[:, k], [0] * n + [1]) for k, n in ((0, i), (1, j))]
                X.append(legendre[0] * legendre[1])
    X = np.stack(X, axis=1)
    s = ~(np.isnan(a) | np.isnan(b))

    def theta(rows):
        def alpha(z):
            return np.linalg.lstsq(X[rows], np.where(s, z, 0.0)[rows], rcond=None)[0][0]

        if average == "mean":
            return math.log(alpha(a) / alpha(b))
        return alpha(np.log(a / b) if average == "geometric" else a - b) / alpha(np.ones(len(a)))

    n = len(a)
    whole, left = theta(np.arange(n)), np.array([theta(np.delete(np.arange(n), i)) for i in range(n)])
    return whole + (n - 1) * (left.mean() - left)


@pytest.mark.parametrize("average", ["geometric", "mean", "difference"])
@pytest.mark.parametrize("with_failures", [False, True])
@pytest.mark.parametrize("form", ["linear", "without interactions", "quadratic", "degree 4"])
def test_values_are_those_of_brute_force(make_trials, average, with_failures, form):
    """Oracle: as many regressions as there are runs, on other polynomials of the same space."""
    trials = drawn(make_trials, 60, fails=(lambda u: u[:, 0] > 0.7) if with_failures else None)
    a, b = trials.column("mse", "A"), trials.column("mse", "B")
    u = np.stack([trials.quantities["eps"], trials.quantities["eta"]], axis=1)
    unit = law_of({"dist": "uniform", "low": -1, "high": 1})
    basis = Basis(form, tuple(quantity_of(name, unit) for name in ("eps", "eta")), u)
    V = leave_one_out(basis, [average], a, b)[average]
    # Sixty least-squares solutions, each with its rounding, times 59.
    np.testing.assert_allclose(V, by_brute_force(u, form, average, a, b), rtol=1e-10, atol=1e-11)


def test_standard_error_is_that_of_hc3(make_trials):
    """HC3 of the intercept by its own formula: (X'X)^-1 X' diag(r_i^2/(1 - h_i)^2) X (X'X)^-1."""
    trials = drawn(make_trials, 60)
    pairs, found = pairs_of(trials, "A", trials.primary_info), trials.adjustment
    [(_, made)] = found.adjusted(pairs.runs, pairs.a, pairs.b, {"geometric": None}).items()
    X = np.concatenate([block for _, block in made.basis.blocks()])
    d = np.log(pairs.a / pairs.b)
    inverse = np.linalg.inv(X.T @ X)
    r, h = d - X @ (inverse @ X.T @ d), np.einsum("ij,jk,ik->i", X, inverse, X)
    hc3 = inverse @ (X.T * (r / (1 - h)) ** 2) @ X @ inverse
    assert made.df == 60 - 6
    assert made.values.mean() == pytest.approx((inverse @ X.T @ d)[0], rel=1e-12)
    # The jackknife takes the mean of the estimates without a run from them; HC3 does not.
    shift = float((inverse @ X.T @ (r / (1 - h)))[0]) / 60
    expected = math.sqrt(hc3[0, 0] * 59 / 60 - 59 * shift**2)
    assert standard_error(made.values) == pytest.approx(expected, rel=1e-6)
    assert standard_error(made.values) * math.sqrt(60 / 59) == pytest.approx(math.sqrt(hc3[0, 0]), rel=1e-3)


@pytest.mark.parametrize("average", ["geometric", "mean", "difference"])
def test_without_terms_the_values_are_those_of_today(make_trials, average):
    """Limit: X = [1], with and without failed runs, for averages of finished runs."""
    for fails in (None, lambda u: u[:, 0] > 0.5):
        trials = drawn(make_trials, 40, fails=fails)
        pairs = pairs_of(trials, "A", trials.primary_info)
        pairs = replace(pairs, signed=average == "difference")
        today = pairs.averages()[average]
        a, b = trials.column("mse", "A"), trials.column("mse", "B")
        V = leave_one_out(Basis("", (), np.zeros((40, 0))), [average], a, b)[average]
        assert V.mean() == pytest.approx(today.mean(), rel=1e-12)
        if fails is None:
            np.testing.assert_allclose(V, today, **ROUND)


def test_an_affine_change_of_a_law_changes_nothing(make_trials):
    """Another unit of a quantity gives the same values."""
    trials = drawn(make_trials, 60)
    moved = replace(
        trials,
        quantities={**trials.quantities, "eps": 5.0 + 100 * trials.quantities["eps"]},
        laws={**trials.laws, "eps": {"dist": "uniform", "low": -95, "high": 105}},
    )
    pairs = pairs_of(trials, "A", trials.primary_info)
    one, other = (each.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, pairs.averages()) for each in (trials, moved))
    for name in ("geometric", "mean"):
        # The page's number.
        np.testing.assert_allclose(one[name].values, other[name].values, rtol=0, atol=1e-10)


def test_large_tables_are_computed_in_blocks(make_trials, monkeypatch):
    """The same values, up to rounding, from blocks of 7 runs."""
    trials = drawn(make_trials, 60)
    pairs = pairs_of(trials, "A", trials.primary_info)
    whole = trials.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, pairs.averages())
    monkeypatch.setattr("rmpc_bench.analysis.adjustment.ROWS", 7)
    parts = replace(trials, seed=1).adjustment.adjusted(pairs.runs, pairs.a, pairs.b, pairs.averages())
    for name, made in whole.items():
        np.testing.assert_allclose(parts[name].values, made.values, rtol=1e-10)


def test_a_difference_that_the_draws_explain_has_no_width(make_trials):
    """d exactly quadratic in u: the interval is a point, and nothing is divided by 0."""
    exact = lambda u: {"mse": {"A": np.exp(0.3 + u[:, 0] - u[:, 0] * u[:, 1]), "B": np.ones(len(u))}}  # noqa: E731
    trials = drawn(make_trials, 60, values=exact)
    pairs = pairs_of(trials, "A", trials.primary_info)
    V = trials.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, {"geometric": None})["geometric"].values
    assert np.ptp(V) == 0 and V[0] == pytest.approx(0.3, rel=1e-12)
    equal = drawn(make_trials, 60, values=lambda u: {"mse": {"A": 1 + u[:, 0] ** 2, "B": 1 + u[:, 0] ** 2}})
    made = adjusted(equal, {"geometric": None, "mean": None})
    assert all((each.values == 0).all() for each in made.values())


def test_values_that_do_not_determine_the_terms(make_trials):
    """A quantity that is constant in the drawn runs, or equal to another one, leads to a smaller form or to none."""
    trials = drawn(make_trials, 60)
    for eta in (np.full(60, 0.5), trials.quantities["eps"]):
        still = replace(trials, quantities={**trials.quantities, "eta": eta})
        assert still.adjustment.basis(60) is None
        assert still.adjustment.why_not(60) == "the drawn values do not differ enough"
    # A value of a choice that only one run has: leverage 1 of the squares, so that the linear form is left.
    eta = np.where(np.arange(60) == 0, 0.0, np.where(np.arange(60) % 2, -1.0, 1.0))
    choice = {"dist": "choice", "values": [-1.0, 0.0, 1.0]}
    rare = replace(
        trials, quantities={**trials.quantities, "eta": eta}, laws={"eps": trials.laws["eps"], "eta": choice}
    )
    assert rare.adjustment.basis(60).form == "linear"


def test_what_is_not_adjusted(make_trials):
    """An adjusted share of finished runs that is not positive, huge values, missing draws: plain values remain."""
    one_of_two = drawn(make_trials, 60, fails=lambda u: np.abs(u[:, 0]) < 0.5)
    pairs = pairs_of(one_of_two, "A", one_of_two.primary_info)
    assert {*one_of_two.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, pairs.averages())} <= {"geometric", "mean"}
    # All of a mean in the run with the smallest weight, which is negative.
    weights = drawn(make_trials, seed=61).adjustment.basis(60).intercepts(np.eye(60))[-1]
    a = np.where(np.arange(60) == weights.argmin(), 1e3, 1e-6)
    rare = drawn(make_trials, seed=61, values=lambda u: {"mse": {"A": a, "B": np.ones(60)}})
    found = adjusted(rare, {"geometric": None, "mean": None})
    assert weights.min() < 0 and [*found] == ["geometric"]
    assert rare.adjustment.why_not(60) == "an adjusted mean is not positive"
    huge = drawn(make_trials, 60, values=lambda u: {"mse": {"A": 1e300 * (2 + u[:, 0]), "B": 1e300 * (3 + u[:, 1])}})
    made = adjusted(huge, {"geometric": None, "mean": None})
    assert np.isfinite(made["mean"].values).all()
    gone = replace(one_of_two, quantities={name: each[:50] for name, each in one_of_two.quantities.items()})
    assert gone.adjustment.why_not(60) == "the drawn values are not stored"


def test_interval_has_fewer_degrees_of_freedom(make_trials):
    """Student's with n_pairs - p, of the values V."""
    trials = drawn(make_trials, 60)
    pairs = pairs_of(trials, "A", trials.primary_info)
    made = trials.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, {"mean": None})["mean"]
    low, high = made.interval("mean", 0.95, 1)
    reach = stats.t.ppf(0.975, 54) * made.values.std(ddof=1) / math.sqrt(60)
    assert [low, high] == pytest.approx([made.values.mean() - reach, made.values.mean() + reach], rel=1e-9)
    assert student(made.values, 0.95)[0] > low


@pytest.mark.parametrize("average", ["geometric", "mean"])
def test_coverage_where_failures_depend_on_the_draws(make_trials, average):
    """The trap: a regression of the finished runs covers 0.04 (60 runs); the ratio covers 0.93 to 0.97.

    Of 400 sets the share has a standard error of 0.011.  True values by a fine grid of the two quantities.
    """
    n, sets = 60, 400
    grid = (np.arange(400) + 0.5) / 200 - 1
    U, W = np.meshgrid(grid, grid)
    d, fails = -0.1 + 0.5 * U + 0.2 * U * W, U + 0.3 * W > 0.6
    truth = d[~fails].mean() if average == "geometric" else math.log(np.exp(d[~fails]).mean())
    trials = drawn(make_trials, n)
    covers = wrong = narrower = 0
    for seed in range(sets):
        u = np.random.default_rng([seed, 9]).uniform(-1, 1, (n, 2))
        a = np.exp(-0.1 + 0.5 * u[:, 0] + 0.2 * u[:, 0] * u[:, 1])
        a[u[:, 0] + 0.3 * u[:, 1] > 0.6] = np.nan
        found = replace(trials, quantities={"run": np.arange(n), "eps": u[:, 0], "eta": u[:, 1]}).adjustment
        pairs = replace(pairs_of(trials, "A", trials.primary_info), a=a, b=np.ones(n))
        made = found.adjusted(pairs.runs, pairs.a, pairs.b, {average: None})[average]
        low, high = made.interval(average, 0.95, 1)
        covers += low <= truth <= high
        ends = student(pairs.averages()[average], 0.95)
        narrower += (ends[1] - ends[0]) / (high - low)
        # What must not be done: the same regression, of the finished runs only.
        ok = ~np.isnan(a)
        only = Basis(made.basis.form, made.basis.quantities, u[ok])
        V = leave_one_out(only, [average], a[ok], np.ones(ok.sum()))[average]
        wrong += student(V, 0.95)[0] <= truth <= student(V, 0.95)[1]
    assert 0.915 <= covers / sets <= 0.98
    assert wrong / sets < 0.2
    assert narrower / sets > 1.1
