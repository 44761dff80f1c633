"""Ellipsoids: sums and confidence against SciPy and support functions, intersections against scans and intervals."""

import numpy as np
import pytest
from conftest import EXACT, ROUND, SOLVER, random_psd
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from rmpc_bench.numerics.ellipsoid import confidence, intersection, sum_shape, sum_shapes, weight
from rmpc_bench.numerics.linalg import as_covariance

CRITERIA = pytest.mark.parametrize("criterion", ["trace", "volume"])
SIZES = pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (3, 2), (2, 3)])


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_sum_has_the_least_trace_of_its_family(n, rng):
    """Oracle: SciPy's minimiser over p, and the closed form (sqrt(tr M1) + sqrt(tr M2))^2."""
    M1, M2 = random_psd(rng, n), 7.0 * random_psd(rng, n)
    least = minimize_scalar(
        lambda z: np.trace((1 + np.exp(-z)) * M1 + (1 + np.exp(z)) * M2), bounds=(-5, 5), method="bounded",
        options={"xatol": 1e-10},
    )  # fmt: skip
    np.testing.assert_allclose(np.trace(sum_shape(M1, M2)), least.fun, **SOLVER)
    np.testing.assert_allclose(weight(M1, M2), np.exp(least.x), rtol=1e-5)  # where a minimum is flat
    closed = (np.sqrt(np.trace(M1)) + np.sqrt(np.trace(M2))) ** 2
    np.testing.assert_allclose(np.trace(sum_shape(M1, M2)), closed, **ROUND)


@pytest.mark.parametrize("ranks", [(3, 3), (1, 3), (1, 1)])
def test_a_sum_contains_all_sums(ranks, rng):
    """Oracle: support functions, sqrt(l' M l) of an ellipsoid, in 2000 directions l; flat ellipsoids too."""
    M1, M2 = (random_psd(rng, 3, rank=rank) for rank in ranks)
    directions = rng.standard_normal((2000, 3))
    reach = [np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", directions, M, directions), 0.0))
             for M in (M1, M2, sum_shape(M1, M2))]  # fmt: skip
    assert (reach[0] + reach[1] <= reach[2] * (1 + 1e-12)).all()  # rounding
    assert (reach[0] + reach[1] < 0.99 * reach[2]).any() or ranks != (3, 3)


def test_a_point_adds_nothing(rng):
    """Oracle: the other ellipsoid, bit for bit; in one dimension the sum of two intervals is exact."""
    M, zero = random_psd(rng, 3), np.zeros((3, 3))
    np.testing.assert_array_equal(sum_shape(M, zero), M)
    np.testing.assert_array_equal(sum_shape(zero, M), M)
    np.testing.assert_array_equal(sum_shape(zero, zero), zero)
    assert weight(zero, M) == 0.0 and weight(M, zero) == np.inf
    np.testing.assert_allclose(sum_shape(np.array([[4.0]]), np.array([[9.0]])), [[25.0]], **ROUND)


def test_sums_of_many_are_sums_of_each(rng):
    """Oracle: `sum_shape` for every run, points among them, and a point as the second set."""
    M1 = np.array([random_psd(rng, 3), np.zeros((3, 3)), 1e-9 * random_psd(rng, 3)])
    for M2 in (random_psd(rng, 3), np.zeros((3, 3))):
        np.testing.assert_allclose(sum_shapes(M1, M2), [sum_shape(M, M2) for M in M1], rtol=1e-12, atol=1e-300)


def test_the_confidence_is_chi_square():
    """Oracle: scipy.stats, and the two quantiles that everybody knows."""
    for level in (0.5, 0.95, 0.999):
        for n in (1, 2, 3, 10):
            np.testing.assert_allclose(confidence(level, n), chi2.ppf(level, n), rtol=1e-10)
    assert (round(confidence(0.95, 2), 3), round(confidence(0.95, 1), 3)) == (5.991, 3.841)


def test_short_forms_of_a_shape():
    """Oracle: by hand; what is no shape is refused."""
    np.testing.assert_array_equal(as_covariance(2.0, 2), 2.0 * np.eye(2))
    np.testing.assert_array_equal(as_covariance([1.0, 0.0], 2), np.diag([1.0, 0.0]))
    with pytest.raises(ValueError, match="positive semidefinite"):
        as_covariance(-1.0, 2)


def combination(M, C, R, e, lam):
    """Shape and centre for one lam, by inverting everything."""
    inv_M, inv_R = np.linalg.inv(M), np.linalg.inv(R)
    X = np.linalg.inv((1 - lam) * inv_M + lam * C.T @ inv_R @ C)
    centre = lam * X @ C.T @ inv_R @ e
    return (1 - lam * e @ inv_R @ e + centre @ np.linalg.solve(X, centre)) * X, centre


def drawn(rng, n, m, runs=12):
    """Sets of many runs whose measurement is often far from the middle, yet possible."""
    M, R = np.array([random_psd(rng, n) for _ in range(runs)]), random_psd(rng, m)
    C = rng.standard_normal((m, n))
    x, v = rng.standard_normal((runs, n)), rng.standard_normal((runs, m))
    x, v = (z * (0.95 / np.linalg.norm(z, axis=1, keepdims=True)) for z in (x, v))
    x = np.einsum("rij,rj->ri", np.linalg.cholesky(M), x)
    return M, C, R, x @ C.T + v @ np.linalg.cholesky(R).T


@SIZES
@CRITERIA
def test_the_smallest_combination_is_found(n, m, criterion, rng):
    """Oracle: a scan of 501 values of lam, with inverses of M, R and X."""
    M, C, R, e = drawn(rng, n, m)
    size = np.trace if criterion == "trace" else np.linalg.det
    found = intersection(M, C, R, e, criterion)
    assert found.met.all()
    for i in range(len(e)):
        M_i, centre = combination(M[i], C, R, e[i], found.lam[i])
        np.testing.assert_allclose(found.M[i], M_i, rtol=1e-9, atol=1e-12)  # what inverting three times costs
        np.testing.assert_allclose(found.centre[i], centre, rtol=1e-9, atol=1e-12)
        scanned = [size(combination(M[i], C, R, e[i], lam)[0]) for lam in np.linspace(0.0, 0.9999, 501)]
        assert size(found.M[i]) <= min(scanned) * (1 + 1e-9)  # inverses again
        assert size(found.M[i]) >= min(scanned) * (1 - 5e-3)  # 1/500 beside the smallest one


@SIZES
@CRITERIA
def test_all_common_points_are_inside(n, m, criterion, rng):
    """Oracle: the definition; points of both sets, drawn in the first one."""
    M, C, R, e = drawn(rng, n, m)
    found, inside = intersection(M, C, R, e, criterion), 0
    for i in range(len(e)):
        points = rng.standard_normal((20_000, n))
        points *= rng.random((20_000, 1)) ** (1 / n) / np.linalg.norm(points, axis=1, keepdims=True)
        points = points @ np.linalg.cholesky(M[i]).T
        left = e[i] - points @ C.T
        common = points[np.einsum("ri,ij,rj->r", left, np.linalg.inv(R), left) <= 1.0] - found.centre[i]
        inside += len(common)
        shape = np.linalg.inv(found.M[i])
        assert (np.einsum("ri,ij,rj->r", common, shape, common) <= 1.0 + 1e-9).all()
    assert inside > 100


def on_the_surfaces(rng, n, m, rank, ratio, touching, runs=20):
    """Sets with a state on both surfaces; M of integers, which is singular without rounding, and R about ratio M."""
    F, C = rng.integers(-4, 5, (runs, n, rank)).astype(float), rng.standard_normal((m, n))
    R = 10.0 * ratio * random_psd(rng, m)
    L = np.linalg.cholesky(R)
    a, b = rng.standard_normal((runs, rank)), rng.standard_normal((runs, m))
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    if touching:  # the sets have parallel surfaces there
        a = np.einsum("rji,rj->ri", np.linalg.solve(L, C @ F), b)
    a /= np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-300)
    x = np.einsum("rij,rj->ri", F, a)
    return F @ F.mT, C, R, x @ C.T + b @ L.T, x


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 2), (2, 1), (2, 2), (2, 3), (3, 2)])
@pytest.mark.parametrize("touching", [False, True])
@CRITERIA
def test_states_on_both_surfaces_are_inside(n, m, touching, criterion, rng):
    """Oracle: the definition, for M of every rank and noises from tiny to large; scaled before inverting."""
    for rank in range(n + 1):
        for ratio in 10.0 ** np.arange(-10, 1, 2):
            M, C, R, e, x = on_the_surfaces(rng, n, m, rank, ratio, touching)
            found = intersection(M, C, R, e, criterion)
            assert found.met.all()
            kept, d = found.lam == 0.0, x - found.centre
            np.testing.assert_array_equal(found.M[kept], M[kept])
            half = np.sqrt(np.einsum("rii->ri", found.M))
            np.testing.assert_array_equal(d[half == 0.0], 0.0)
            half = np.where(half > 0.0, half, 1.0)
            w, V = np.linalg.eigh(found.M / half[:, :, None] / half[:, None, :])
            parts = np.einsum("rij,ri->rj", V, d / half) ** 2 / np.maximum(w, 1e-15)  # w of known entries is 0
            # The centre's digits, 1e-16 of x, in a set that is at least 2e-10 of x thick here: twice 5e-7.
            assert (parts.sum(axis=1)[~kept] <= 1.0 + 1e-6).all()


def test_rounding_is_relative_to_each_entry():
    """Oracle: the same sets in other units, and an entry that is known, which stays so."""
    M, C = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 0.0]]), np.array([[1.0, 1.0, 1.0]])
    units, R, e = np.array([1e6, 1e-6, 1.0]), np.array([[0.5]]), np.array([[2.5]])
    plain = intersection(M[None], C, R, e, "volume")
    other = intersection((units[:, None] * M * units)[None], C / units, R, e, "volume")
    np.testing.assert_allclose(other.centre, units * plain.centre, rtol=1e-7, atol=0.0)  # a flat set is 1e-7 thick
    np.testing.assert_allclose(other.M, units[:, None] * plain.M * units, rtol=1e-7, atol=0.0)  # the same
    np.testing.assert_array_equal(plain.M[0, 2], 0.0)


def test_a_run_that_has_overflowed_leaves_the_others_alone(rng):
    """Oracle: the others by themselves, bit for bit."""
    M, C, R, e = drawn(rng, 2, 3, runs=3)
    M[1] = np.nan
    found, alone = intersection(M, C, R, e), intersection(M[[0, 2]], C, R, e[[0, 2]])
    for ours, theirs in zip(found, alone, strict=True):
        np.testing.assert_array_equal(ours[[0, 2]], theirs)


@pytest.mark.parametrize("e", [0.0, 1.0, 2.9999, 3.0001, -5.0])
def test_intervals(e):
    """Oracle: by hand; [-1, 1] and [e - 2, e + 2] meet as long as |e| <= 3; M = 1, R = 4."""
    found = intersection(np.ones((1, 1, 1)), np.ones((1, 1)), 4.0 * np.ones((1, 1)), np.array([[e]]))
    assert found.met[0] == (abs(e) <= 3.0)
    if abs(e) <= 3.0:
        low, high = max(-1.0, e - 2.0), min(1.0, e + 2.0)
        half, centre = np.sqrt(found.M[0, 0, 0]), found.centre[0, 0]
        assert centre - half <= low + 1e-9 and high - 1e-9 <= centre + half  # rounding of a search
    else:
        np.testing.assert_array_equal(found.M, np.ones((1, 1, 1)))
        np.testing.assert_array_equal(found.centre, [[0.0]])


def test_a_measurement_without_information_changes_nothing(rng):
    """Oracle: the first set, bit for bit, since lam = 0 is the best."""
    M = np.array([random_psd(rng, 2) for _ in range(3)])
    found = intersection(M, np.eye(2), 1e12 * np.eye(2), rng.standard_normal((3, 2)))
    np.testing.assert_allclose(found.M, M, **EXACT)
    np.testing.assert_allclose(found.centre, 0.0, **EXACT)


def test_flat_and_pointed_sets():
    """Oracle: the limit of sets with a thickness of 1e-10; a point meets what it explains."""
    M, C, R, e = np.diag([1.0, 0.0]), np.array([[1.0, 2.0]]), np.array([[0.3]]), np.array([[0.9]])
    flat, thick = (intersection(shape[None], C, R, e) for shape in (M, M + 1e-10 * np.eye(2)))
    np.testing.assert_allclose(flat.M, thick.M, atol=1e-8)
    np.testing.assert_allclose(flat.centre, thick.centre, atol=1e-8)
    zero = np.zeros((2, 2, 2))
    found = intersection(zero, C, R, np.array([[0.5], [0.6]]))
    np.testing.assert_array_equal(found.met, [True, False])  # 0.5^2 < 0.3 < 0.6^2
    np.testing.assert_array_equal(found.M, zero)
