"""Random and known delays of measurements: every kind of estimator that bridges gaps, sample by sample.

The case is that of a random walk, all variances 1, with the delays 0, 2, 0, 1, 0 of y = 1, .., 5.  Its x_hat and P are
exact: mean and covariance of Gaussian variables given what has arrived.
"""

import numpy as np
import pytest
from conformance.test_estimators import KALMAN_LIMITS
from conftest import ROUND, SOLVER
from required_keys import REQUIRED, sampled

from rmpc_bench.config_file.factories import estimator
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.uncertain_linear import design as uncertain_model
from rmpc_bench.noise.measurement import delayed
from rmpc_bench.plants import uncertain_linear as plants
from rmpc_bench.plants.uncertain_linear import Uncertainty
from rmpc_bench.registry import BRIDGING
from rmpc_bench.simulation.late_measurements import Arrivals
from rmpc_bench.simulation.scenario import Alteration, Draws
from rmpc_bench.types import KnownDelay, as_estimate

DELAYS, Y = np.array([0, 2, 0, 1, 0]), np.array([1.0, 2.0, 3.0, 4.0, 5.0])
STEPS = len(Y) - 1
KNOWN, NOT_KNOWN = KnownDelay(0, None), KnownDelay(0, (0,))
GOLDEN = (1.0 + np.sqrt(5.0)) / 2.0
"""Stationary covariance of the prediction."""


def drawn(d):
    """Draws of a block with these delays, (runs, samples, ny)."""
    law, none = delayed(d.shape[2], samples=[0, 2]), np.zeros((len(d), d.shape[1], 1))
    return Draws(None, none[:, 0], none, none, alterations=(Alteration(law, d.astype(float)),))


def late(design, d, y, known=KNOWN, delta=()):
    """Return x_hat, P and info over k, as the simulation calls the estimator."""
    arrivals = Arrivals(drawn(d), known)
    called, state, found = arrivals.used_by(design), design.init(len(y), *delta), []
    for k in range(y.shape[1]):
        _, given = arrivals.at(k, y[:, k])
        state, answer = called.correct(k, state, given)
        found.append(as_estimate(answer))
        assert not found[-1].status.any()
        state = called.predict(k, state, np.zeros((len(y), 1)))
    return found


def by_hand(design, d, y, k, delta=()):
    """Estimate at k of the same filter, run from the start on what has arrived by k."""
    state = design.init(len(y), *delta)
    for j in range(k + 1):
        state, answer = design.correct(j, state, np.where(j + d[:, j] <= k, y[:, j], np.nan))
        if j < k:
            state = design.predict(j, state, np.zeros((len(y), 1)))
    return as_estimate(answer)


def exact(k, p0, *, uses_newest):
    """Mean and variance of x(k) given what has arrived by k, of the random walk."""
    there = [j for j in range(k + uses_newest) if j + DELAYS[j] <= k]
    cov = p0 + np.minimum.outer(np.arange(k + 1), np.arange(k + 1))
    if not there:
        return 0.0, cov[k, k]
    gain = np.linalg.solve(cov[np.ix_(there, there)] + np.eye(len(there)), cov[there, k])
    return gain @ Y[there], cov[k, k] - gain @ cov[there, k]


WALK = {"A": [[1.0]], "B": [[0.0]]}
OUTPUTS = {1: [[1.0]], 2: [[1.0], [0.5]]}
UNCERTAIN = {"Bw": [[1.0]], "H_A": [[0.0]], "G_x": [[0.0]]}
LIMITS = KALMAN_LIMITS | {
    "control-lqe": {}, "mixed": {"M0": np.zeros((1, 1))}, "moving-horizon": {"window": 2},
    "nonlinear-moving-horizon": {"window": 2}, "oracle": {},
}  # fmt: skip
"""Keys with which a kind is `kalman` or `kalman-predictor`."""
OTHERS = {kind: REQUIRED.get(kind, {}) for kind in BRIDGING if kind not in LIMITS} | {
    "lp-window": {"Ne": 2},
    "set-membership": {"inflate": False},
}
"""Kinds without this limit."""
PREDICTORS = {"enhanced-robust", "kalman-predictor", "oracle", "robust-h-infinity"}
NEED_UNCERTAINTY = {"enhanced-robust", "lmmse", "oracle", "robust-h-infinity", "sayed-bdu"}


def oracle_plant(ny):
    """Return the random walk as a plant whose matrices the oracle reads."""
    given = WALK | UNCERTAIN | {"C": OUTPUTS[ny], "Dv": np.eye(ny).tolist()}
    return plants.design(1.0, STEPS, **given, uncertainty=Uncertainty())


def made(kind, p0=1.0, ny=1):
    """Return a kind for the random walk."""
    keys, walk = (LIMITS | OTHERS)[kind], WALK | {"C": OUTPUTS[ny]}
    if kind in NEED_UNCERTAINTY:
        model = uncertain_model(STEPS, **walk, **UNCERTAIN, Dv=np.eye(ny).tolist(), W=1.0, V=1.0)
    elif kind == "set-membership":
        model, keys = mixed_model(STEPS, **walk, M_w=1.0, M_v=1.0), keys | {"M0": np.eye(1)}
    else:
        model = LinearModel(**walk, Q_w=[[1.0]], R_v=np.eye(ny))
    if kind == "oracle":
        keys = {**keys, "plant": oracle_plant(ny)}
    start = {} if kind in ("control-lqe", "lp-window") else {"P0": p0 * np.eye(1)}
    return estimator(kind, model, n_steps=STEPS, x0=np.zeros(1), **start, **sampled(kind), **keys)


def revealed(kind, n_runs, ny=1):
    """Return what the oracle knows of its runs; nothing for other kinds."""
    if kind != "oracle":
        return ()
    plant = oracle_plant(ny)
    nominal = {name: np.full(n_runs, value) for name, value in plant.nominal.items()}
    return (plant.draw(nominal, [np.random.default_rng(i) for i in range(n_runs)], STEPS),)


def test_the_exact_values():
    """Oracle: the numbers of the specification, as fractions."""
    found = [exact(k, 1.0, uses_newest=True) for k in range(5)]
    np.testing.assert_allclose([each[0] for each in found], [1 / 2, 1 / 2, 16 / 7, 31 / 13, 390 / 89], **ROUND)
    np.testing.assert_allclose([each[1] for each in found], [1 / 2, 3 / 2, 5 / 7, 21 / 13, 55 / 89], **ROUND)


@pytest.mark.parametrize("kind", LIMITS)
def test_known_random_delays_in_the_limit_that_is_kalman(kind):
    """Oracle: the exact mean and variance; the other run, without delays, has other values."""
    p0 = GOLDEN if kind == "control-lqe" else 1.0
    d, y = np.array([DELAYS, 0 * DELAYS])[:, :, None], np.array([Y, Y])[:, :, None]
    found = late(made(kind, p0), d, y, delta=revealed(kind, 2))
    for k, each in enumerate(found):
        x_hat, P = exact(k, p0, uses_newest=kind not in PREDICTORS)
        # c = 1e-12 raises P_pred by the factor 1 + (2 c)^1/2 = 1 + 1.4e-6 at every step.
        close = {"rtol": 4e-6} if kind == "robust-kalman" else SOLVER
        np.testing.assert_allclose(each.x_hat[0, 0], x_hat, atol=1e-6, **close)
        if each.P is not None:
            np.testing.assert_allclose(np.broadcast_to(each.P, (2, 1, 1))[0, 0, 0], P, **close)
    assert found[2].x_hat[0, 0] != found[2].x_hat[1, 0] or kind in PREDICTORS


@pytest.mark.parametrize("kind", [*LIMITS, *OTHERS])
@pytest.mark.parametrize("ny", OUTPUTS)
def test_a_filter_repeats_what_late_measurements_change(kind, ny, rng):
    """Oracle: the same filter from the start on what has arrived by k; random delays of every output, in four runs."""
    d, y = rng.integers(0, 3, (4, STEPS + 1, ny)), rng.standard_normal((4, STEPS + 1, ny))
    design, delta = made(kind, ny=ny), revealed(kind, 4, ny)
    for k, each in enumerate(late(design, d, y, delta=delta)):
        expected = by_hand(design, d, y, k, delta)
        np.testing.assert_allclose(each.x_hat, expected.x_hat, **ROUND)
        for name in ("P", "M"):
            if getattr(expected, name) is not None:
                np.testing.assert_allclose(getattr(each, name), getattr(expected, name), **ROUND)
