"""Windows of bounded noises against the programs as the paper prints them, and their kernels against plain loops."""

import numpy as np
import pytest
from numerics import lp_twin

from rmpc_bench.numerics import bounded_window
from rmpc_bench.numerics.bounded_window import (
    AGE,
    PROCESS,
    MeasurementWindow,
    fit_anchored,
    fit_free,
    full_matrix,
    least_noise_fit,
    multiplier_sums,
    predicted,
    reduced,
)
from rmpc_bench.numerics.minimax import FitOutcome, fit

TS = 0.01
CLOSE = 1e-9  # data of size 1; SciPy keeps bounds to 1e-10


def integrators(rng, runs, points, axes=3, coupling=0.9, places=None):
    """Windows of coupled double integrators as the robot has them, their noise of size 1; and the output matrix."""
    places, nx = places or points, 2 * axes
    A = np.tile(np.eye(nx), (runs, places, 1, 1))
    A[:, :, :axes, axes:] += TS * np.eye(axes)
    A[:, :, axes:, axes:] += TS * rng.uniform(-coupling, coupling, (runs, places, axes, axes))
    c, x = rng.standard_normal((runs, places, nx)), 100.0 * rng.standard_normal((runs, nx))
    before, y = np.empty((runs, places, nx)), np.empty((runs, places, axes))
    for j in range(places):
        before[:, j] = x + rng.uniform(-1.0, 1.0, (runs, nx))
        x = np.einsum("rij,rj->ri", A[:, j], x) + c[:, j]
        y[:, j] = x[:, :axes] + rng.uniform(-1.0, 1.0, (runs, axes))
    return MeasurementWindow(y, A, c, before), np.eye(axes, nx)[None]


def data(window, C, i, points, anchored=False):
    """One run as the twin takes it."""
    first = window.y.shape[1] - points
    y, A, c, before = (each[i, first:] for each in window)
    return lp_twin.Data(y, A, c, np.broadcast_to(C, (points, *C.shape[1:])), before[0], anchored)


@pytest.mark.parametrize("points", [3, 4, 5, 6, 9])
def test_free_windows_are_the_full_program(points, rng):
    """Oracle: linprog on (17)-(19) with all unknowns; beyond four points x need not be unique."""
    window, C = integrators(rng, 12, points)
    fits = fit_free(window, C, points)
    assert fits.solved.all() and (points > 4 or not fits.rho.any())
    for i in range(12):
        objective, x, rho, r = lp_twin.solve(data(window, C, i, points))
        assert abs(objective - fits.rho[i].sum() - fits.r[i].sum()) < CLOSE
        if points <= 4:
            np.testing.assert_allclose(fits.x[i, :3], x[:3], rtol=CLOSE)
            np.testing.assert_allclose(fits.x[i, 3:], x[3:], rtol=CLOSE / TS)
            np.testing.assert_allclose(np.r_[fits.rho[i], fits.r[i]], np.r_[rho, r], atol=CLOSE)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_many_windows_of_four_points_are_the_full_program(seed):
    """Oracle: linprog; none of these asks for the full program, so the certificate is what is tested."""
    rng = np.random.default_rng(seed)
    window, C = integrators(rng, 100, 4)
    fits = fit_free(window, C, 4)
    for i in range(100):
        objective, x, _, r = lp_twin.solve(data(window, C, i, 4))
        assert abs(objective - fits.r[i].sum()) < CLOSE
        np.testing.assert_allclose(fits.x[i], x, rtol=CLOSE / TS)
        np.testing.assert_allclose(fits.r[i], r, atol=CLOSE)


@pytest.mark.parametrize("anchored", [False, True])
def test_an_interior_point_method_agrees(anchored, rng):
    """Oracle: cvxpy with Clarabel on (17)-(19)."""
    window, C = integrators(rng, 3, 4)
    fits = (fit_anchored if anchored else fit_free)(window, C, 4)
    for i in range(3):
        objective, x, rho, r = lp_twin.solve_with_cvxpy(data(window, C, i, 4, anchored))
        assert abs(objective - fits.rho[i].sum() - fits.r[i].sum()) < 1e-7  # its own gap is 1e-9 of sums of size 100
        if not anchored:
            np.testing.assert_allclose(fits.x[i, :3], x[:3], rtol=1e-7)
            np.testing.assert_allclose(fits.r[i], r, atol=1e-6)


@pytest.mark.parametrize("points", [1, 4])
def test_anchored_windows_are_the_full_program(points, rng):
    """Oracle: linprog on (17)-(19) with a state equation for the first point."""
    window, C = integrators(rng, 6, points)
    fits = fit_anchored(window, C, points)
    assert fits.solved.all()
    for i in range(6):
        objective, _, _, _ = lp_twin.solve(data(window, C, i, points, True))
        assert abs(objective - fits.rho[i].sum() - fits.r[i].sum()) < CLOSE


@pytest.mark.parametrize("anchored", [False, True])
def test_the_output_matrix_may_be_another_one_at_every_point(anchored, rng):
    """Oracle: linprog on (17)-(19); rho > 0 comes from the full program.  Its outputs are far off: C is not theirs."""
    window, C = integrators(rng, 6, 6)
    C = C + 0.3 * rng.standard_normal((6, 3, 6))
    fits = (fit_anchored if anchored else fit_free)(window, C, 6)
    assert fits.solved.all() and (fits.rho.sum(axis=1) > 1.0).all()
    for i in range(6):
        one = data(window, C, i, 6, anchored)
        objective, _, _, _ = lp_twin.solve(one)
        size = np.abs(predicted(window, C, 6, anchored=anchored)[1][i]).max()
        assert abs(objective - fits.rho[i].sum() - fits.r[i].sum()) < CLOSE * size


@pytest.mark.parametrize(
    ("points", "anchored", "process"), [(4, True, PROCESS), (9, False, PROCESS), (4, True, 0.5), (9, False, 0.5)]
)
def test_what_is_chosen_among_many_optima_is_unique(points, anchored, process, rng):
    """Oracle: the face of both objectives, by linprog: the widths of the last state are what two tolerances allow.

    Without the weights it is wide, which is why they are there.
    """
    window, C = integrators(rng, 4, points)
    fits, widest = (fit_anchored if anchored else fit_free)(window, C, points, process), 0.0
    for i in range(4):
        one = data(window, C, i, points, anchored)
        ends = lp_twin.chosen(one, AGE, process)
        np.testing.assert_allclose(ends, np.tile(fits.x[i, :3], (2, 1)), atol=2e-3)  # flat corners of a face 1e-7 wide
        widest = max(widest, np.ptp(lp_twin.chosen(one, 1.0, 1.0), axis=0).max())
    assert widest > 0.05  # of a noise of size 1


def test_the_certificate_decides_as_the_full_program(rng):
    """Oracle: linprog; sums of |lam| below 1 mean rho = 0, above 1 rho > 0.  At 1 there are optima of both kinds."""
    seen = {False: 0, True: 0}
    for points in range(3, 10):
        window, C = integrators(rng, 12, points)
        _, d = predicted(window, C, points, anchored=False)
        F, _ = reduced(window, C, points)
        largest = multiplier_sums(window, C, points, fit(F, d, np.tile(np.arange(3), points)).mu).max(axis=1)
        assert points > 4 or largest.max() < 0.9
        for i in np.flatnonzero(np.abs(largest - 1.0) > 1e-6):
            _, _, rho, _ = lp_twin.solve(data(window, C, i, points))
            assert (largest[i] < 1.0) == (rho.sum() < 1e-7)
            seen[largest[i] < 1.0] += 1
    assert min(seen.values()) > 5


def test_the_paths_and_prices_are_those_of_plain_loops(rng):
    """Oracle: the recursions of the module's docstring, with a window that has more places than points."""
    window, C = integrators(rng, 5, 4, places=6)
    C = C + 0.1 * rng.standard_normal((4, 3, 6))
    mu = rng.standard_normal((5, 12))
    F, moved = reduced(window, C, 4)
    price = multiplier_sums(window, C, 4, mu)
    for anchored in (False, True):
        path, d = predicted(window, C, 4, anchored=anchored)
        for i in range(5):
            one = data(window, C, i, 4)._replace(C=C, before=window.before[i, 2 if anchored else 3])
            expected = lp_twin.path(one._replace(anchored=anchored))
            np.testing.assert_allclose(path[i], expected, rtol=1e-12)
            np.testing.assert_allclose(
                d[i], (one.y - np.einsum("jox,jx->jo", C, expected)).ravel(), atol=1e-11
            )  # of sums of size 100
    for i in range(5):
        Phi, lam, sums = lp_twin.transitions(window.A[i, 2:]), np.zeros(6), np.zeros(6)
        np.testing.assert_allclose(F[i], np.concatenate(C @ Phi), atol=1e-13)
        np.testing.assert_allclose(moved[i], Phi[-1], atol=1e-13)
        for j in (3, 2, 1):
            lam = (window.A[i, 3 + j].T @ lam if j < 3 else 0.0) + C[j].T @ mu[i, 3 * j : 3 * j + 3]
            sums += np.abs(lam)
        np.testing.assert_allclose(price[i], sums, rtol=1e-12)


def test_the_first_price_is_what_the_reduced_dual_demands(rng):
    """Oracle: F' mu = A' lam + C' mu at the first point, the identity behind the certificate."""
    window, C = integrators(rng, 1, 4)
    F, _ = reduced(window, C, 4)
    mu, lam = rng.standard_normal(12), np.zeros(6)
    for j in (3, 2, 1, 0):
        lam = (window.A[0, j + 1].T @ lam if j < 3 else 0.0) + C[0].T @ mu[3 * j : 3 * j + 3]
    np.testing.assert_allclose(F[0].T @ mu, lam, rtol=1e-12)


def test_no_noise_is_fitted_exactly_and_at_once(rng, monkeypatch):
    """Oracle: the states that made the data; the full program is not asked, even where rounding is all there is."""
    monkeypatch.setattr(bounded_window, "least_noise_fit", None)
    window, C = integrators(rng, 8, 4)
    x = window.before[:, 0]
    before, y = np.empty_like(window.before), np.empty_like(window.y)
    for j in range(4):
        before[:, j], x = x, np.einsum("rij,rj->ri", window.A[:, j], x) + window.c[:, j]
        y[:, j] = x[:, :3]
    for start in (before, before + rng.standard_normal(before.shape)):  # right and wrong estimates before
        fits = fit_free(MeasurementWindow(y, window.A, window.c, start), C, 4)
        assert fits.solved.all() and not fits.rho.any() and fits.r.max() < 1e-10  # roundings of sums of size 100
        np.testing.assert_allclose(fits.x, x, atol=1e-8)  # a velocity: those divided by Ts


@pytest.mark.parametrize("fitted", [fit_free, fit_anchored])
def test_rows_do_not_depend_on_each_other(fitted, rng):
    """Oracle: every row alone, bit for bit, also beside rows without a number; these are not solved."""
    window, C = integrators(rng, 6, 6)
    window.y[1, 2, 0], window.A[3, 4, 1, 1], window.c[4, 3, 2] = np.nan, np.inf, np.nan
    together = fitted(window, C, 6)
    np.testing.assert_array_equal(together.solved, [True, False, True, False, False, True])
    assert np.isnan(together.x[[1, 3, 4]]).any(axis=1).all() and np.isfinite(together.x[together.solved]).all()
    for i in range(6):
        alone = fitted(MeasurementWindow(*(each[i : i + 1] for each in window)), C, 6)
        for a, b in zip(alone, together, strict=True):
            np.testing.assert_array_equal(a, b[i : i + 1])


def test_a_solver_that_fails_leaves_the_row_unsolved(rng, monkeypatch):
    """Oracle: by construction."""
    monkeypatch.setattr(bounded_window, "least_noise_fit", lambda *_: None)
    window, C = integrators(rng, 3, 4)
    fits = fit_anchored(window, C, 4)
    assert not fits.solved.any() and np.isnan(fits.rho).all() and np.isnan(fits.x).all()


def test_ties_are_left_to_the_full_program(monkeypatch):
    """Oracle: by hand; a constant c is measured twice, as (0, .3, .3) and as (1, .25, .4).

    The bounds are c and 1 - c for c from .15 to .625, whatever the prices, which are 0 behind the first point; the sum
    of |y - c| is least where the noises below and above weigh the same, at the .3 of the last point.
    """
    calls = []
    monkeypatch.setattr(
        bounded_window, "least_noise_fit", lambda *given: calls.append(given) or least_noise_fit(*given)
    )
    y = np.array([[[0.0, 1.0], [0.3, 0.25], [0.3, 0.4]]])
    window = MeasurementWindow(y, np.ones((1, 3, 1, 1)), np.zeros((1, 3, 1)), np.zeros((1, 3, 1)))
    C, group = np.ones((1, 2, 1)), np.tile([0, 1], 3)
    tied = fit(reduced(window, C, 3)[0], predicted(window, C, 3, anchored=False)[1], group)
    assert tied.outcome[0] == FitOutcome.OPTIMAL and abs(tied.x[0, 0] - 0.3) > 0.1
    np.testing.assert_array_equal(multiplier_sums(window, C, 3, tied.mu), [[0.0]])
    fits = fit_free(window, C, 3)
    assert len(calls) == 1 and fits.solved.all()
    np.testing.assert_allclose(fits.x, [[0.3]], atol=CLOSE)
    np.testing.assert_allclose(np.r_[fits.r[0], fits.rho[0]], [0.3, 0.7, 0.0], atol=CLOSE)


@pytest.mark.parametrize(("size", "solved"), [(0.0, True), (1e5, True), (1e7, False)])
def test_outputs_whose_sizes_differ_too_much_are_refused(size, solved):
    """Oracle: by hand; two unknowns, each halfway between its data: 0 and the size, 0 and 1; no data have no size."""
    F, d, group = np.kron(np.eye(2), np.ones((2, 1))), np.array([0.0, size, 0.0, 1.0]), np.array([0, 0, 1, 1])
    answer = least_noise_fit(F, d, group, np.ones(4))
    assert (answer is not None) == solved
    if solved:
        np.testing.assert_allclose(answer, [[0.5 * size, 0.5]] * 2, rtol=1e-6)  # 1e-10 of the larger one


def test_full_matrix_has_one_row_per_equation(rng):
    """Oracle: C x(j) and x(j) - A x(j-1) of some states."""
    window, C = integrators(rng, 2, 3)
    x = rng.standard_normal((3, 6))
    for anchored in (False, True):
        F = full_matrix(window, C, 3, anchored=anchored)
        steps = [x[j] - (window.A[1, j] @ x[j - 1] if j else 0.0) for j in range(0 if anchored else 1, 3)]
        np.testing.assert_allclose(F[1] @ x.ravel(), np.r_[(x @ C[0].T).ravel(), np.concatenate(steps)], rtol=1e-12)
