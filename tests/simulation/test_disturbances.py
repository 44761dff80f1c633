"""Disturbances of the design model in the loop: what is recorded, the compiled loop, offsets, and series of designs."""

import numpy as np
import pytest
from conftest import random_model
from simulation.test_linear_loop import assert_same_bits

from rmpc_bench.controllers.limits import Limits
from rmpc_bench.controllers.mpc import design as mpc
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_disturbance import design as kalman_disturbance
from rmpc_bench.models.disturbance import Disturbance, DisturbanceGains
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_system import uncertain_system
from rmpc_bench.plants.uncertain_linear import UncertainLinear, Uncertainty
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.linear_loop import compiled_loop
from rmpc_bench.simulation.moments import Laws, exact_moments, signals
from rmpc_bench.simulation.recording import design_series
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.simulation.state_range import DIVERGED, OK, RunLimits, StateRange
from rmpc_bench.types import Method

STEPS, RUNS = 60, 5
A, B, C = [[0.9, 0.3], [-0.2, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]]
MODEL = LinearModel(A, B, C, 0.01, 0.1)


def disturbed(model=MODEL, at="input", drift=0.02, **keys):
    return with_disturbance(model, Disturbance(at=at, drift=drift, **keys), STEPS, np.zeros(model.nx))


def filtered(model, x0=None, **keys):
    nx = model.undisturbed.nx
    start = model.start(np.zeros(nx) if x0 is None else x0, np.eye(nx), np.zeros((nx, nx)))
    return kalman(model, STEPS, x0=start["x0"], P0=start["P0"], **keys)


def method(model, controller=None):
    controller = controller or mpc(model, Hp=8, Hu=3, Q=1.0, R=0.1, limits=Limits(u=(-1.5, 1.5)))
    return Method("m", filtered(model), controller, model.n_disturbances)


def plant():
    return UncertainLinear(
        uncertain_system(STEPS, {"A": A, "B": B, "C": C, "Bw": 1.0, "Dv": 1.0}), Uncertainty("uniform"), 1.0
    )


def draws(rng, made, w=0.0, v=0.0):
    delta = made.draw({}, [np.random.default_rng(i) for i in range(RUNS)], STEPS)
    noise = [scale * rng.standard_normal((RUNS, STEPS + 1, n)) for scale, n in ((w, 2), (v, 1))]
    return Draws(delta, rng.standard_normal((RUNS, 2)), *noise)


def test_only_x_is_recorded_and_d_on_request(rng):
    """Oracle: the filter by itself, on the recorded signals."""
    model, made = disturbed(), plant()
    pair, given = method(model), draws(rng, made, 0.1, 0.3)
    r = np.ones((STEPS + 20, 1))
    record, status = simulate(made, pair, given, r, STEPS, with_P=True, with_M=True, info={"d_hat", "e"})
    assert not status.any()
    assert record.x_hat.shape == (RUNS, STEPS + 1, 2) and record.info["d_hat"].shape == (RUNS, STEPS + 1, 1)
    assert record.P.shape == (STEPS + 1, 2, 2) and record.M is None
    assert pair.reports["d_hat"] == (1,) and "d_hat" not in Method("m", pair.estimator, pair.controller).reports
    state = pair.estimator.init(RUNS)
    for k in range(STEPS):
        state, estimate = pair.estimator.correct(k, state, record.y[:, k] + given.v[:, k])
        np.testing.assert_allclose(record.x_hat[:, k], estimate.x_hat[:, :2], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(record.info["d_hat"][:, k], estimate.x_hat[:, 2:], rtol=1e-10, atol=1e-12)
        np.testing.assert_array_equal(record.P[k], estimate.P[:2, :2])
        state = pair.estimator.predict(k, state, record.u[:, k])
    assert "d_hat" not in simulate(made, pair, given, r, STEPS)[0].info


@pytest.mark.parametrize("law", ["mpc", "lqr"])
def test_the_compiled_loop_has_the_same_bits(rng, law):
    """Oracle: the simulation step by step."""
    model, made = disturbed(), plant()
    controller = lqr(model, STEPS, filtered(model), horizon=6, Q_x=1.0, R_u=0.1) if law == "lqr" else None
    pair, r = method(model, controller), np.ones((STEPS + 20, 1))
    given, options = draws(rng, made, 0.1, 0.3), {"with_P": True, "info": {"d_hat", "e", "S"}}
    plain, status = simulate(made, pair, given, r, STEPS, **options)
    record, compiled_status = compiled_loop(made, pair, given, r, STEPS, **options)
    for name in ("x", "y", "x_hat", "u", "P"):
        assert_same_bits(getattr(record, name), getattr(plain, name))
        assert getattr(record, name).flags.c_contiguous
    assert {*record.info} == {*plain.info} == {"d_hat", "e", "S"}
    for name, values in plain.info.items():
        assert_same_bits(record.info[name], values)
    np.testing.assert_array_equal(status, compiled_status)


@pytest.mark.parametrize(("at", "true"), [("input", 0.4), ("output", -0.7), (DisturbanceGains([[1.0], [0.5]]), 0.3)])
def test_no_offset_remains(rng, at, true):
    """A constant disturbance is found, and the output reaches the reference; without the disturbance model it does not.

    Oracle: the true value, and the reference.
    """
    model, made = disturbed(at=at), plant()
    given = draws(rng, made)
    B_d, C_d = model.A[:2, 2:], model.C[:, 2:]
    given = given._replace(w=given.w + (B_d * true)[:, 0], v=given.v + (C_d * true)[:, 0])
    r = np.full((STEPS + 20, 1), 0.5)
    record, _ = simulate(made, method(model), given, r, STEPS, info={"d_hat"})
    np.testing.assert_allclose(record.info["d_hat"][:, -1], true, atol=2e-3)
    np.testing.assert_allclose(record.y[:, -1] + C_d[0] * true, 0.5, atol=2e-3)
    naive, _ = simulate(made, method(MODEL), given, r, STEPS)
    assert (np.abs(naive.y[:, -1] + C_d[0] * true - 0.5) > 0.05).all()


def test_kalman_disturbance_is_the_case_of_one_disturbance_per_state(rng):
    """Oracle: the filter `kalman-disturbance` on a model with as many outputs as states, where the rank is full."""
    model = random_model(rng, 3, 1, 3)
    both = with_disturbance(model, Disturbance(at=DisturbanceGains(B_d=1.0), drift=0.2), STEPS, np.zeros(3))
    x0, y = rng.standard_normal(3), rng.standard_normal((2, STEPS + 1, 3))
    ours = filtered(both, x0)
    theirs = kalman_disturbance(model, STEPS, x0=x0, P0=np.eye(3), drift=0.2, D0=0.2)
    a, b = ours.init(2), theirs.init(2)
    for k in range(STEPS + 1):
        (a, one), (b, other) = ours.correct(k, a, y[:, k]), theirs.correct(k, b, y[:, k])
        np.testing.assert_array_equal(one.x_hat[:, :3], other.x_hat)
        np.testing.assert_array_equal(one.x_hat[:, 3:], other.info["w_mean"])
        u = rng.standard_normal((2, 1))
        a, b = ours.predict(k, a, u), theirs.predict(k, b, u)


def test_a_disturbance_that_stays_zero_changes_nothing(rng):
    """Limit: a variance near 0 gives the trajectories of the model without disturbances."""
    made, r = plant(), np.ones((STEPS + 20, 1))
    given = draws(rng, made, 0.1, 0.3)
    plain, _ = simulate(made, method(MODEL), given, r, STEPS)
    for at in ("input", "output"):
        record, _ = simulate(made, method(disturbed(at=at, drift=1e-14)), given, r, STEPS)
        np.testing.assert_allclose(record.u, plain.u, atol=1e-9)
        np.testing.assert_allclose(record.x_hat, plain.x_hat, atol=1e-9)


def test_limits_of_divergence_are_those_of_x():
    """A disturbance may have any unit; x keeps its own limit, and NaN in d fails the run."""
    limits = RunLimits(StateRange(largest=np.array([2.0, 3.0])), np.zeros((4, 2)), np.zeros((1, 1)))
    x_hat = np.array([[1.0, 2.5, 1e30], [2.5, 1.0, 0.0], [1.0, 1.0, np.nan], [1.0, 1.0, 1e101]])
    status = limits.of_estimate(np.full(4, OK), np.full(4, OK), x_hat, 1)
    np.testing.assert_array_equal(status, [OK, DIVERGED, DIVERGED, DIVERGED])


def test_series_and_moments_are_those_of_x():
    """Oracle: the blocks of the design; exact moments of the filter, cut by hand."""
    model, made = disturbed(), plant()
    pair = method(model)
    series, P = design_series(pair), pair.estimator.P
    np.testing.assert_array_equal(series["P"], P[:, :2, :2])
    np.testing.assert_array_equal(series["P_d"], P[:, 2:, 2:])
    laws = Laws(np.ones(2), np.eye(2), np.zeros(3), np.diag([0.01, 0.01, 0.1]))
    schedule = pair.estimator.gain_schedule
    whole, cut = (exact_moments(made, schedule, laws, STEPS, nd) for nd in (0, 1))
    np.testing.assert_array_equal(cut.mean, whole.mean[:, :4])
    np.testing.assert_array_equal(cut.cov, whole.cov[:, :4, :4])
    assert "mean(e)" in signals(cut, 2) and "mean(e)" not in signals(whole, 2)


def test_a_matched_covariance_counts_the_dimensions_of_x():
    """The bounded noise of n states is uniform in n dimensions, also beside a disturbance.

    Naive: the augmented shape has n + nd rows, and its covariance would be too small.
    """
    from rmpc_bench.models.mixed_noise import design as mixed
    from rmpc_bench.models.noise_sets import with_noise_kind

    model = mixed(STEPS, A=A, B=B, C=C, P_w=0.1, M_w=0.6, P_v=0.1, M_v=0.3)
    both = disturbed(model)
    start = both.start(np.zeros(2), np.eye(2), 0.8 * np.eye(2))
    found, P0 = with_noise_kind(both, start["P0"], start["M0"], "matched")
    plain, P0_plain = with_noise_kind(model, np.eye(2), 0.8 * np.eye(2), "matched")
    np.testing.assert_array_equal(found.at(0).Q_w[:2, :2], plain.at(0).Q_w)
    np.testing.assert_array_equal(P0[:2, :2], P0_plain)
    assert found.at(0).Q_w[2, 2] == 0.02
