"""Minimax fits against every vertex, SciPy's linear programs, their duals, symmetries, and data without a number."""

from itertools import combinations

import numpy as np
import pytest
from conftest import EXACT
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from rmpc_bench.numerics.minimax import FitOutcome, fit

CLOSE = 1e-9  # data of size 1; HiGHS keeps bounds to 1e-10
FAMILIES = ("integers", "integer data", "integer matrix", "consistent", "scales", "rank", "no unknowns")


def program(F, d, group, groups):
    """Inequalities of (x, r) and the objective."""
    E = np.eye(groups)[group]
    return np.block([[F, -E], [-F, -E]]), np.concatenate([d, -d]), np.r_[np.zeros(F.shape[1]), np.ones(groups)]


def scipys(F, d, group, groups, objective=None, most=None):
    """SciPy's optimum, or that of another objective where the sum of r is at most ``most``."""
    A, b, c = program(F, d, group, groups)
    if most is not None:
        A, b = np.vstack([A, c]), np.append(b, most)
    bounds = [(None, None)] * F.shape[1] + [(0.0, None)] * groups
    tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    return linprog(c if objective is None else objective, A, b, bounds=bounds, options=tight)


def instance(rng, family):
    """F, d, group and the number of groups, every one of which has a point."""
    n, p, groups = int(rng.integers(3, 15)), int(rng.integers(1, 6)), int(rng.integers(1, 4))
    F, d = rng.standard_normal((n, p)), rng.standard_normal(n)
    if family.startswith("integer"):
        F = F if family == "integer data" else rng.integers(-2, 3, (n, p)).astype(float)
        d = d if family == "integer matrix" else rng.integers(-2, 3, n).astype(float)
    elif family == "consistent":
        d = F @ rng.standard_normal(p)
    elif family == "scales":
        F, d = F * 10.0 ** rng.integers(-6, 7, p), d * 10.0 ** rng.integers(-9, 9)
    elif family == "rank":
        F = F[:, :1] @ rng.standard_normal((1, p))
    elif family == "no unknowns":
        F = F[:, :0]
    return F, d, np.r_[np.arange(groups), rng.integers(0, groups, n - groups)], groups


def one(F, d, group):
    """The fit of one row."""
    fits = fit(F[None], d[None], group)
    return fits.x[0], fits.r[0], fits.mu[0], FitOutcome(fits.outcome[0])


def check(rng, family):
    """Compare one instance with SciPy; its data are scaled to size 1, because SciPy's tolerances are absolute."""
    F, d, group, groups = instance(rng, family)
    x, r, mu, outcome = one(F, d, group)
    assert outcome != FitOutcome.FAILED
    size = max(np.abs(d).max(), 1e-300)
    columns = np.maximum(np.abs(F).max(axis=0, initial=0.0), 1e-300)
    G, e = F / columns, d / size
    theirs = scipys(G, e, group, groups)
    assert abs(theirs.fun - r.sum() / size) < CLOSE
    assert (np.abs(e - G @ (x * columns / size)) <= r[group] / size + CLOSE).all()
    assert np.abs(G.T @ mu).max(initial=0.0) < CLOSE and abs(mu @ e - r.sum() / size) < CLOSE
    assert all(np.abs(mu[group == g]).sum() <= 1.0 + CLOSE for g in range(groups))
    if outcome == FitOutcome.UNIQUE:
        scale = 1.0 + np.abs(theirs.x).max()
        for ours, other in ((r / size, theirs.x[F.shape[1] :]), (x * columns / size, theirs.x[: F.shape[1]])):
            np.testing.assert_allclose(ours, other, atol=1e-6 * scale)  # what a width of 1e-9 becomes at a flat corner
    return outcome


@pytest.mark.parametrize("family", FAMILIES)
def test_fits_are_scipys(family):
    """Oracle: linprog, on data that make ties, or none: bounds, duals, and x where it says that it is unique."""
    rng = np.random.default_rng(FAMILIES.index(family))
    outcomes = [check(rng, family) for _ in range(40)]
    assert family == "rank" or FitOutcome.UNIQUE in outcomes


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_thousands_of_fits_are_scipys(family):
    """Oracle: linprog."""
    rng = np.random.default_rng((7, FAMILIES.index(family)))
    for _ in range(1500):
        check(rng, family)


@pytest.mark.parametrize("eps", [1e-8, 1e-9, 1e-10, 1e-11, 1e-12])
def test_nearly_dependent_columns_fail_or_are_right(eps):
    """Oracle: linprog with the difference of the last column from twice the first, over eps, in its place."""
    rng = np.random.default_rng(round(-np.log10(eps)))
    for _ in range(4000):
        n = int(rng.integers(5, 16))
        F, group = rng.standard_normal((n, int(rng.integers(2, min(n, 7))))), np.zeros(n, dtype=int)
        F[:, -1] = 2.0 * F[:, 0] + eps * rng.standard_normal(n)
        d = rng.standard_normal(n)
        _, r, _, outcome = one(F, d, group)
        if outcome != FitOutcome.FAILED:
            best = scipys(np.column_stack([F[:, :-1], (F[:, -1] - 2.0 * F[:, 0]) / eps]), d, group, 1).fun
            assert abs(r[0] - best) <= 1e-5 * best


def test_dependent_columns_are_not_in_doubt(rng):
    """Oracle: linprog without the last column, a sum of others but for rounding; 1e-3 more leave one optimum."""
    for _ in range(60):
        n, p = int(rng.integers(6, 16)), int(rng.integers(2, 5))
        F, d, group = rng.standard_normal((n, p)), rng.standard_normal(n), np.arange(n) % 2
        best = scipys(F, d, group, 2).fun
        for last in (2.0 * F[:, 0], F @ rng.standard_normal(p)):
            _, r, _, outcome = one(np.column_stack([F, last]), d, group)
            assert outcome == FitOutcome.OPTIMAL and abs(r.sum() - best) < CLOSE
        other = rng.standard_normal(n)
        _, r, _, outcome = one(np.column_stack([F, F[:, 0] + 1e-3 * other]), d, group)
        assert outcome == FitOutcome.UNIQUE
        assert abs(r.sum() - scipys(np.column_stack([F, other]), d, group, 2).fun) < CLOSE


def brute_force(F, d, group, groups):
    """Least sum of r over all vertices: p + groups inequalities hold with equality."""
    A, b, c = program(F, d, group, groups)
    best = np.inf
    for rows in combinations(range(len(A)), A.shape[1]):
        B = A[list(rows)]
        if abs(np.linalg.det(B)) > 1e-9:
            z = np.linalg.solve(B, b[list(rows)])
            best = c @ z if (A @ z <= b + 1e-9).all() and c @ z < best else best
    return best


@pytest.mark.parametrize(("n", "p", "groups"), [(5, 1, 1), (5, 2, 1), (4, 1, 2), (5, 1, 2)])
def test_the_optimum_is_the_best_of_all_vertices(n, p, groups, rng):
    """Oracle: brute force."""
    for _ in range(4):
        F, d, group = rng.standard_normal((n, p)), rng.standard_normal(n), np.arange(n) % groups
        assert abs(one(F, d, group)[1].sum() - brute_force(F, d, group, groups)) < CLOSE


def test_four_points_on_a_line_by_hand():
    """Oracle: residuals at t = 0, 1, 2 that alternate give slope 0 and level 1/2, and that of t = 3 is 1/2, too."""
    t, d = np.arange(4.0), np.array([0.0, 1.0, 0.0, 1.0])
    x, r, mu, outcome = one(np.column_stack([np.ones(4), t]), d, np.zeros(4, dtype=int))
    np.testing.assert_allclose((*x, *r), (0.5, 0.0, 0.5), atol=1e-14)
    np.testing.assert_allclose(np.abs(mu).sum(), 1.0)
    assert outcome == FitOutcome.UNIQUE


def test_unique_means_that_the_face_is_a_point():
    """Oracle: the smallest and the largest value of every unknown among the optima, by linprog, on data with ties."""
    rng, seen = np.random.default_rng(4), {FitOutcome.UNIQUE: 0.0, FitOutcome.OPTIMAL: 0.0}
    for _ in range(25):
        F, d, group, groups = instance(rng, "integers")
        _, r, _, outcome = one(F, d, group)
        for j in range(F.shape[1]):
            e = np.zeros(F.shape[1] + groups)
            e[j] = 1.0
            ends = [scipys(F, d, group, groups, sign * e, r.sum() + 1e-9) for sign in (1.0, -1.0)]
            width = np.inf if any(end.status == 3 for end in ends) else -ends[1].fun - ends[0].fun
            seen[outcome] = max(seen[outcome], width)
    assert (
        seen[FitOutcome.UNIQUE] < 1e-6 and seen[FitOutcome.OPTIMAL] > 0.1
    )  # the face is cut at 1e-9, its corners are flat


numbers = st.integers(0, 2**32 - 1)


@settings(max_examples=25)
@given(seed=numbers)
def test_symmetries(seed):
    """Oracle: d + F c moves x by c; a factor of d, of all columns and of one group's place changes nothing else."""
    rng = np.random.default_rng(seed)
    n, p = 12, 3
    F, d, c, order = rng.standard_normal((n, p)), rng.standard_normal(n), rng.standard_normal(p), rng.permutation(n)
    group = np.arange(n) % 2
    x, r, _, _ = one(F, d, group)
    for moved, x_wanted, r_wanted in (
        (one(F, d + F @ c, group), x + c, r),
        (one(F, -3e5 * d, group), -3e5 * x, 3e5 * r),
        (one(F * 1e3, d, group), x / 1e3, r),
        (one(F[order], d[order], group[order]), x, r),
        (one(F, d, 1 - group), x, r[::-1]),
    ):
        size = np.abs(r_wanted).max()
        np.testing.assert_allclose(moved[1], r_wanted, atol=1e-11 * size)  # the duality gap may be 1e-11
        np.testing.assert_allclose(moved[0], x_wanted, rtol=1e-7, atol=1e-9 * np.abs(x_wanted).max())


def test_powers_of_two_change_no_bit(rng):
    """Oracle: scaling by a power of two is exact."""
    F, d, group = rng.standard_normal((5, 12, 4)), rng.standard_normal((5, 12)), np.arange(12) % 3
    plain, scaled = fit(F, d, group), fit(F / 64.0, d * 2.0**-40, group)
    np.testing.assert_allclose(scaled.x, plain.x * 2.0**-34, **EXACT)
    np.testing.assert_allclose(scaled.r, plain.r * 2.0**-40, **EXACT)


def test_rows_do_not_depend_on_each_other(rng):
    """Oracle: every row alone, bit for bit, also beside rows that fail."""
    F, d, group = rng.standard_normal((9, 12, 4)), rng.standard_normal((9, 12)), np.arange(12) % 3
    d[2, 5], F[4, 3, 1], d[6, 0] = np.nan, np.inf, -np.inf
    fits = fit(F, d, group)
    np.testing.assert_array_equal(fits.outcome == FitOutcome.FAILED, [i in (2, 4, 6) for i in range(9)])
    assert np.isnan(fits.x[[2, 4, 6]]).all() and np.isnan(fits.r[[2, 4, 6]]).all() and np.isnan(fits.mu[2]).all()
    for i in range(9):
        for together, alone in zip(fits, fit(F[i : i + 1], d[i : i + 1], group), strict=True):
            np.testing.assert_array_equal(together[i : i + 1], alone)


def test_what_is_given_stays_as_it_is(rng):
    """Oracle: copies; arrays that cannot be written, or lie otherwise in memory, give the same bits."""
    F, d, group = rng.standard_normal((4, 8, 2)), rng.standard_normal((4, 8)), np.zeros(8, dtype=np.int32)
    kept = F.copy(), d.copy()
    first = fit(F, d, group)
    for array in (F, d):
        array.flags.writeable = False
    second = fit(np.asfortranarray(F), d, group)
    for a, b in (*zip(kept, (F, d), strict=True), *zip(first, second, strict=True)):
        np.testing.assert_array_equal(a, b)


def test_data_without_residuals_are_fitted_exactly(rng):
    """Oracle: the x that made them; no data at all give 0; either is unique if F has full column rank."""
    F, x = rng.standard_normal((6, 12, 4)), rng.standard_normal((6, 4))
    d = np.einsum("rij,rj->ri", F, x)
    fits = fit(F, d, np.arange(12) % 3)
    np.testing.assert_allclose(fits.x, x, rtol=1e-11)  # twelve roundings and the condition of F
    assert (fits.outcome == FitOutcome.UNIQUE).all() and fits.r.max() < 1e-13
    nothing = fit(F, np.zeros_like(d), np.arange(12) % 3)
    assert not nothing.x.any() and not nothing.r.any() and (nothing.outcome == FitOutcome.UNIQUE).all()
    flat = fit(np.concatenate([F, F[:, :, :1]], axis=2), np.zeros_like(d), np.arange(12) % 3)
    assert (flat.outcome == FitOutcome.OPTIMAL).all()


def test_no_unknowns_leave_the_largest_datum(rng):
    """Oracle: the maximum; one point is enough, and a group without points has r = 0."""
    d = rng.standard_normal((7, 15))
    fits = fit(np.empty((7, 15, 0)), d, np.zeros(15, dtype=int))
    np.testing.assert_array_equal(fits.r[:, 0], np.abs(d).max(axis=1))
    assert fits.x.shape == (7, 0) and (fits.outcome == FitOutcome.UNIQUE).all()
    lone = fit(np.empty((1, 1, 0)), np.array([[-2.0]]), np.array([1]))
    np.testing.assert_array_equal(lone.r, [[0.0, 2.0]])
