"""Windows of samples: their normal law against a large inverse, and the program with bounds by another solver."""

from typing import NamedTuple

import mpmath as mp
import numpy as np
import pytest
import quadprog
from conftest import ROUND, SOLVER, random_psd

from rmpc_bench.numerics.intervals import interval_of
from rmpc_bench.numerics.window_posterior import WindowBounds, WindowProgram, WindowStages, range_root

NX, NY, STEPS = 3, 2, 4


def stages(rng, rank=NX, R_v=None):
    """Random matrices of a window, and a root of P."""
    A, C = 0.5 * rng.standard_normal((STEPS, NX, NX)), rng.standard_normal((STEPS + 1, NY, NX))
    R_v = random_psd(rng, NY) if R_v is None else R_v
    G = rng.standard_normal((STEPS, NX, rank))
    return WindowStages(
        A, np.broadcast_to(np.eye(NX)[:, :rank], G.shape), G, C, np.broadcast_to(R_v, (STEPS + 1, NY, NY))
    ), range_root(random_psd(rng, NX, rank=rank))


class Dense(NamedTuple):
    """A window without the filter: states and outputs as functions of xi, from powers of A."""

    states: np.ndarray
    outputs: np.ndarray
    noises: np.ndarray

    def values(self):
        """The noises of all steps, the states, then the noises of the outputs of all samples."""
        n = self.states.shape[-1]
        return np.concatenate([each.reshape(-1, n) for each in (self.noises, self.states, -self.outputs)])


def dense(given, P_root, measured):
    """Fill the matrices of the unknowns xi entry by entry."""
    n0, n = P_root.shape[1], P_root.shape[1] + STEPS * given.G.shape[2]
    states, noises = np.zeros((STEPS + 1, NX, n)), np.zeros((STEPS, len(given.W[0]), n))
    states[0, :, :n0] = P_root
    for j in range(STEPS):
        places = slice(n0 + j * given.G.shape[2], n0 + (j + 1) * given.G.shape[2])
        states[j + 1] = given.A[j] @ states[j]
        states[j + 1, :, places], noises[j, :, places] = given.G[j], given.W[j]
    return Dense(states, np.where(measured[:, :, None], given.C @ states, 0.0), noises)


def filtered(given, L, x, y):
    """Predictions and innovations of a filter with the gains L; what is added in a step is 0."""
    states, innovations = [x], []
    for j in range(STEPS + 1):
        innovations.append(np.where(np.isnan(y[j]), 0.0, y[j] - given.C[j] @ states[-1]))
        if j < STEPS:
            states.append(given.A[j] @ (states[-1] + L[j] @ innovations[-1]))
    return np.array(states), np.array(innovations)


EVERY = WindowBounds(*(interval_of((-1.0, 1.0), n, "w") for n in (NX, NX, NY)))


@pytest.mark.parametrize(
    ("rank", "R_v"), [(1, None), (3, None), (3, np.diag([0.0, 1.0])), (1, 1e-12 * np.eye(NY)), (3, 1e-12 * np.eye(NY))]
)
def test_law_of_a_window(rank, R_v, rng):
    """Oracle: the joint normal law of all values and outputs; a missing output has no gain."""
    given, P_root = stages(rng, rank, R_v)
    measured = np.ones((STEPS + 1, NY), dtype=bool)
    measured[2, 0] = measured[4, 1] = False
    (*_, found), there, full = EVERY.laws(given, P_root, measured), measured.ravel(), dense(given, P_root, measured)
    Phi, E, order = full.outputs[measured], full.values(), np.argsort(found.kind, kind="stable")
    noise = np.kron(np.eye(STEPS + 1), given.R_v[0])[np.ix_(there, there)]
    with mp.workdps(60):  # the covariance of the outputs has conditions up to 1e14
        P, Q = mp.matrix(Phi.tolist()), mp.matrix(E.tolist())
        exact = Q * P.T * mp.inverse(P * P.T + mp.matrix(noise.tolist()))
        gain, cov = (np.array(each.tolist(), dtype=float) for each in (exact, Q * Q.T - exact * P * Q.T))
    x, y = rng.standard_normal(NX), np.where(measured, rng.standard_normal((STEPS + 1, NY)), np.nan)
    x_bar, e = filtered(given, found.L, x, y)
    free = filtered(given, np.zeros_like(found.L), x, y)
    means = EVERY.base(x_bar[None], e[None])[0] + found.gain[order] @ e.ravel()
    expected = EVERY.base(free[0][None], free[1][None])[0] + gain @ free[1].ravel()[there]
    size = 1e-12 * max(1.0, np.abs(gain).max())
    np.testing.assert_allclose(means, expected, atol=size)
    np.testing.assert_allclose(x_bar[-1] + found.L[-1] @ e[-1], (free[0][-1] + gain[NX * (2 * STEPS) :][:NX]
                               @ free[1].ravel()[there]), atol=size)  # fmt: skip
    np.testing.assert_allclose(found.gain[:, ~there], 0.0, atol=size)
    rows = found.rows[order]
    np.testing.assert_allclose(rows @ rows.T, cov, atol=size)


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
    """Return a program, its bounds and stages, and first predictions and measurements of six windows."""
    given, P_root = stages(rng)
    bounds = WindowBounds(interval_of(w, NX, "w"), interval_of(x, NX, "x"), interval_of(v, NY, "v"))
    measured = np.ones((STEPS + 1, NY), dtype=bool)
    *_, law = bounds.laws(given, P_root, measured)
    program = WindowProgram.of(law, bounds.interval(measured))
    data = 0.1 * rng.standard_normal((6, NX)), rng.standard_normal((6, STEPS + 1, NY))
    return program, bounds, (given, P_root, measured), data


def fits_of(program, bounds, given, x, y):
    """Return the fits of windows."""
    found = [filtered(given, program.L, *each) for each in zip(x, y, strict=True)]
    x_bar, e = (np.array(each) for each in zip(*found, strict=True))
    return program.fit(x_bar[:, -1], e.reshape(len(e), -1), bounds.base(x_bar, e))


def test_the_minimum_is_that_of_the_window_without_a_filter(rng):
    """Oracle: quadprog in the noises themselves, with powers of A."""
    program, bounds, window, (x, y) = problem(rng, v=None)
    given, full = window[0], dense(*window)
    fits = fits_of(program, bounds, given, x, y)
    weight = np.kron(np.eye(STEPS + 1), np.linalg.inv(given.R_v[0]))
    Phi, E = full.outputs.reshape(-1, full.outputs.shape[2]), full.values()[: len(program.size)]
    assert fits.solved.sum() >= 3 and all(each.solved for each in fits.status)
    for i in range(len(x)):
        free, r = filtered(given, np.zeros_like(program.L), x[i], y[i])
        value = bounds.base(free[None], r[None])[0]
        H, f = np.eye(Phi.shape[1]) + Phi.T @ weight @ Phi, Phi.T @ weight @ r.ravel()
        C, b = np.vstack([E, -E]).T, np.concatenate([program.interval.low - value, value - program.interval.high])
        xi = quadprog.solve_qp(H, f, C, b)[0]
        np.testing.assert_allclose(fits.x[i], free[-1] + full.states[-1] @ xi, atol=1e-9)  # DAQP: 1e-10


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_a_violation_of_many_standard_deviations(size, rng):
    """Oracle: the problem is homogeneous; bounds and data that are `size` times as large have as large an answer."""
    program, bounds, (given, *_), (x, y) = problem(rng, v=None)
    scaled = ((-0.3 * size, 0.4 * size), (-0.5 * size, 0.5 * size), None)
    larger, wide, *_ = problem(np.random.default_rng(20180418), *scaled)
    one, many = fits_of(program, bounds, given, x, y), fits_of(larger, wide, given, size * x, size * y)
    np.testing.assert_array_equal(many.solved, one.solved)
    np.testing.assert_allclose(many.x, size * one.x, **SOLVER)


def test_infinite_ends_are_no_bounds():
    """Oracle: the same interval with null and with infinity."""
    for pairs in ((0.0, None), (0.0, np.inf), [(0.0, None), (0.0, np.inf)]):
        found = interval_of(pairs, 2, "w")
        np.testing.assert_array_equal(found, [[0.0, 0.0], [np.inf, np.inf]])
    assert not interval_of(None, NX, "x").bounded.any()
