"""Both noises: what they add to [x(k+1); y], their limits and the turns with the gain."""

import numpy as np
from conftest import ROUND, random_psd

from rmpc_bench.numerics.norm_bound import Excess, NoiseChannel, NoisePair


def pair(rng, nx=2, ny=2):
    """Return two noises of two entries, with F of 1 x 2 and 2 x 1."""
    shapes = (((nx + ny, 2), (nx + ny, 1), (2, 2)), ((nx + ny, 2), (nx + ny, 2), (1, 2)))
    return NoisePair(*(NoiseChannel(*(rng.standard_normal(s) for s in three), random_psd(rng, 2)) for three in shapes))


def test_the_noises_add_up(rng):
    """Oracle: the channels, each for itself."""
    noises = pair(rng)
    found = noises.at(0.3, 2.0)
    np.testing.assert_allclose(found.U, noises.w.nominal(0.3) + noises.v.nominal(2.0), **ROUND)
    np.testing.assert_allclose(found.J - found.U, noises.w.own(0.3) + noises.v.own(2.0), atol=1e-12 * found.J.max())


def test_within_the_limits_nothing_that_matters_is_larger(rng):
    """Oracle: the traces of I, G and G A of the bound of x(k+1) on a grid between the ends, and beyond them."""
    for _ in range(20):
        noises, A, G = pair(rng), rng.standard_normal((2, 2)), rng.standard_normal((1, 2))
        for i, (low, high) in enumerate(noises.no_worse(A, G, Excess(gamma=1.0), Excess(eps=0.2))):
            channel, t0 = noises[i], [noises.w.lam[-1], 0.2][i]

            def more(t, channel=channel, t0=t0, A=A, G=G):
                J = [(channel.nominal(each) + channel.own(each))[:2, :2] for each in (t, t0)]
                return [np.trace(T @ (J[0] - J[1]) @ T.T) / np.trace(T @ J[1] @ T.T) for T in (np.eye(2), G, G @ A)]

            assert low <= t0 <= high
            assert all(max(more(t)) <= 1e-9 for t in np.geomspace(low, high, 20))
            assert max(more(0.9 * low)) > 0 and max(more(1.1 * high)) > 0


def test_the_turns_never_raise_the_trace(rng):
    """Oracle: the step with the excesses it began with, and with those it found, which make the same K."""
    for _ in range(20):
        noises, M, P = pair(rng, ny=1), rng.standard_normal((3, 2)), random_psd(rng, 2)
        J_x, first = random_psd(rng, 3), noises.at(*10.0 ** rng.uniform(-2, 2, 2))
        (K, root), last = noises.tuned_step(M, J_x, np.linalg.cholesky(P), first)
        P_next = root @ root.T
        before = K + 0.1 * rng.standard_normal(K.shape)  # any K, any excesses
        T = np.hstack([np.eye(2), -before])
        for these in (first, last):
            assert P_next.trace() <= np.trace(T @ (M @ P @ M.T + these.J + J_x) @ T.T)
        Y = M @ P @ M.T + last.J + J_x
        np.testing.assert_allclose(K, Y[:2, 2:] @ np.linalg.inv(Y[2:, 2:]), rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(P_next, Y[:2, :2] - K @ Y[2:, :2], atol=1e-9 * Y.trace())
