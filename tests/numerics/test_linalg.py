"""Matrix helpers against quadrature, SciPy and the house's rule of bit-identical rows."""

import numpy as np
import pytest
from conftest import ROUND, random_psd
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad_vec
from scipy.linalg import expm
from scipy.signal import cont2discrete

from rmpc_bench.models.servo import TABLE_1, continuous
from rmpc_bench.numerics.linalg import (
    as_covariance,
    as_matrix,
    as_vector,
    discretise,
    mv,
    psd_sqrt,
    symmetrise,
    van_loan,
)
from rmpc_bench.numerics.square_root import root_of


@pytest.mark.parametrize("n", [1, 2, 4])
def test_discretise_equals_the_quadrature_of_the_held_input(n, rng):
    """Oracle: adaptive quadrature of e^(A s) B."""
    A, B, Ts = rng.standard_normal((n, n)), rng.standard_normal((n, 2)), 0.3
    E, G = discretise(A, B, Ts)
    np.testing.assert_allclose(E, expm(A * Ts), **ROUND)
    np.testing.assert_allclose(G, quad_vec(lambda s: expm(A * s) @ B, 0.0, Ts, epsabs=1e-13)[0], atol=1e-11)


@pytest.mark.parametrize("m", [1, 3])
@pytest.mark.parametrize("n", [1, 2, 4, 7])
def test_a_stack_is_discretised_as_its_matrices(n, m, rng):
    """Oracle: one by one, bit for bit; norms from 1e-9 to 1e3, triangular and diagonal matrices, zeros, inf and NaN."""
    A = rng.standard_normal((30, n, n)) * 10.0 ** rng.uniform(-9.0, 3.0, (30, 1, 1))
    B = rng.standard_normal((30, n, m))
    A[5], A[6], A[7], A[8] = np.triu(A[5]), np.tril(A[6]), np.diag(np.diag(A[7])), 0.0
    A[9, 0, 0], A[10, 0, 0], B[11, 0, 0] = np.inf, np.nan, 1e300
    B[6:9] = 0.0
    with np.errstate(all="ignore"):
        found = discretise(A, B, 0.3)
        for row in range(30):
            for stacked, alone in zip(found, discretise(A[row], B[row], 0.3), strict=True):
                np.testing.assert_array_equal(stacked[row], alone)


def test_discretise_equals_scipy_where_A_is_singular():
    """Oracle: scipy.signal; the servomechanism has a pole at 0, so A^-1 (e^(A Ts) - I) B would not do."""
    A, B = continuous(TABLE_1)
    E, G = discretise(A, B, 0.1)
    E_scipy, G_scipy, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 1))), 0.1)
    np.testing.assert_allclose(E, E_scipy, atol=1e-13)
    np.testing.assert_allclose(G, G_scipy, atol=1e-15)


def noise_by_quadrature(A, S, Ts):
    """Covariance of the sampled noise, integrated numerically."""
    return quad_vec(lambda s: expm(A * s) @ S @ expm(A * s).T, 0.0, Ts, epsabs=0.0, epsrel=1e-12)[0]


@pytest.mark.parametrize("n", [1, 2, 4])
def test_van_loan_equals_the_quadrature(n, rng):
    """Oracle: adaptive quadrature of e^(A s) S e^(A' s)."""
    A, S, Ts = rng.standard_normal((n, n)), random_psd(rng, n), 0.3
    np.testing.assert_allclose(van_loan(A, S, Ts), noise_by_quadrature(A, S, Ts), rtol=0, atol=1e-11)


def test_van_loan_of_a_double_integrator_is_the_textbook_matrix():
    """Oracle: closed form; q [T^3/3, T^2/2; T^2/2, T] for noise on the acceleration."""
    T, q = 0.7, 2.5
    Q = van_loan(np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, q]), T)
    np.testing.assert_allclose(Q, q * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]]), **ROUND)


@pytest.mark.parametrize("J_m", [0.5, 0.05, 0.01])
def test_van_loan_is_accurate_for_fast_poles(J_m):
    """Oracle: quadrature; a light motor has a pole at -5.1/J_m, so that e^(-A Ts) is large."""
    A, _ = continuous({**TABLE_1, "J_m": J_m})
    Q = noise_by_quadrature(A, np.eye(4), 0.1)
    np.testing.assert_allclose(van_loan(A, np.eye(4), 0.1), Q, rtol=0, atol=1e-10 * np.abs(Q).max())


@pytest.mark.parametrize("rank", [0, 2, 4])
def test_psd_sqrt_squares_to_the_matrix(rank, rng):
    """Oracle: the definition, singular matrices included."""
    P = random_psd(rng, 4, 1e4, rank)
    S = psd_sqrt(P)
    np.testing.assert_array_equal(S, S.T) if rank == 0 else np.testing.assert_allclose(S, S.T, atol=1e-15)
    np.testing.assert_allclose(S @ S, P, atol=1e-14)


def test_symmetrise_keeps_the_symmetric_part():
    """Oracle: by hand."""
    np.testing.assert_array_equal(symmetrise(np.array([[1.0, 2.0], [4.0, 3.0]])), [[1.0, 3.0], [3.0, 3.0]])


LAYOUTS = {
    "rows": lambda x: x,
    "slice": lambda x: np.stack([x, -x, 2 * x], axis=1)[:, 0],
    "columns": np.asfortranarray,
}


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(max_examples=30)
@given(st.integers(1, 8), st.integers(1, 8), st.integers(1, 60), st.integers(0, 2**31))
def test_mv_gives_every_row_the_bits_it_has_alone(layout, n, m, runs, seed):
    """Oracle: a batch of one, whatever the memory layout of the batch; shared and per-run matrices."""
    rng = np.random.default_rng(seed)
    shared, own = rng.standard_normal((n, m)), rng.standard_normal((runs, n, m))
    x = LAYOUTS[layout](rng.standard_normal((runs, m)))
    for i in {0, runs // 2, runs - 1}:
        one = np.ascontiguousarray(x[i : i + 1])
        np.testing.assert_array_equal(mv(shared, x)[i], mv(shared, one)[0])
        np.testing.assert_array_equal(mv(own, x)[i], mv(own[i : i + 1], one)[0])


def test_mv_equals_the_matrix_product(rng):
    """Oracle: BLAS."""
    A, own, x = rng.standard_normal((3, 4)), rng.standard_normal((9, 3, 4)), rng.standard_normal((9, 4))
    np.testing.assert_allclose(mv(A, x), x @ A.T, atol=1e-14)
    np.testing.assert_allclose(mv(own, x), (own @ x[:, :, None])[:, :, 0], atol=1e-14)


def test_as_matrix_expands_numbers_diagonals_and_matrices():
    """Oracle: product.md section 4, Numbers."""
    np.testing.assert_array_equal(as_matrix(2.0, 2), [[2.0, 0.0], [0.0, 2.0]])
    np.testing.assert_array_equal(as_matrix([1.0, 2.0], 2), [[1.0, 0.0], [0.0, 2.0]])
    np.testing.assert_array_equal(as_matrix([[1.0, 2.0], [3.0, 4.0]], 2), [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(as_matrix([[3.0]], 1), [[3.0]])
    with pytest.raises(ValueError, match=r"\(3,\).*2 numbers"):
        as_matrix([1.0, 2.0, 3.0], 2)


def test_as_vector_expands_numbers_and_lists():
    """Oracle: product.md section 4, Numbers."""
    np.testing.assert_array_equal(as_vector(2.0, 3), [2.0, 2.0, 2.0])
    np.testing.assert_array_equal(as_vector([1.0, 2.0], 2), [1.0, 2.0])
    with pytest.raises(ValueError, match=r"\(3,\).*2 numbers"):
        as_vector([1.0, 2.0, 3.0], 2)


@pytest.mark.parametrize(
    ("value", "message"),
    [([[1.0, 2.0], [0.0, 1.0]], "symmetric"), ([1.0, -1e-3], "semidefinite"), ([[1.0, 2.0], [2.0, 1.0]], "smallest")],
)
def test_as_covariance_refuses_what_is_not_one(value, message):
    """Oracle: by hand; the last matrix has the eigenvalues 3 and -1."""
    with pytest.raises(ValueError, match=message):
        as_covariance(value, 2)


def test_as_covariance_accepts_a_singular_matrix_at_any_scale():
    """Oracle: v v' has rank one; rounding of its eigenvalues is not a negative covariance."""
    v = np.array([1.0, 3.0, -7.0])
    for scale in (1e-30, 1.0, 1e30):
        np.testing.assert_array_equal(as_covariance(scale * np.outer(v, v), 3), scale * np.outer(v, v))


def test_a_singular_matrix_leaves_the_roots_beside_it(rng):
    """Oracle: every matrix alone."""
    P = np.stack([random_psd(rng, 2, 2), random_psd(rng, 2, 1), random_psd(rng, 2, 2)])
    for whole, alone in zip(root_of(P), P, strict=True):
        np.testing.assert_array_equal(whole, root_of(alone))
