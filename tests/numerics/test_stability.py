"""H-infinity norm, mean-square radius and zeros: closed forms, searches and constructed systems."""

from itertools import combinations

import numpy as np
import pytest
import sympy
from conftest import ROUND, SOLVER, within_stat

from rmpc_bench.numerics.stability import (
    controllable_states,
    hinf_peak,
    mean_square_radius,
    observable_states,
    spectral_radius,
    zeros,
)

A = np.array([[0.0, -0.5], [1.0, 1.0]])  # souto2011, section 5, and xie1994
H, G = np.array([[0.0], [10.0]]), np.array([[0.1, 0.03]])
NORM = {"rtol": 2e-10}  # what hinf_norm promises, and as much for the search
SLIP = {"rtol": 1e-7, "atol": 1e-7}  # zeros that are constructed or turned: well apart, but of pencils with a condition


def hinf_norm(A, B, C, D=None):
    """The largest gain."""
    return hinf_peak(A, B, C, D).norm


def gain(A, B, C, D, angles):
    """Largest singular value at some angles, by inverting z I - A at each."""
    return np.array([np.linalg.norm(C @ np.linalg.inv(np.exp(1j * a) * np.eye(len(A)) - A) @ B + D, 2) for a in angles])


def searched(A, B, C, D):
    """Largest gain by a search: a grid, dense about every pole, and golden sections about its best angles."""
    poles = np.linalg.eigvals(A)
    near = np.concatenate([np.angle(p) + (1 - abs(p)) * np.linspace(-5, 5, 41) for p in poles])
    grid = np.sort(np.abs(np.concatenate([np.linspace(0, np.pi, 500), near])))
    values = gain(A, B, C, D, grid)
    ratio, found = (np.sqrt(5) - 1) / 2, [values.max()]
    for i in np.argsort(values)[-10:]:
        low, high = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        for _ in range(60):
            step = ratio * (high - low)
            one, other = gain(A, B, C, D, [high - step, low + step])
            low, high = (low, low + step) if one > other else (high - step, high)
            found.append(max(one, other))
    return max(found)


def ordered(found):
    """Zeros in an order that rounding does not change."""
    return sorted(found, key=lambda z: (round(z.real, 6), z.imag))


def random_system(rng, n, m, p, radius):
    """Stable system with random matrices."""
    A = rng.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    return A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m))


@pytest.mark.parametrize("pole", [0.0, 0.5, -0.9, 0.999, -1 + 1e-9])
def test_norm_of_a_first_order_system(pole):
    """Oracle: a / (1 - |p|), at angle 0 or pi."""
    peak = hinf_peak(np.array([[pole]]), np.array([[2.0]]), np.array([[-1.5]]))
    np.testing.assert_allclose(peak.norm, 3.0 / (1.0 - abs(pole)), **NORM)
    assert pole == 0.0 or peak.angle == (0.0 if pole > 0.0 else np.pi)


def test_norm_of_two_uncertain_systems():
    """Oracle: |G(e^ia)|^2 = (0.34 - 0.3 c) / (2 c^2 - 3 c + 1.25) and 0.09 / (..), c = cos(a), by hand."""
    c = (1.36 - np.sqrt(1.36**2 - 4 * 0.6 * 0.645)) / 1.2
    souto, xie = hinf_peak(A, H, G), hinf_peak(A, H, np.array([[0.0, 0.03]]))
    np.testing.assert_allclose(souto.norm, np.sqrt((0.34 - 0.3 * c) / (2 * c**2 - 3 * c + 1.25)), **NORM)
    np.testing.assert_allclose(xie.norm, 0.6 * np.sqrt(2.0), **NORM)
    np.testing.assert_allclose(np.cos([souto.angle, xie.angle]), [c, 0.75], atol=1e-5)  # sqrt of the accuracy of a peak
    assert round(souto.norm, 5) == 1.00458  # the reference study, section 5


def test_norm_of_a_resonance_is_right_however_sharp():
    """Oracle: one over the distance of a pair of poles from the circle times that from each other, to first order."""
    for distance in (1e-3, 1e-6, 1e-9):
        r, a = 1.0 - distance, 1.1
        poles = r * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        peak = hinf_peak(poles, np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]]))  # r sin(a) / ((z - p)(z - p*))
        other = abs(np.exp(1j * peak.angle) - r * np.exp(-1j * a))
        np.testing.assert_allclose(peak.norm, r * np.sin(a) / distance / other, rtol=1e-6 + distance)
        assert abs(peak.angle - a) < distance


def test_norm_of_random_systems(rng):
    """Oracle: a search by frequency; the certified bound lies above every value and no further than it says."""
    for radius in (0.3, 0.9, 1 - 1e-4, 1 - 1e-6):
        for n, m, p in [(1, 2, 2), (2, 1, 1), (3, 2, 1), (4, 2, 3), (6, 3, 2)]:
            system = random_system(rng, n, m, p, radius)
            np.testing.assert_allclose(hinf_norm(*system), searched(*system), **NORM)


def test_norm_does_not_depend_on_units(rng):
    """Units of the state change nothing; those of input and output scale the norm."""
    A, B, C, D = random_system(rng, 4, 2, 2, 0.95)
    T = np.diag([1e-6, 1.0, 1e6, 10.0])
    norm = hinf_norm(A, B, C, D)
    np.testing.assert_allclose(hinf_norm(T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), D), norm, **NORM)
    np.testing.assert_allclose(hinf_norm(A, 1e6 * B, 1e-12 * C, 1e-6 * D), 1e-6 * norm, **NORM)


def test_norm_where_nothing_comes_through(rng):
    """A nilpotent loop (sayed2001), one that was turned, and one of B = 0; what is left is D."""
    plain = np.array([[0.9802, 0.0196], [0.0, 0.9802]])
    B, C = np.array([[0.0198], [0.0]]), np.array([[0.0, 5.0]])
    T = rng.standard_normal((2, 2))
    turned = T @ plain @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)
    for system in [(plain, B, C), turned, (plain, 0.0 * B, C)]:
        assert hinf_norm(*system) == 0.0
        assert hinf_norm(*system, D=np.array([[-2.0]])) == 2.0
    assert np.isnan(hinf_peak(plain, B, C).angle)


@pytest.mark.parametrize("pole", [1.0, -1.0, 1.5, -2.0])
def test_norm_of_an_unstable_mode(rng, pole):
    """Infinite where the mode leads from B to C; no trace of one that either does not reach, turned or not."""
    A = np.diag([0.5, pole, -0.3])
    A[0, 2] = 0.7
    B, C = np.array([[1.0], [1.0], [2.0]]), np.array([[1.0, 1.0, -1.0]])
    kept = [0, 2]
    norm = hinf_norm(A[np.ix_(kept, kept)], B[kept], C[:, kept])
    T = rng.standard_normal((3, 3))
    for b, c, expected in [(1, 1, np.inf), (0, 1, norm), (1, 0, norm), (0, 0, norm), (1e-6, 1e-6, np.inf)]:
        B[1], C[0, 1] = b, c
        for turn in (np.eye(3), T):
            back = np.linalg.inv(turn)
            np.testing.assert_allclose(hinf_norm(turn @ A @ back, turn @ B, C @ back), expected, **NORM)
    assert hinf_norm(np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])) == np.inf
    assert hinf_norm(np.array([[pole]]), np.array([[0.0]]), np.array([[1.0]])) == 0.0


def test_a_loop_is_on_the_brink_at_one_over_its_norm():
    """Oracle: the constant complex F of modulus 1/norm that turns the peak back puts an eigenvalue on the circle."""
    peak = hinf_peak(A, H, G)
    z = np.exp(1j * peak.angle)
    response = (G @ np.linalg.solve(z * np.eye(2) - A, H)).item()
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(A + H @ G / response)).max(), 1.0, **NORM)
    np.testing.assert_allclose(abs(1.0 / response), 1.0 / peak.norm, **NORM)


def test_mean_square_radius_of_the_benchmark():
    """Oracle: the reference study, section 5, for U[-1,1] and U[0,1], to the digits printed there."""
    assert [round(mean_square_radius(A, H, G, *law), 3) for law in [(0.0, 1 / 3), (0.5, 1 / 12)]] == [0.586, 0.764]


def test_mean_square_radius_without_variance(rng):
    """Limit: rho(A + mean H F G)^2, with F rectangular-diagonal."""
    A, H, G, _ = random_system(rng, 4, 2, 3, 0.9)
    expected = spectral_radius(A + 0.3 * H @ np.eye(2, 3) @ G) ** 2
    np.testing.assert_allclose(mean_square_radius(A, H, G, 0.3, 0.0), expected, **ROUND)
    np.testing.assert_allclose(mean_square_radius(A, 0.0 * H, G, 0.3, 7.0), 0.9**2, **ROUND)


@pytest.mark.parametrize(("r", "s"), [(1, 1), (2, 3), (3, 2)])
def test_mean_square_radius_by_iteration(rng, r, s):
    """Oracle: the covariance map itself, entry by entry of F, applied until it only scales."""
    A, H, G, _ = random_system(rng, 3, r, s, 0.8)
    mean, variance, P, growth = -0.2, 0.4, np.eye(3), []
    pairs = [np.outer(H[:, i], G[i]) for i in range(min(r, s))]
    mid = A + mean * sum(pairs)
    for _ in range(4000):  # one eigenvalue of a positive map is real and largest; others may be near in modulus
        P = mid @ P @ mid.T + variance * sum(M @ P @ M.T for M in pairs)
        growth.append(np.trace(P))
        P = P / growth[-1]
    np.testing.assert_allclose(
        mean_square_radius(A, H, G, mean, variance), np.exp(np.log(growth[2000:]).mean()), **SOLVER
    )


def test_mean_square_radius_by_simulation(rng):
    """Oracle: one step of many states whose second moment is the map's own, which it scales, under F drawn."""
    low, high = 0.0, 1.0
    mean, variance = (low + high) / 2, (high - low) ** 2 / 12
    mid, change = A + mean * H @ G, H @ G
    moment = np.kron(mid, mid) + variance * np.kron(change, change)
    values, vectors = np.linalg.eig(moment)
    X = vectors[:, np.argmax(np.abs(values))].real.reshape(2, 2)
    X = X / np.trace(X)
    x = rng.standard_normal((100_000, 2)) @ np.linalg.cholesky(X).T
    F = rng.uniform(low, high, (len(x), 1))
    after = ((x @ A.T + F * (x @ change.T)) ** 2).sum(axis=1)
    assert within_stat(after, mean_square_radius(A, H, G, mean, variance))


def test_zeros_of_the_benchmark():
    """Oracle: the determinant of the pencil of souto2011 is 610 z - 610."""
    Bw, C = np.array([[-6.0], [1.0]]), np.array([[-100.0, 10.0]])
    z = sympy.Symbol("z")
    pencil = sympy.Matrix([[0 - z, sympy.Rational(-1, 2), -6], [1, 1 - z, 1], [-100, 10, 0]])
    assert sympy.expand(pencil.det()) in (610 * z - 610, 610 - 610 * z)
    found = zeros(A, Bw, C)
    assert len(found) == 1 and abs(found[0] - 1.0) < 1e-12  # a condition of the order of 100


@pytest.mark.parametrize(
    ("n", "m", "rank"), [(1, 1, 1), (3, 1, 1), (3, 1, 0), (4, 2, 2), (4, 2, 1), (5, 3, 0), (6, 2, 0)]
)
def test_zeros_of_square_systems(rng, n, m, rank):
    """Oracle: roots of the determinant, from its values on a circle, for feedthroughs of any rank."""
    A, B, C, D = random_system(rng, n, m, m, 1.2)
    D = np.zeros((m, m)) if rank == 0 else D[:, :rank] @ D[:rank] if rank < m else D
    circle = np.exp(2j * np.pi * np.arange(n + 1) / (n + 1))
    values = [np.linalg.det(np.block([[A - z * np.eye(n), B], [C, D]])) for z in circle]
    coefficients = np.fft.fft(values).real / (n + 1)  # of z^0, z^1, ..
    degree = np.flatnonzero(np.abs(coefficients) > 1e-10 * np.abs(coefficients).max())[-1]
    expected = ordered(np.roots(coefficients[degree::-1]))
    np.testing.assert_allclose(ordered(zeros(A, B, C, D)), expected, **SLIP)


@pytest.mark.parametrize("excess", [1, 2, 3, 5])
def test_infinite_zeros_are_no_zeros(excess):
    """Oracle: a companion form with numerator (z - 0.5)(z + 2); the rest of the zeros is at infinity, in one chain."""
    n = 2 + excess
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = np.linspace(0.1, 0.5, n)
    B, C = np.eye(n)[:, -1:], np.zeros((1, n))
    C[0, :3] = [-1.0, 1.5, 1.0]
    np.testing.assert_allclose(ordered(zeros(A, B, C)), [-2.0, 0.5], **SLIP)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (2, 3), (3, 2), (1, 3)])
def test_constructed_zeros(rng, shape):
    """States that inputs do not reach add their poles; random systems that are not square have no zeros."""
    p, m = shape
    A, B, C, D = random_system(rng, 3, m, p, 0.9)
    own = zeros(A, B, C, D)
    assert len(own) == (3 if m == p else 0)
    pair = 0.6 * np.array([[0.8, -0.6], [0.6, 0.8]])
    wide = np.block([[A, rng.standard_normal((3, 3))], [np.zeros((3, 3)), np.diag([1.0, 0.0, 0.0])]])
    wide[4:, 4:] = pair  # three states that inputs do not reach, one of them on the circle
    B, C = np.vstack([B, np.zeros((3, m))]), np.hstack([C, rng.standard_normal((p, 3))])
    hidden = [1.0, 0.48 + 0.36j, 0.48 - 0.36j]
    expected = ordered([*own, *hidden])
    T = rng.standard_normal((6, 6))
    for turn in (np.eye(6), T):
        found = zeros(turn @ wide @ np.linalg.inv(turn), turn @ B, C @ np.linalg.inv(turn), D)
        if m >= p:
            np.testing.assert_allclose(ordered(found), expected, **SLIP)
        else:  # more outputs than inputs: the rank is that of the columns, which these states do not lower
            assert len(found) == 0
        lowered = [np.linalg.svd(np.block([[wide - z * np.eye(6), B], [C, D]]))[1].min() for z in found]
        assert np.all(np.array(lowered) < 1e-7)  # each takes a rank, as its definition says


@pytest.mark.parametrize("shape", [(2, 1, 1), (3, 2, 1), (3, 1, 2), (2, 2, 2), (3, 2, 2), (3, 2, 3)])
def test_zeros_by_their_definition(rng, shape):
    """Oracle: the largest common divisor of the largest minors that do not vanish, in whole numbers, by sympy."""
    n, m, p = shape
    z = sympy.Symbol("z")
    for _ in range(4):
        A, B, C, D = (rng.integers(-1, 2, size) for size in [(n, n), (n, m), (p, n), (p, m)])
        D = D * rng.integers(0, 2)
        pencil = sympy.Matrix(np.block([[A, B], [C, D]]).tolist()) - z * sympy.diag(sympy.eye(n), sympy.zeros(p, m))
        rank, divisor = pencil.subs(z, sympy.Rational(7, 5)).rank(), sympy.Integer(0)
        for rows in combinations(range(n + p), rank):
            for columns in combinations(range(n + m), rank):
                divisor = sympy.gcd(divisor, pencil[rows, columns].det(method="berkowitz"))
        roots = [complex(root) for root in sympy.Poly(divisor, z).nroots()] if divisor.has(z) else []
        found = ordered(zeros(*(M.astype(float) for M in (A, B, C, D))))
        np.testing.assert_allclose(found, ordered(roots), rtol=1e-4, atol=1e-4)  # some are threefold, right to 1e-5


def test_zeros_change_no_more_than_the_system(rng):
    """Feedback, output injection, units of input and output, and the dual system leave them where they are."""
    A, B, C, D = random_system(rng, 4, 2, 2, 0.9)
    D[:, 1] = 0.0
    expected = ordered(zeros(A, B, C, D))
    assert 0 < len(expected) < 4
    K, L = rng.standard_normal((2, 4)), rng.standard_normal((4, 2))
    for changed in [
        (A + B @ K, B, C + D @ K, D),
        (A + L @ C, B + L @ D, C, D),
        (A, 1e-6 * B, 1e4 * C, 1e-2 * D),
        (A.T, C.T, B.T, D.T),
    ]:
        np.testing.assert_allclose(ordered(zeros(*changed)), expected, **SLIP)


def test_zeros_where_nothing_comes_through():
    """Oracle: by the definition, they are the modes that the output does not see."""
    A, C = np.diag([0.5, 1.0, 2.0]), np.array([[1.0, 0.0, 1.0]])
    np.testing.assert_allclose(zeros(A, np.zeros((3, 2)), C), [1.0], **ROUND)
    assert len(zeros(A, np.eye(3), C)) == 0
    np.testing.assert_allclose(ordered(zeros(A, np.zeros((3, 1)), np.zeros((1, 3)))), [0.5, 1.0, 2.0], **ROUND)


def test_states_that_an_output_sees():
    """A double integrator is observable by its position and not by its velocity; its input reaches both."""
    A, position, velocity = np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(1, 2), np.eye(1, 2, 1)
    assert (observable_states(A, position), observable_states(A, velocity)) == (2, 1)
    assert controllable_states(A, velocity.T) == 2
