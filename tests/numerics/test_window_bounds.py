"""Windows of samples: their normal law against a large inverse, and the program with bounds by its conditions."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_psd
from scipy.optimize import nnls

from rmpc_bench.numerics.intervals import interval_of
from rmpc_bench.numerics.window_bounds import WindowBounds, WindowProgram
from rmpc_bench.numerics.window_posterior import WindowStages, range_root, window_posterior

NX, NY, STEPS = 3, 2, 4


def stages(rng, rank=NX, R_v=None):
    """Random matrices of a window, and a root of P."""
    A, C = 0.5 * rng.standard_normal((STEPS, NX, NX)), rng.standard_normal((STEPS + 1, NY, NX))
    R_v = random_psd(rng, NY) if R_v is None else R_v
    G = rng.standard_normal((STEPS, NX, rank))
    return WindowStages(A, G, C, np.broadcast_to(R_v, (STEPS + 1, NY, NY))), range_root(random_psd(rng, NX, rank=rank))


@pytest.mark.parametrize(
    ("rank", "R_v"), [(1, None), (3, None), (3, np.diag([0.0, 1.0])), (1, 1e-12 * np.eye(NY)), (3, 1e-12 * np.eye(NY))]
)
def test_law_of_a_window(rank, R_v, rng):
    """Oracle: the joint normal law, gain S = Phi', S the covariance of the residuals; a missing output has no gain."""
    given, P_root = stages(rng, rank, R_v)
    measured = np.ones((STEPS + 1, NY), dtype=bool)
    measured[2, 0] = measured[4, 1] = False
    found, there = window_posterior(given, P_root, measured), measured.ravel()
    Phi, gain = found.outputs[measured], found.gain[:, there]
    S = Phi @ Phi.T + np.kron(np.eye(STEPS + 1), given.R_v[0])[np.ix_(there, there)]
    # Rounding of sums of numbers of size 1 and of the entries of the gain.
    np.testing.assert_allclose(gain @ S, Phi.T, atol=1e-13 * max(1.0, np.abs(gain).max()))
    np.testing.assert_allclose(found.gain[:, ~there], 0.0, atol=1e-13 * max(1.0, np.abs(gain).max()))
    cov = np.eye(len(found.root)) - gain @ Phi
    np.testing.assert_allclose(found.root @ found.root.T, cov, atol=1e-12 * max(1.0, np.abs(gain).max()))


def test_states_and_outputs_of_a_window(rng):
    """Oracle: a simulation with the noises of a random xi."""
    given, P_root = stages(rng)
    found = window_posterior(given, P_root, np.ones((STEPS + 1, NY), dtype=bool))
    xi = rng.standard_normal(found.root.shape[0])
    x = P_root @ xi[:NX]
    for j in range(STEPS + 1):
        np.testing.assert_allclose(found.states[j] @ xi, x, atol=1e-13)  # sums of numbers of size 1
        np.testing.assert_allclose(found.outputs[j] @ xi, given.C[j] @ x, atol=1e-13)
        if j < STEPS:
            x = given.A[j] @ x + given.G[j] @ xi[NX * (j + 1) : NX * (j + 2)]


def test_root_of_a_covariance_in_any_units(rng):
    """Oracle: root root' and the rank, with coordinates 1e-8 and 1e8 times as large, one of them without noise."""
    Q = np.zeros((4, 4))
    Q[:3, :3] = random_psd(rng, 3, rank=2)
    for unit in (np.ones(4), np.array([1e-8, 1.0, 1e8, 1.0])):
        root = range_root(Q * unit[:, None] * unit)
        assert root.shape == (4, 2)
        np.testing.assert_allclose(root @ root.T / unit[:, None] / unit, Q, atol=1e-14)  # rounding of numbers of size 1
    assert range_root(np.zeros((2, 2))).shape == (2, 0)
    np.testing.assert_allclose(range_root(np.diag([4.0, 1e-20])) ** 2, [[0.0, 4.0], [1e-20, 0.0]], **ROUND)


def problem(rng, w=(-0.3, 0.4), x=(-0.5, 0.5), v=(-1.0, 1.0)):
    """Return a program with its law, the values with bounds and the data of six windows."""
    given, P_root = stages(rng)
    bounds = WindowBounds(interval_of(w, NX, "w"), interval_of(x, NX, "x"), interval_of(v, NY, "v"))
    measured = np.ones((STEPS + 1, NY), dtype=bool)
    law = window_posterior(given, P_root, measured)
    values = bounds.values(law, np.broadcast_to(np.eye(NX), (STEPS, NX, NX)), measured)
    x_bar, r = 0.1 * rng.standard_normal((6, STEPS + 1, NX)), rng.standard_normal((6, STEPS + 1, NY))
    return WindowProgram.of(law, values), law, values, given, (x_bar, r, bounds.base(x_bar, r))


def test_conditions_of_a_minimum(rng):
    """Oracle: KKT; the gradient of the cost is a sum of active rows with weights of the right sign, by SciPy's nnls."""
    program, law, values, given, (x_bar, r, base) = problem(rng, v=None)
    fits, (low, high) = program.fit(x_bar[:, -1], r.reshape(6, -1), base), values.interval
    weight = np.kron(np.eye(STEPS + 1), np.linalg.inv(given.R_v[0]))
    Phi, solved = law.outputs.reshape(-1, law.root.shape[0]), np.flatnonzero(fits.solved)
    assert len(solved) >= 3
    for i in solved:
        xi = minimum(program, law, values, r[i].ravel(), base[i])
        np.testing.assert_allclose(x_bar[i, -1] + law.states[-1] @ xi, fits.x[i], atol=1e-9)  # DAQP: 1e-10
        value = base[i] + values.E @ xi
        assert (value >= low - 1e-9).all() and (value <= high + 1e-9).all()  # DAQP: 1e-10 of a standard deviation
        gradient = xi + Phi.T @ weight @ (Phi @ xi - r[i].ravel())
        active = np.vstack([values.E[value - low < 1e-8], -values.E[high - value < 1e-8]])
        assert nnls(active.T, gradient)[1] < 1e-8 * np.linalg.norm(gradient)  # DAQP's 1e-10, times R_v^-1


def minimum(program, law, values, r, base):
    """Return the unknowns xi at the minimum, from the solution of the program."""
    free = program.size > 0.0
    value = base + program.value_gain @ r
    low, high = ((end - value)[free] / program.size[free] for end in values.interval)
    seen = program.program.A @ program.program.solve(np.zeros(len(program.program.H)), low, high).x
    # zeta is the shortest vector with these values of the rows.
    zeta = np.linalg.lstsq(values.E[free] @ law.root / program.size[free, None], seen, rcond=None)[0]
    return law.gain @ r + law.root @ zeta


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_a_violation_of_many_standard_deviations(size, rng):
    """Oracle: the problem is homogeneous; bounds and data that are `size` times as large have as large an answer."""
    program, *_, (x_bar, r, base) = problem(rng, v=None)
    larger, *_ = problem(np.random.default_rng(20180418), *((-0.3 * size, 0.4 * size), (-0.5 * size, 0.5 * size), None))
    one = program.fit(x_bar[:, -1], r.reshape(6, -1), base)
    many = larger.fit(size * x_bar[:, -1], size * r.reshape(6, -1), size * base)
    np.testing.assert_array_equal(many.solved, one.solved)
    np.testing.assert_allclose(many.x, size * one.x, **SOLVER)


def test_infinite_ends_are_no_bounds():
    """Oracle: the same interval with null and with infinity."""
    for pairs in ((0.0, None), (0.0, np.inf), [(0.0, None), (0.0, np.inf)]):
        found = interval_of(pairs, 2, "w")
        np.testing.assert_array_equal(found, [[0.0, 0.0], [np.inf, np.inf]])
    assert not interval_of(None, NX, "x").bounded.any()
