"""LP1 on a moving window against the program of the paper, sample by sample, and where it cannot be solved."""

import numpy as np
import pytest
from estimators.state_dependent_models import Base, Mass
from numerics import lp_twin

from rmpc_bench.config_file import factories
from rmpc_bench.estimators.lp_window import PATIENCE, design
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import Pair
from rmpc_bench.numerics import bounded_window
from rmpc_bench.types import DesignError, Model, Status

NOISE = 0.01


def run(estimator, y, u):
    """Estimates over time."""
    state, estimates = estimator.init(len(y)), []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, y[:, k])
        estimates.append(estimate)
        state = estimator.predict(k, state, u[:, k])
    return estimates


def windows(model, estimates, y, u, Ne, start):
    """(k, run, window) as the paper's program takes it: the pairs of the estimates, the estimate before the window."""
    x_hat = np.stack([estimate.x_hat for estimate in estimates], axis=1)
    for k in range(2, len(estimates)):
        points = min(k, Ne) + 1 if start == "free" else min(k, Ne + 1)
        if points < 3:
            continue
        for i in range(len(y)):
            A, B = model.at_state(x_hat[i])
            first = k - points + 1
            pairs = [max(j - 1, 0) for j in range(first, k + 1)]  # of k = 0, a free window does not use it
            c = np.stack([B[j] @ u[i, j] for j in pairs])
            C = np.broadcast_to(model.C, (points, *model.C.shape))
            before = x_hat[i, max(first - 1, 0)]
            yield k, i, lp_twin.Data(y[i, first : k + 1], A[pairs], c, C, before, start == "anchored")


@pytest.mark.parametrize("Ne", [2, 3])
def test_a_free_window_is_the_program_of_the_paper(Ne, rng):
    """Oracle: linprog on (17)-(19) at every sample, with the pairs of the estimates; the optimum is unique."""
    model = Mass()
    _, y, u = model.simulated(rng, 3, 12, NOISE)
    estimates = run(design(model, 12, x0=np.zeros(2), Ne=Ne), y, u)
    for k, i, window in windows(model, estimates, y, u, Ne, "free"):
        _, x, rho, r = lp_twin.solve(window)
        np.testing.assert_allclose(estimates[k].x_hat[i], x, atol=1e-8)  # SciPy's 1e-10, divided by Ts
        np.testing.assert_allclose(np.r_[estimates[k].info["rho"][i], estimates[k].info["r"][i]], [*rho, *r], atol=1e-9)
        assert estimates[k].info["fallback"][i] == 0.0


@pytest.mark.parametrize(("Ne", "start"), [(6, "free"), (2, "anchored"), (3, "anchored")])
def test_other_windows_have_the_optimum_of_the_paper(Ne, start, rng):
    """Oracle: linprog; of the optima, which are many, only the objective can be compared."""
    model = Mass()
    _, y, u = model.simulated(rng, 2, 9, NOISE)
    estimates = run(design(model, 9, x0=np.zeros(2), Ne=Ne, start=start), y, u)
    compared = 0
    for k, i, window in windows(model, estimates, y, u, Ne, start):
        objective, *_ = lp_twin.solve(window)
        ours = estimates[k].info["rho"][i].sum() + estimates[k].info["r"][i].sum()
        assert abs(objective - ours) < 1e-9
        compared += 1
    assert compared >= 14


def test_the_beginning_by_hand(rng):
    """Oracle: x0 at k = 0; at k = 1 the prediction with its position halfway to y; then windows."""
    model = Mass()
    _, y, u = model.simulated(rng, 2, 3, NOISE)
    x0 = np.array([0.5, -1.0])
    first, second, third = run(design(model, 2, x0=x0), y[:, :3], u[:, :3])
    np.testing.assert_array_equal(first.x_hat, [x0, x0])
    A, B = model.at_state(x0[None])
    x_pred = A[0] @ x0 + u[:, 0] @ B[0].T
    np.testing.assert_allclose(second.x_hat[:, 0], 0.5 * (x_pred[:, 0] + y[:, 1, 0]))
    np.testing.assert_allclose(second.x_hat[:, 1], x_pred[:, 1])
    for estimate, missing in ((first, True), (second, True), (third, False)):
        assert np.isnan(estimate.info["r"]).all() == np.isnan(estimate.info["rho"]).all() == missing
        assert not estimate.info["fallback"].any() and (estimate.status == Status.OK).all()


class Varying(Model):
    """A linear model whose matrices and constant parts change with time."""

    def at(self, k):
        A = np.array([[0.9, 0.2, 0.0], [0.0, 0.95, 0.1 + 0.02 * k], [0.1 * np.sin(k), 0.0, 0.9]])
        C = np.array([[1.0, 0.0, 0.1 * np.cos(k)], [0.0, 1.0, 0.5]])
        f0, d0 = np.array([0.1 * k, -0.2, 0.3]), np.array([1.0 + k, -2.0])
        return LinearModel(A, np.ones((3, 1)), C, np.eye(3), np.eye(2), f0=f0, d0=d0)


@pytest.mark.parametrize(("Ne", "start"), [(2, "free"), (4, "free"), (3, "anchored")])
def test_without_noise_it_is_the_state(Ne, start, rng):
    """Oracle: a simulation of a time-varying model with constant parts; anchored, if it begins with the state."""
    model, x = Varying(), rng.standard_normal((3, 3))
    x0 = x[0] if start == "anchored" else np.zeros(3)
    x = np.tile(x[0], (3, 1)) if start == "anchored" else x
    states, y, u = [], [], rng.standard_normal((3, 11, 1))
    for k in range(11):
        now = model.at(k)
        states.append(x)
        y.append(x @ now.C.T + now.d0)
        x = x @ now.A.T + u[:, k] @ now.B.T + now.f0
    estimates = run(design(model, 10, x0=x0, Ne=Ne, start=start), np.stack(y, axis=1), u)
    for k in range(3, 11):
        if start == "free":  # anchored, the beginning is not exact: its first estimates are halfway between equals
            np.testing.assert_allclose(estimates[k].x_hat, states[k], atol=1e-11)
        np.testing.assert_allclose(estimates[k].x_hat, states[k], atol=1e-8)
        assert estimates[k].info["r"].max() < 1e-8


def test_a_missing_measurement_is_bridged(rng):
    """Oracle: by hand; the prediction at k, then predictions halfway to y until the window is whole again."""
    model = Mass()
    _, y, u = model.simulated(rng, 2, 14, NOISE)
    y[1, 6] = np.nan
    estimates = run(design(model, 14, x0=np.zeros(2), Ne=3), y, u)
    fallback = np.array([estimate.info["fallback"] for estimate in estimates])
    np.testing.assert_array_equal(np.flatnonzero(fallback[:, 1]), [6, 7, 8, 9])
    assert not fallback[:, 0].any()
    for k in range(6, 10):
        A, B = model.at_state(estimates[k - 1].x_hat[1:])
        x_pred = A[0] @ estimates[k - 1].x_hat[1] + B[0] @ u[1, k - 1]
        position = x_pred[0] if k == 6 else 0.5 * (x_pred[0] + y[1, k, 0])
        np.testing.assert_allclose(estimates[k].x_hat[1], [position, x_pred[1]], rtol=1e-12)
        assert np.isnan(estimates[k].info["r"][1]).all() and estimates[k].status[1] == Status.OK
    y[1, 6] = 0.0
    np.testing.assert_array_equal(estimates[13].x_hat[0], run(design(model, 14, x0=np.zeros(2)), y, u)[13].x_hat[0])


@pytest.mark.parametrize("gap", [PATIENCE - 3, PATIENCE + 1])
def test_a_long_gap_ends_the_run(gap):
    """Oracle: by hand; a gap of n samples costs n + Ne fits in a row, and the beginning does not count."""
    y = np.zeros((2, gap + 20, 1))
    y[1, 10 : 10 + gap] = np.inf
    with np.errstate(invalid="ignore"):  # inf - inf
        estimates = run(design(Mass(), gap + 19, x0=np.zeros(2)), y, np.zeros_like(y))
    status = np.array([estimate.status for estimate in estimates])
    assert not status[:, 0].any() and np.isfinite(estimates[-1].x_hat).all()
    bad = np.flatnonzero(status[:, 1] == Status.DIVERGED)
    assert (bad.tolist() == []) if gap == PATIENCE - 3 else (bad.tolist() == list(range(60, 10 + gap + 3)))


def test_an_estimate_that_is_too_large_ends_the_run(rng):
    """Oracle: `largest` of the model, 20; a linear model has none."""
    model, y = Mass(), np.tile([[19.9], [20.1]], (1, 6))[:, :, None]
    status = np.array([estimate.status for estimate in run(design(model, 5, x0=np.array([20.0, 0.0])), y, 0.0 * y)])
    np.testing.assert_array_equal(status[3:], np.tile([Status.OK, Status.DIVERGED], (3, 1)))
    A, B = model.at_state(np.zeros((1, 2)))
    linear = LinearModel(A[0], B[0], model.C, model.Q_w, model.R_v)
    assert not any(estimate.status.any() for estimate in run(design(linear, 5, x0=np.zeros(2)), 1e3 * y, 0.0 * y))


def test_a_window_that_is_too_short_is_a_design_error():
    """Oracle: ceil(nx / ny) = 2 for a mass, 3 for a model with three states and one output; the message says so."""
    with pytest.raises(DesignError, match="at least") as caught:
        design(Mass(), 5, x0=np.zeros(2), Ne=1)
    assert caught.value.parameter == "Ne" and "2" in str(caught.value)
    three = LinearModel(np.eye(3), np.ones((3, 1)), np.ones((1, 3)), np.eye(3), np.eye(1))
    with pytest.raises(DesignError, match="must be at least 3 for 3 states and 1 outputs"):
        design(three, 5, x0=np.zeros(3), Ne=2)
    design(three, 5, x0=np.zeros(3), Ne=3)


def test_what_it_offers(rng):
    """Oracle: the length of the window; the shapes of what it reports."""
    model = Mass()
    _, y, u = model.simulated(rng, 3, 3, NOISE)
    estimator = design(model, 3, x0=np.zeros(2))
    assert estimator.Ne == 3
    estimator.warm_up()
    for estimate in run(estimator, y, u):
        assert {name: values.shape[1:] for name, values in estimate.info.items()} == estimator.reports


def robot(rng, runs, steps):
    """Model, first state, measurements and torques of the robot along a path of its own."""
    model = factories.model("moving-slide", 0.01)
    plant = factories.plant("moving-slide", 0.01)
    nominal = {name: np.full(runs, value) for name, value in plant.nominal.items()}
    delta = plant.draw(nominal, [np.random.default_rng(i) for i in range(runs)], steps)
    x, u = np.tile([0.05, 0.08, 0.0, 0.0, 0.0, 0.0], (runs, 1)), np.zeros((runs, steps + 1, 4))
    phase = rng.uniform(0.0, 6.0, (runs, 4))
    y, still = [], np.zeros((runs, plant.nv))
    for k in range(steps + 1):
        u[:, k] = 0.2 * np.sin(0.05 * k + phase)
        y.append(plant.output(k, delta, x, still) + 5e-4 * rng.uniform(-1.0, 1.0, (runs, 3)))
        x = plant.step(k, delta, x, u[:, k], np.zeros((runs, plant.nw))).x
    return model, np.array([0.05, 0.08, 0.0, 0.0, 0.0, 0.0]), np.stack(y, axis=1), u


def test_on_the_robot_the_reduced_program_is_the_full_one(rng, monkeypatch):
    """Oracle: linprog at some 200 instants, in units of the noise; no solver of the bench is asked."""
    monkeypatch.setattr(bounded_window, "least_noise_fit", None)
    model, x0, y, u = robot(rng, 4, 51)
    estimates = run(design(model, 51, x0=x0), y, u)
    unit = 5e-4
    for k, i, window in windows(model, estimates, y, u, 3, "free"):
        scaled = window._replace(y=window.y / unit, c=window.c / unit, before=window.before / unit)
        _, x, _, r = lp_twin.solve(scaled)
        np.testing.assert_allclose(estimates[k].x_hat[i, :3], unit * x[:3], atol=1e-9 * unit)
        np.testing.assert_allclose(estimates[k].x_hat[i, 3:], unit * x[3:], atol=1e-7 * unit)  # divided by Ts
        np.testing.assert_allclose(estimates[k].info["r"][i], unit * r, atol=1e-9 * unit)
        assert not estimates[k].info["rho"][i].any() and not estimates[k].info["fallback"][i]


def test_a_model_of_its_own_for_every_run(rng):
    """Oracle: every run alone, bit for bit, with a model that remembers for whom it was made anew."""
    asked = []

    class Remembering(Mass):
        def at_state(self, x):
            asked.append(x.copy())
            return Pair(*Mass.at_state(self, x))

    model = Remembering()
    assert isinstance(model, Base)
    _, y, u = model.simulated(rng, 3, 8, NOISE)
    asked.clear()
    estimates = run(design(model, 8, x0=np.zeros(2)), y, u)
    for x, estimate in zip(asked, estimates, strict=True):
        np.testing.assert_array_equal(x, estimate.x_hat)
    for i in range(3):
        alone = run(design(model, 8, x0=np.zeros(2)), y[i : i + 1], u[i : i + 1])
        np.testing.assert_array_equal(alone[-1].x_hat[0], estimates[-1].x_hat[i])
