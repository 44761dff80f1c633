"""The norm bound of a covariance against random and worst F, and the choice of a against a search."""

import numpy as np
import pytest
from conftest import ROUND, random_psd
from scipy.optimize import minimize_scalar

from rmpc_bench.numerics.norm_bound import Excess, NoiseChannel, best_excess, keep_a, no_worse, spectrum, widen

SIZES = pytest.mark.parametrize(("r", "s"), [(1, 1), (2, 1), (1, 3), (2, 3)])


@SIZES
@pytest.mark.parametrize("excess", [Excess(eps=0.1), Excess(gamma=0.5), Excess(gamma=20.0)])
def test_the_bound_holds_for_every_F(r, s, excess, rng):
    """Oracle: the covariance for 300 F on and within the boundary; the bound is not below it in any direction."""
    P, M, H, G = (
        random_psd(rng, 4),
        rng.standard_normal((3, 4)),
        rng.standard_normal((3, r)),
        rng.standard_normal((s, 4)),
    )
    w = widen(G @ P @ G.T, excess)
    bound = M @ (P + P @ G.T @ w.inverse @ G @ P) @ M.T + w.a * H @ H.T
    channel = NoiseChannel(M, H, G, P)
    t = channel.excess(excess)
    np.testing.assert_allclose(channel.nominal(t) + channel.own(t), bound, atol=1e-10 * np.trace(bound))
    for i in range(300):
        U, _, Vt = np.linalg.svd(rng.standard_normal((r, s)), full_matrices=False)
        F = U * (rng.uniform(0, 1, min(r, s)) if i % 2 else 1.0) @ Vt
        true = (M + H @ F @ G) @ P @ (M + H @ F @ G).T
        assert np.linalg.eigvalsh(bound - true)[0] > -1e-12 * np.trace(bound)


def test_the_gap_keeps_its_digits(rng):
    """Oracle: by hand; a tiny excess over a large eigenvalue, where a I - G P G' by difference is rounding only."""
    w = widen(np.array([[1e8]]), Excess(eps=1e-12))
    assert w.gap.item() == 1e-12 and w.inverse.item() == 1e12 and w.a == 1e8
    U = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    w = widen((U * [1.0, 2.0, 3.0]) @ U.T, Excess(eps=1e-14))
    np.testing.assert_allclose(np.linalg.eigvalsh(w.inverse)[-1], 1e14, rtol=1e-12)


@pytest.mark.parametrize("s", [1, 3])
def test_the_gap_and_its_inverse_belong_together(s, rng):
    """Oracle: a I - G P G' and its inverse, also of another covariance with the same a."""
    Y = random_psd(rng, s)
    for excess in (Excess(eps=0.3), Excess(gamma=1.0)):
        w = widen(Y, excess)
        np.testing.assert_allclose(w.gap, w.a * np.eye(s) - Y, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(w.inverse @ w.gap, np.eye(s), atol=1e-12)
        smaller = keep_a(w, Y - 0.5 * Y)
        np.testing.assert_allclose(smaller.inverse, np.linalg.inv(w.a * np.eye(s) - 0.5 * Y), rtol=1e-10)
        assert keep_a(w, Y - 4.0 * Y) is None
        assert keep_a(w, 0.0 * Y) is w


@pytest.mark.parametrize("s", [1, 2])
def test_what_sees_nothing_needs_no_a(s):
    """Oracle: P G' = 0: the bound is M P M' + a H H' for every a > 0, and a = 0 is the limit."""
    zero = np.zeros((s, s))
    for excess in (Excess(gamma=1.0), Excess(eps=0.0)):
        w = widen(zero, excess)
        assert w.a == 0.0 and not w.inverse.any()
    assert widen(zero, Excess(eps=0.1)).a == 0.1
    with pytest.raises(ZeroDivisionError):
        widen(np.eye(s), Excess(eps=0.0))


@pytest.mark.parametrize("s", [1, 2, 4])
def test_the_best_excess_makes_the_sum_least(s, rng):
    """Oracle: a bounded search over log t."""
    for _ in range(30):
        lam = np.sort(rng.uniform(0.1, 2, s))
        p, q = rng.uniform(0, 1, s) * 10.0 ** rng.uniform(-3, 3, s), 10.0 ** rng.uniform(-3, 3)

        def cost(t, lam=lam, p=p, q=q):
            return (p / (lam[-1] - lam + t)).sum() + q * (lam[-1] + t)

        ours = best_excess(lam, p, q)
        search = minimize_scalar(
            lambda log, cost=cost: cost(np.exp(log)), bounds=(-20, 20), method="bounded", options={"xatol": 1e-9}
        )
        assert cost(ours) <= search.fun * (1 + 1e-12)
        np.testing.assert_allclose(np.log(ours), search.x, atol=1e-4)  # the cost is flat there


def test_the_best_excess_in_its_limits():
    """Oracle: by hand; sqrt(p/q) for one eigenvalue; nothing to gain, or nothing to pay, stops at 1e-9 and 1e9."""
    one = np.array([2.0])
    np.testing.assert_allclose(best_excess(one, np.array([9.0]), 4.0), 1.5, **ROUND)
    assert best_excess(one, np.array([0.0]), 4.0) == 2e-9
    assert best_excess(one, np.array([1.0]), 0.0) == 2e9
    flat = best_excess(np.array([1.0, 2.0]), np.array([0.25, 0.0]), 1.0)  # the largest one does not count
    assert flat == 2e-9


def test_the_best_excess_where_the_largest_eigenvalue_costs_nothing():
    """Oracle: by hand: three eigenvalues, of which two with d = 1 cost 2 p / (t + 1)^2 = q, and the largest nothing."""
    t = best_excess(np.array([1.0, 1.0, 2.0]), np.array([0.7, 0.7, 0.0]), 1.0)
    np.testing.assert_allclose(t, np.sqrt(1.4) - 1, **ROUND)


@pytest.mark.parametrize("s", [1, 2, 4])
def test_an_excess_that_is_no_worse(s, rng):
    """Oracle: the sum itself: the same at both ends, one of them t0, smaller between and larger outside."""
    for _ in range(30):
        lam = np.sort(rng.uniform(0.1, 2, s))
        p, q = rng.uniform(0, 1, s) * 10.0 ** rng.uniform(-3, 3, s), 10.0 ** rng.uniform(-3, 3)
        t0 = 10.0 ** rng.uniform(-3, 3)

        def cost(t, lam=lam, p=p, q=q):
            return (p / (lam[-1] - lam + t)).sum() + q * t

        low, high = no_worse(lam, p, q, t0)
        assert t0 in (low, high) and 0 < low < high
        np.testing.assert_allclose(cost(low), cost(high), rtol=1e-9)
        assert (low <= best_excess(lam, p, q) <= high) or not 1e-9 < best_excess(lam, p, q) / lam[-1] < 1e9
        assert cost(0.5 * (low + high)) < cost(t0) and cost(1.01 * high) > cost(t0) > 0 and cost(0.99 * low) > cost(t0)


def test_an_excess_that_is_no_worse_in_its_limits():
    """Oracle: by hand; p / (q t0) for one eigenvalue; a sum that only falls or only rises, or does neither."""
    one, p = np.array([2.0]), np.array([9.0])
    np.testing.assert_allclose(no_worse(one, p, 4.0, 1.0), (1.0, 2.25), **ROUND)
    np.testing.assert_allclose(no_worse(one, p, 4.0, 3.0), (0.75, 3.0), **ROUND)
    assert no_worse(one, p, 0.0, 3.0) == (3.0, np.inf)
    assert no_worse(one, 0 * p, 4.0, 3.0) == (0.0, 3.0)
    assert no_worse(one, 0 * p, 0.0, 3.0) == (0.0, np.inf)
    assert no_worse(np.array([1.0, 2.0]), np.array([0.1, 0.0]), 1.0, 3.0) == (0.0, 3.0)  # rises from t = 0 on


def test_the_best_excess_of_a_channel_within_a_range(rng):
    """Oracle: a search over the range of trace(T bound T'), with the range that leaves another trace no larger."""
    for _ in range(20):
        channel = NoiseChannel(
            rng.standard_normal((3, 2)), rng.standard_normal((3, 1)), rng.standard_normal((2, 2)), random_psd(rng, 2)
        )
        T, other, t0 = rng.standard_normal((2, 3)), np.eye(2, 3), 10.0 ** rng.uniform(-2, 2)

        def cost(t, T=T, channel=channel):
            return np.trace(T @ (channel.nominal(t) + channel.own(t)) @ T.T)

        low, high = channel.no_worse(other, t0)
        np.testing.assert_allclose(cost(low, other), cost(high, other), rtol=1e-9)
        ours = channel.best(T, (low, high))
        assert low <= ours <= high
        assert cost(ours) <= min(cost(t) for t in np.geomspace(low, high, 200)) * (1 + 1e-12)


def test_a_channel_without_uncertainty_is_its_nominal_noise(rng):
    """Oracle: M W M'; likewise where the noise of the uncertain direction is zero."""
    M, W = rng.standard_normal((3, 2)), random_psd(rng, 2)
    for H, G, Q in (
        (np.zeros((3, 1)), np.ones((1, 2)), W),
        (np.ones((3, 1)), np.zeros((1, 2)), W),
        (np.ones((3, 1)), np.array([[1.0, 0.0]]), np.diag([0.0, 1.0])),
    ):
        channel = NoiseChannel(M, H, G, Q)
        assert not channel.present
        t = channel.excess(Excess(eps=0.1))
        assert t == 0.0 and channel.a(t) == 0.0 and channel.best(np.ones((2, 3))) == 0.0
        np.testing.assert_array_equal(channel.nominal(t) + channel.own(t), M @ Q @ M.T)


def test_an_excess_of_zero_is_right_only_where_nothing_is_shared(rng):
    """Oracle: M W G' = 0 leaves Wc = W in the limit t -> 0; otherwise Wc is infinite."""
    H, G, W = rng.standard_normal((3, 1)), np.array([[0.0, 2.0]]), np.eye(2)
    channel = NoiseChannel(np.array([[1.0, 0], [0, 0], [2, 0]]), H, G, W)
    np.testing.assert_array_equal(channel.nominal(0.0), channel.base)
    assert channel.a(0.0) == 4.0 and channel.best(np.ones((2, 3))) == 0.0
    with pytest.raises(ZeroDivisionError):
        NoiseChannel(rng.standard_normal((3, 2)), H, G, W).nominal(0.0)


def test_rounding_makes_no_negative_eigenvalue():
    """Oracle: the property."""
    assert spectrum(np.array([[-1e-20]]))[0][0] == 0.0
    assert (spectrum(np.array([[1.0, 1.0], [1.0, 1.0 - 1e-16]]))[0] >= 0.0).all()
