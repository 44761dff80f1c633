"""extended-kalman and unscented-kalman: limits, filterpy on nonlinear maps, missing measurements, failures."""

import pickle

import numpy as np
import pytest
from conftest import random_model, random_psd
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from rmpc_bench import load_config
from rmpc_bench.estimators import extended_kalman, kalman, kalman_predictor, unscented_kalman
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.linearised import design as linearised
from rmpc_bench.models.moving_slide import SlideNoise
from rmpc_bench.models.moving_slide import design as slide
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.plants.ode import design as ode
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, Status

Q, R = np.array([[2e-3, 5e-4], [5e-4, 1e-2]]), np.array([[0.1]])
FILTERS = [
    (extended_kalman, {}),
    (extended_kalman, {"spread": 1e-3}),
    (unscented_kalman, {}),
    (unscented_kalman, {"alpha": 0.5, "beta": 2.0, "kappa": 1.0}),
    (unscented_kalman, {"alpha": 1e-3}),
]
IDS = ["ekf", "ekf-narrow", "cubature", "ukf", "ukf-narrow"]


def swing(x, u, p):
    """A pendulum as a map, pushed by u."""
    return [x[0] + 0.1 * x[1], x[1] - 0.981 * np.sin(x[0]) + 0.1 * u[0]]


def side(x, p):
    """The horizontal position is measured."""
    return [np.sin(x[0])]


def pendulum(output=side):
    """Return the pendulum as a nonlinear design model."""
    given = {"output": output, "outputs": ["s"]} if output else {}
    plant = ode(0.1, 60, ode=swing, states=["a", "v"], inputs=["torque"], discrete=True, x0=[1.0, 0.0], **given)
    return nonlinear(0.1, plant, noise=DesignNoise(Q.tolist(), R[0, 0]))


def simulated(rng, runs, steps):
    """Inputs and measurements of pendulums that start near 1 rad."""
    x = np.array([1.0, 0.0]) + 0.3 * rng.standard_normal((runs, 2))
    u, y = rng.standard_normal((runs, steps, 1)), np.empty((runs, steps, 1))
    for k in range(steps):
        y[:, k] = np.sin(x[:, :1]) + np.sqrt(R[0, 0]) * rng.standard_normal((runs, 1))
        x = np.stack(swing(x.T, u[:, k].T, None), axis=1) + rng.multivariate_normal(np.zeros(2), Q, runs)
    return y, u


def run(estimator, y, u):
    """Estimates (runs, samples, nx), covariances of every run and the last statuses."""
    state, found, P = estimator.init(len(y)), [], []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        found.append(estimate.x_hat)
        P.append(np.broadcast_to(estimate.P, (len(y), *estimate.P.shape[-2:])))
        state = estimator.predict(k, state, u[:, k])
    return np.stack(found, axis=1), np.stack(P, axis=1), estimate.status


START = {"x0": np.array([0.8, 0.1]), "P0": np.array([[0.3, 0.1], [0.1, 0.4]])}


@pytest.mark.parametrize("use_y0", [True, False])
@pytest.mark.parametrize(("module", "keys"), FILTERS, ids=IDS)
def test_of_a_linear_model_it_is_the_kalman_filter(rng, module, keys, use_y0):
    """Oracle: kalman, also with offsets, several outputs and missing measurements."""
    made = random_model(rng, 3, 2, 2)
    model = LinearModel(made.A, made.B, made.C, made.Q_w, made.R_v, f0=[0.1, -0.2, 0.3], d0=[0.5, -1.0])
    start = {"x0": rng.standard_normal(3), "P0": random_psd(rng, 3), "use_y0": use_y0}
    y, u = rng.standard_normal((4, 30, 2)), rng.standard_normal((4, 30, 2))
    y[1, 5:8, 0], y[2, 7], y[2, 9:12, 1] = np.nan, np.nan, np.nan
    ours, P, _ = run(module.design(model, 30, **start, **keys), y, u)
    theirs, P_theirs, _ = run(kalman.design(model, 30, **start), y, u)
    # Sums of size 1.  With alpha = 1e-3 the rounding of f is divided by 1e-6, otherwise by 1e-3 or nothing.
    tolerance = 1e-8 if keys.get("alpha") == 1e-3 else 1e-11
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance)
    np.testing.assert_allclose(P, P_theirs, rtol=0, atol=tolerance)


def test_the_extended_filter_of_filterpy(rng):
    """Oracle: filterpy with the Jacobians in closed form; differences over 1e-5 err by less than 1e-9."""
    y, u = simulated(rng, 3, 60)
    ours, P, _ = run(extended_kalman.design(pendulum(), 60, **START, spread=1e-5), y, u)
    for i in range(3):
        theirs = ExtendedKalmanFilter(2, 1)
        theirs.x, theirs.P, theirs.Q, theirs.R = START["x0"].copy(), START["P0"], Q, R
        for k in range(60):
            theirs.update(y[i, k], lambda x: np.array([[np.cos(x[0]), 0.0]]), lambda x: np.sin(x[:1]))
            np.testing.assert_allclose(ours[i, k], theirs.x, rtol=0, atol=1e-8)
            np.testing.assert_allclose(P[i, k], theirs.P, rtol=0, atol=1e-8)
            theirs.F = np.array([[1.0, 0.1], [-0.981 * np.cos(theirs.x[0]), 1.0]])
            theirs.P = theirs.F @ theirs.P @ theirs.F.T + Q
            theirs.x = np.array(swing(theirs.x, u[i, k], None))


def test_the_default_is_the_textbook_filter(rng):
    """Oracle: filterpy as above: the Jacobian of a small step at every start."""
    y, u = simulated(rng, 2, 60)
    ours, P, _ = run(extended_kalman.design(pendulum(), 60, **START), y, u)
    narrow, P_narrow, _ = run(extended_kalman.design(pendulum(), 60, **START, spread=1e-5), y, u)
    np.testing.assert_allclose(ours, narrow, rtol=0, atol=1e-8)
    np.testing.assert_allclose(P, P_narrow, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("size", "mse"), [(0.1, 2.9177e-5), (0.09, 3.027e-5)])
def test_a_root_that_ends_within_a_standard_deviation(size, mse):
    """Oracle: x+ = x + 0.1 (u - 0.3 sqrt x), y = sqrt x with the derivatives written out, in an own loop.

    A step of one standard deviation, 0.316, leaves the domain at x_hat = 0.3.
    """
    tank = ode(0.1, 60, ode=lambda x, u, p: [x[0] + 0.1 * (u[0] - 0.3 * np.sqrt(x[0]))], states=["h"], inputs=["f"],
               output=lambda x, p: [np.sqrt(x[0])], outputs=["s"], discrete=True, x0=[0.5])  # fmt: skip
    model = nonlinear(0.1, tank, noise=DesignNoise(1e-4, 2.5e-3))
    x, x_hat, P, y, theirs, errors = 0.5, 0.3, size, np.empty((1, 61, 1)), [], []
    for k in range(61):
        y[0, k] = np.sqrt(x)
        c = 0.5 / np.sqrt(x_hat)
        L = P * c / (c * P * c + 2.5e-3)
        x_hat, P = x_hat + L * (np.sqrt(x) - np.sqrt(x_hat)), (1.0 - L * c) * P
        theirs.append(x_hat)
        errors.append((x_hat - x) ** 2)
        a = 1.0 - 0.015 / np.sqrt(x_hat)
        x, x_hat = (each + 0.1 * (0.15 - 0.3 * np.sqrt(each)) for each in (x, x_hat))
        P = a * P * a + 1e-4
    estimator = extended_kalman.design(model, 60, x0=np.array([0.3]), P0=np.array([[size]]))
    ours, _, status = run(estimator, y, np.full((1, 61, 1), 0.15))
    np.testing.assert_allclose(ours[0, :, 0], theirs, rtol=0, atol=1e-9)  # ten digits of a derivative
    assert (status == Status.OK).all()
    # The metric has the samples 0..59.
    assert np.mean((ours[0, 1:, 0] - theirs[1:]) ** 2) < 1e-18 and np.mean(errors[:60]) == pytest.approx(mse, rel=2e-4)
    if size == 0.1:
        assert ours[0, 0, 0] == pytest.approx(0.469511, abs=5e-7)


TANK = """
version: 1
name: tank
runs: 1
time: {step: 0.1, duration: 1}
plant: {ode: tank.py:rhs, output: tank.py:output, states: [h], inputs: [f], outputs: [s], discrete: true,
        bounds: {h: [0, 10]}}
model: {nonlinear: plant, noise: {process: 1.0e-4, measurement: 2.5e-3}}
initial: {x: 0.5, x_hat: 0.3, P: 0.1}
input: {kind: steps, times: [0], values: [0.15]}
methods:
  U: {estimator: {kind: unscented-kalman}}
  E: {estimator: {kind: extended-kalman, spread: 1}}
metrics: [estimation_mse]
"""


def test_points_stay_inside_the_state_bounds_of_the_model(tmp_path):
    """Oracle: sums by hand over the points 0, 0.3 and 0.3 + sqrt(0.1); a step of sqrt(0.1) leaves the domain.

    A run without moved points beside it has the numbers that it has alone, and keeps those of a model without bounds.
    """
    module = "import numpy as np\ndef rhs(x, u, p):\n    return [x[0] + 0.1 * (u[0] - 0.3 * np.sqrt(x[0]))]\n"
    (tmp_path / "tank.py").write_text(module + "def output(x, p):\n    return [np.sqrt(x[0])]\n", encoding="utf-8")
    found = []
    for bounds in ("[0, 10]", "[-1, 10]"):
        (tmp_path / "tank.yaml").write_text(TANK.replace("[0, 10]", bounds), encoding="utf-8")
        methods = load_config(tmp_path / "tank.yaml").experiment.methods
        found.append([method.estimator for method in methods])
    y, far = np.sqrt([[0.5], [0.5]]), np.array([[0.3], [0.9]])
    J = (0.3 + np.sqrt(0.1)) ** -0.5
    expected = {"x_hat": (0.543022474, 0.423218628), "P": (0.006581804, 1 / (10 + J**2 / 2.5e-3))}
    for i, (bounded, free) in enumerate(zip(*found, strict=True)):
        state = bounded.init(2)._replace(x=far)
        after, estimate = bounded.correct(0, state, y)
        assert estimate.x_hat[0, 0] == pytest.approx(expected["x_hat"][i], abs=5e-10)
        assert estimate.P[0, 0, 0] == pytest.approx(expected["P"][i], abs=5e-10)
        alone, _ = free.correct(0, free.init(1)._replace(x=far[1:]), y[1:])
        np.testing.assert_array_equal(after.x[1], alone.x[0])
        np.testing.assert_array_equal(after.root[1], alone.root[0])
        # An estimate outside: the points are moved, and the filter goes on.
        low, _ = bounded.correct(0, state._replace(x=np.full((2, 1), -0.1)), y)
        assert np.isfinite(bounded.predict(0, low, np.zeros((2, 1))).x).all()


@pytest.mark.parametrize(
    "weights", [(0.5, 2.0, 1.0), (1.0, 0.0, 0.5), (1.0, 0.0, 0.0)], ids=["Merwe", "Julier", "cubature"]
)
def test_the_unscented_filter_of_filterpy(rng, weights):
    """Oracle: filterpy, whose points are placed anew before every correction as ours are."""
    y, u = simulated(rng, 3, 60)
    names = dict(zip(("alpha", "beta", "kappa"), weights, strict=True))
    ours, P, _ = run(unscented_kalman.design(pendulum(), 60, **START, **names), y, u)
    for i in range(3):
        points = MerweScaledSigmaPoints(2, *weights)
        theirs = UnscentedKalmanFilter(
            2, 1, 0.1, lambda x: np.sin(x[:1]), lambda x, dt, u: np.array(swing(x, u, None)), points
        )
        theirs.x, theirs.P, theirs.Q, theirs.R = START["x0"].copy(), START["P0"].copy(), Q, R
        for k in range(60):
            theirs.sigmas_f = points.sigma_points(theirs.x, theirs.P)
            theirs.update(y[i, k])
            # Rounding of 60 samples, on numbers of size 1.
            np.testing.assert_allclose(ours[i, k], theirs.x, rtol=0, atol=1e-11)
            np.testing.assert_allclose(P[i, k], theirs.P, rtol=0, atol=1e-11)
            theirs.predict(u=u[i, k])


def test_narrow_steps_are_the_filter_linearised_on_the_trajectory(rng):
    """Oracle: kalman with `linearise: plant, at: trajectory`, whose derivatives are of the equation."""
    plant = ode(0.1, 40, ode=swing, output=side, states=["a", "v"], inputs=["torque"], outputs=["s"], discrete=True,
                x0=[1.0, 0.0])  # fmt: skip
    model = linearised(0.1, plant, at="trajectory", noise=DesignNoise(Q.tolist(), R[0, 0]))
    y, u = simulated(rng, 4, 40)
    theirs, _, _ = run(kalman.design(model, 40, **START), y, u)
    ours, _, _ = run(extended_kalman.design(model, 40, **START, spread=1e-5), y, u)
    # Errors of both differences.
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-7)


def test_a_narrow_spread_of_points_has_the_mean_of_the_extended_filter():
    """The predicted mean differs by tr(H P) / 2 only, so it tends to f(x) with P; oracle: f itself."""
    model = pendulum()
    gaps = []
    for size in (1e-4, 1e-6):
        start = {"x0": START["x0"], "P0": size * START["P0"], "use_y0": False}
        means = []
        for design in (
            unscented_kalman.design(model, 5, alpha=1e-2, **start),
            extended_kalman.design(model, 5, **start),
        ):
            state, _ = design.correct(0, design.init(1), np.zeros((1, 1)))
            means.append(design.predict(0, state, np.ones((1, 1))).x[0])
        np.testing.assert_allclose(means[1], swing(START["x0"], [1.0], None), rtol=1e-14)
        gaps.append(np.abs(means[0] - means[1]).max())
    # Proportional to P; at 1e-6 the gap of 1e-7 has nine digits.
    assert gaps[0] / gaps[1] == pytest.approx(100.0, rel=1e-4)


@pytest.mark.parametrize(("module", "keys"), FILTERS, ids=IDS)
def test_a_row_of_a_block_is_the_row_alone(rng, module, keys):
    """Also where measurements of other rows are missing, one run fails and the output is nonlinear."""
    y, u = simulated(rng, 50, 10)
    y[3, 4:7], u[5, 6] = np.nan, np.nan
    estimator = pickle.loads(pickle.dumps(module.design(pendulum(), 10, **START, **keys)))
    together = run(estimator, y, u)
    for i in (0, 3, 5, 6, 49):
        for one, block in zip(run(estimator, y[i : i + 1], u[i : i + 1]), together, strict=True):
            np.testing.assert_array_equal(one[0], block[i])
    assert np.isnan(together[0][5, 7:]).any(axis=1).all() and np.isfinite(np.delete(together[0], 5, axis=0)).all()


def test_a_missing_measurement_is_a_prediction_only(rng):
    """Oracle: the same filter with R_v so large that the measurement has no weight."""
    y, u = simulated(rng, 2, 12)
    blind = pendulum()
    object.__setattr__(blind, "R_v", np.array([[1e14]]))
    y_gap = np.full_like(y, np.nan)
    for module in (extended_kalman, unscented_kalman):
        gap, P_gap, _ = run(module.design(pendulum(), 12, **START), y_gap, u)
        weightless, P, _ = run(module.design(blind, 12, **START), y, u)
        # Gains of 1e-14; a Jacobian by differences has ten digits.
        np.testing.assert_allclose(gap, weightless, rtol=0, atol=1e-9)
        np.testing.assert_allclose(P_gap, P, rtol=0, atol=1e-9)
        assert module.design(pendulum(), 12, **START).bridges_missing


def test_a_covariance_that_is_indefinite_twice_ends_the_run():
    """With beta = -20 the covariance of a bent map is indefinite again and again; oracle: its eigenvalues."""
    bend = ode(1.0, 20, ode=lambda x, u, p: [x[0] ** 2, 0.5 * x[1]], states=["a", "b"], discrete=True, x0=[0.1, 0.1])
    model = nonlinear(1.0, bend, noise=DesignNoise(0.3, 1.0))
    start = {"x0": np.array([0.4, 0.0]), "P0": np.diag([0.3, 0.1])}
    estimator = unscented_kalman.design(model, 20, beta=-20.0, **start)
    state, negative, statuses = estimator.init(1), [], []
    for k in range(8):
        state, estimate = estimator.correct(k, state, np.full((1, 2), np.nan))
        statuses.append(int(estimate.status[0]))
        # The covariances that predictions have used so far.
        assert statuses[-1] == (Status.SINGULAR if sum(negative) >= 2 else Status.OK)
        x, steps = state.x[0], np.sqrt(2.0) * np.concatenate([state.root[0].T, -state.root[0].T])
        d = np.array([[(x[0] + a) ** 2 - x[0] ** 2, 0.5 * b] for a, b in steps])
        P = d.T @ d / 4.0 - 21.0 * np.outer(d.sum(axis=0), d.sum(axis=0)) / 16.0 + 0.3 * np.eye(2)
        negative.append(bool(np.linalg.eigvalsh(P)[0] < -1e-9))
        state = estimator.predict(k, state, np.zeros((1, 0)))
    assert statuses[0] == Status.OK and statuses[-1] == Status.SINGULAR and not all(negative)


def test_points_outside_of_the_domain_fail_the_run_only():
    """The root of a negative level is not a number: this run is NaN, which the closed loop counts as diverged."""
    import math

    def drain(x, u, p):
        return [-math.sqrt(x[0])]

    plant = ode(0.1, 10, ode=drain, states=["h"], x0=[1.0], solver=Solver(substeps=1))
    model = nonlinear(0.1, plant, noise=DesignNoise(1e-6, 1e-2))
    estimator = unscented_kalman.design(model, 10, x0=np.array([1.0]), P0=np.array([[0.04]]))
    y = np.array([[1.0], [-60.0]])
    state, _ = estimator.correct(0, estimator.init(2), y)
    after = estimator.predict(0, state, np.zeros((2, 0)))
    assert np.isfinite(after.x[0]).all() and np.isnan(after.x[1]).all()


def test_what_has_no_flow_is_refused(rng):
    start = {"x0": START["x0"], "P0": START["P0"]}
    with pytest.raises(DesignError, match="kalman"):
        extended_kalman.design(slide(0.02, noise=SlideNoise(1.0, 1.0)), 5, x0=np.zeros(6), P0=np.eye(6))
    disturbed = with_disturbance(pendulum(), Disturbance("input", 0.1), 5, START["x0"])
    with pytest.raises(DesignError, match="leave out `disturbance`"):
        unscented_kalman.design(disturbed, 5, x0=np.zeros(3), P0=np.eye(3))
    with pytest.raises(DesignError, match="choose kappa > -2"):
        unscented_kalman.design(pendulum(), 5, kappa=-2.0, **start)
    exact = LinearModel([[1.0]], [[1.0]], [[1.0]], 1.0, 0.0)
    with pytest.raises(DesignError, match="measurement noise"):
        extended_kalman.design(exact, 5, x0=np.zeros(1), P0=np.eye(1))
    correlated = LinearModel([[1.0]], [[1.0]], [[1.0]], 1.0, 1.0, S_wv=[[0.5]])
    with pytest.raises(DesignError, match="S_wv.*choose kalman-predictor"):
        extended_kalman.design(correlated, 5, x0=np.zeros(1), P0=np.eye(1))
    # What the message offers works, and kalman, which it offered once, does not.
    kalman_predictor.design(correlated, 5, x0=np.zeros(1), P0=np.eye(1))
    with pytest.raises(DesignError, match="use kalman-predictor"):
        kalman.design(correlated, 5, x0=np.zeros(1), P0=np.eye(1))
