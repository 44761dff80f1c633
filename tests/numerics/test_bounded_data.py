"""The multiplier of least squares with bounded uncertainty against grids, another minimiser and brute force."""

import numpy as np
from conftest import random_psd
from scipy.optimize import minimize_scalar

from rmpc_bench.numerics.bounded_data import FARTHEST, NEAREST, search


class Problem:
    """min over z of z'Qz + lam |Ez - E_b|^2 + (Az - b)'(R - HH'/lam)^-1(Az - b), with the z of every lam spelt out."""

    def __init__(self, rng, nz=3, ny=2, ne=2, size=1.0):
        self.Q, self.R = random_psd(rng, nz), random_psd(rng, ny)
        self.A, self.E = rng.standard_normal((ny, nz)), rng.standard_normal((ne, nz))
        self.H = 0.3 * rng.standard_normal((ny, 2))
        self.b, self.E_b = rng.standard_normal(ny), size * rng.standard_normal(ne)
        self.lam_l = np.linalg.norm(self.H.T @ np.linalg.inv(self.R) @ self.H, 2)

    def G(self, lam):
        """Value at the best z, by normal equations."""
        W = np.linalg.inv(self.R - self.H @ self.H.T / lam)
        left = self.Q + lam * self.E.T @ self.E + self.A.T @ W @ self.A
        z = np.linalg.solve(left, self.A.T @ W @ self.b + lam * self.E.T @ self.E_b)
        r, s = self.A @ z - self.b, self.E @ z - self.E_b
        return z @ self.Q @ z + lam * s @ s + r @ W @ r

    @property
    def parts(self):
        """N at mu = 0, and the data."""
        rows = np.vstack([self.E, self.A])
        fixed = rows @ np.linalg.solve(self.Q, rows.T)
        fixed[len(self.E) :, len(self.E) :] += self.R
        return fixed, np.concatenate([self.E_b, self.b])

    @property
    def slope(self):
        """Derivative of N by mu."""
        slope = np.eye(len(self.E) + len(self.A))
        slope[len(self.E) :, len(self.E) :] = -self.H @ self.H.T
        return slope

    def found(self):
        """Lam of the search."""
        fixed, d = self.parts
        return 1.0 / search(fixed[None], self.slope, d[None], self.lam_l)[0]


def test_it_is_the_least_value_of_the_cost(rng):
    """Oracle: a logarithmic grid of lam/lam_l - 1 over the whole range, refined by Brent's method."""
    inside = 0
    for size in [0.0, *np.logspace(-1, 0.5, 39)]:
        problem = Problem(rng, size=size)
        grid = np.log(10.0) * np.linspace(-8.0, 8.0, 400)

        def cost(t, problem=problem):
            return problem.G(problem.lam_l * (1.0 + np.exp(t)))

        values = [cost(t) for t in grid]
        i = int(np.argmin(values))
        ends = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        best = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-12})
        found, least = problem.found(), min(best.fun, values[i])
        # The normal equations lose seven digits where R - HH'/lam is nearly singular.
        assert problem.G(found) <= least * (1.0 + 1e-6)
        if -5.0 < best.x < 5.0:
            inside += 1
            assert problem.G(found) <= least * (1.0 + 1e-10)
            # The cost is flat to rounding within the square root of the rounding unit.
            np.testing.assert_allclose(found, problem.lam_l * (1.0 + np.exp(best.x)), rtol=1e-4)
    assert inside >= 5


def test_the_value_is_convex_in_the_inverse(rng):
    """Oracle: second differences of G on a grid of 1/lam, which the search relies on."""
    for _ in range(20):
        problem = Problem(rng)
        mu = np.linspace(0.01, 0.99, 60) / problem.lam_l
        assert (np.diff([problem.G(1.0 / each) for each in mu], 2) > -1e-9).all()


def test_a_problem_in_closed_form():
    """Oracle: E = A = H = Q = R = 1 by hand; with N = [[1 + mu, 1], [1, 2 - mu]] and d = (-1, 2).

    d'N^-1 d = (10 + 3 mu) / (1 + mu - mu^2) has its least value where 3 mu^2 + 20 mu - 7 = 0, for mu in (0, 1).
    """
    fixed, slope = np.array([[[1.0, 1.0], [1.0, 2.0]]]), np.diag([1.0, -1.0])
    mu = search(fixed, slope, np.array([[-1.0, 2.0]]), 1.0)
    np.testing.assert_allclose(mu, (-20.0 + np.sqrt(484.0)) / 6.0, rtol=1e-11)


def test_it_stays_within_its_range():
    """Oracle: the monotonic cases: d = (1, 0) wants the largest mu, d = (0, 1) the smallest one."""
    fixed, slope = np.tile(np.diag([1.0, 2.0]), (3, 1, 1)), np.diag([1.0, -1.0])
    mu = search(fixed, slope, np.array([[1.0, 0.0], [0.0, 1.0], [np.nan, 1.0]]), 1.0)
    # mu is accurate to 1e-12 of its range, which ends at 1e-9 on one side.
    np.testing.assert_allclose(1.0 / mu[:2], [1.0 + NEAREST, FARTHEST], rtol=1e-6)
    assert np.isnan(mu[2])


def test_no_row_depends_on_another_one(rng):
    """Oracle: every row alone, bit for bit, beside rows at the ends of the range and one that is not finite."""
    problem = Problem(rng)
    P = np.array([random_psd(rng, 4) for _ in range(9)])
    d = rng.standard_normal((9, 4)) * np.logspace(-3, 3, 9)[:, None]
    d[4, 0], P[6, 1, 1] = np.inf, np.nan
    fixed = P + np.pad(problem.R, ((2, 0), (2, 0)))
    mu = search(fixed, problem.slope, d, problem.lam_l)
    for i in range(9):
        np.testing.assert_array_equal(search(fixed[i : i + 1], problem.slope, d[i : i + 1], problem.lam_l)[0], mu[i])
    assert np.isnan(mu[[4, 6]]).all() and np.isfinite(np.delete(mu, [4, 6])).all()
