"""Metrics of states and estimates against plain loops, closed forms and filters that are right about themselves."""

import numpy as np
import pytest
from conftest import ROUND, random_model, random_psd, within_stat
from simulation.toy import Halfway, Proportional, Walk

from rmpc_bench import registry
from rmpc_bench.metrics import estimation, tracking
from rmpc_bench.metrics.tracking import Units
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError, Estimate, Estimator, Method, Record

TOY = Method("toy", Halfway(), Proportional())
N, RUNS, NX = 6, 4, 3
UNITS = Units(N, 0.5, "rad", "V")
SIZES = {tracking.mse: lambda e: e * e, tracking.rmse: lambda e: e * e, tracking.mae: abs}


def trajectories(rng, runs=RUNS, n_steps=N, nx=NX, per_run=None):
    """Random trajectories, with random P and M that are shared (False), per run (True) or not there (None)."""
    x, x_hat = rng.standard_normal((2, runs, n_steps + 1, nx))
    y, u = rng.standard_normal((runs, n_steps + 1, 2)), rng.standard_normal((runs, n_steps, 1))
    P = M = None
    if per_run is not None:
        shape = (runs, n_steps + 1) if per_run else (n_steps + 1,)
        P = np.array([random_psd(rng, nx) for _ in range(np.prod(shape))]).reshape(*shape, nx, nx)
        M = np.array([8.0 * random_psd(rng, nx) for _ in range(np.prod(shape))]).reshape(*shape, nx, nx)
    return Record(0.5, x, y, x_hat, u, rng.standard_normal((n_steps + 1, 2)), P, M)


def plant(nx):
    """Toy plant that claims to have another number of states."""
    made = Walk()
    made.nx = nx
    return made


class Sure(Estimator):
    """An estimator that says a constant, with a covariance or without."""

    def __init__(self, nx, P):
        self.nx, self.P = nx, P

    def init(self, n_runs):
        """Nothing to remember."""

    def correct(self, k, state, y):
        """Say zero."""
        return state, Estimate(np.zeros((len(y), self.nx)), self.P, None, np.zeros(len(y), dtype=np.int8), {})


def method(nx, *, P=None, name="M"):
    """Pair with a constant estimator."""
    return Method(name, Sure(nx, P), TOY.controller)


# -- of: output, state, estimate ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", SIZES)
@pytest.mark.parametrize("of", ["output", "state", "estimate"])
@pytest.mark.parametrize(("bounds", "samples"), [({}, range(0, 6)), ({"to": "N"}, range(0, 7))])
def test_mean_errors_against_plain_loops(make, of, bounds, samples, rng):
    """Oracle: loops over runs, samples and coordinates."""
    block = trajectories(rng)
    for i, value in enumerate(make(UNITS, of=of, **bounds).evaluate(block)):
        sizes = []
        for k in samples:
            e = {"output": block.y[i, k] - block.r[k], "state": block.x[i, k]}.get(
                of, block.x_hat[i, k] - block.x[i, k]
            )
            sizes += [SIZES[make](float(each)) for each in e]
        mean = sum(sizes) / len(sizes)
        np.testing.assert_allclose(value, mean**0.5 if make is tracking.rmse else mean, **ROUND)


def test_the_output_is_what_a_metric_measures_unless_told(rng):
    """Oracle: the same bits."""
    block = trajectories(rng)
    for make in SIZES:
        np.testing.assert_array_equal(make(UNITS).evaluate(block), make(UNITS, of="output").evaluate(block))


def test_estimation_mse_is_the_mse_of_the_estimate(rng):
    """Oracle: product.md section 7; the same bits and window under another name."""
    block, one = trajectories(rng), estimation.estimation_mse(UNITS, from_=0.5, to="N")
    other = tracking.mse(UNITS, of="estimate", from_=0.5, to="N")
    np.testing.assert_array_equal(one.evaluate(block), other.evaluate(block))
    assert (one.info, one.window) == (("estimation_mse", "", "lower", False), (1, 6))
    assert estimation.estimation_mse(UNITS, name="mine").info.name == "mine"


@pytest.mark.parametrize(
    ("make", "units"),
    [
        (tracking.mse, ("rad^2", "", "")),
        (tracking.rmse, ("rad", "", "")),
        (tracking.mae, ("rad", "", "")),
    ],
)
def test_states_have_no_unit(make, units):
    """Oracle: coordinates of a state differ in theirs."""
    assert tuple(make(UNITS, of=of).info.unit for of in ("output", "state", "estimate")) == units


def test_the_square_of_no_unit_is_none():
    """Oracle: a plant without units has no `^2`."""
    bare = Units(N, 0.5, "", "")
    assert tracking.mse(bare).info.unit == tracking.input_power(bare).info.unit == tracking.rmse(bare).info.unit == ""


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "keys", "parameter"),
    [
        (tracking.mse, {"of": "estimate"}, "of"),
        (tracking.rmse, {"of": "estimate"}, "of"),
        (tracking.mae, {"of": "estimate"}, "of"),
        (estimation.estimation_mse, {}, ""),
        (estimation.nees, {}, ""),
    ],
)
def test_an_estimate_of_another_length_is_refused(make, keys, parameter, rng):
    """Oracle: x_hat - x needs equal lengths; before any run where methods are known, else when it is evaluated."""
    units = UNITS._replace(plant=plant(5), methods=(method(5, P=np.eye(5)), method(4, name="S-MPC")))
    with pytest.raises(DesignError, match="x_hat of method 'S-MPC' has 4 components and x of the plant 5") as caught:
        make(units, **keys)
    assert caught.value.parameter == parameter
    make(units._replace(methods=units.methods[:1]), **keys)
    block = trajectories(rng)
    for n in (1, 2):
        with pytest.raises(DesignError, match=f"x_hat has {n} components and x of the plant 3"):
            make(UNITS, **keys).evaluate(block._replace(x_hat=block.x_hat[:, :, :n]))


def test_output_and_state_do_not_ask_the_estimator():
    """Oracle: an estimator that cannot be asked."""
    units = UNITS._replace(plant=plant(5), methods=(Method("M", None, None),))
    for make in SIZES:
        assert make(units).window == make(units, of="state").window == (0, 5)


def test_an_oracle_estimator_is_not_called_without_a_drawn_plant():
    """Oracle: its `init` needs more than the number of runs, and `correct` is not there."""
    oracle = type("Oracle", (), {"knows_uncertainty": True, "init": lambda self, n_runs, delta: None})()
    estimation.nees(UNITS._replace(plant=plant(5), methods=(Method("oracle", oracle, None),)))


def test_nees_without_a_covariance_is_refused(rng):
    """Oracle: the toy's estimator gives no P; where nobody could know, no run has a value."""
    units = UNITS._replace(plant=plant(1), methods=(method(1, P=np.eye(1)), TOY, method(1, name="other")))
    with pytest.raises(DesignError, match=rf"estimator of '{TOY.name}', 'other' does not give; leave the metric or"):
        estimation.nees(units)
    estimation.nees(units._replace(methods=units.methods[:1]))
    values = estimation.nees(UNITS).evaluate(trajectories(rng))
    np.testing.assert_array_equal(values, np.full(RUNS, np.nan))


# -- nees --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("per_run", [False, True])
def test_nees_against_plain_loops(per_run, rng):
    """Oracle: loops over runs and samples with a linear solve (condition 10: 1e-12 is far from its rounding)."""
    block = trajectories(rng, per_run=per_run)
    for bounds, samples in (({}, range(0, 6)), ({"to": "N"}, range(0, 7)), ({"from_": 1.0, "to": 1.5}, range(2, 4))):
        for i, value in enumerate(estimation.nees(UNITS, **bounds).evaluate(block)):
            total = 0.0
            for k in samples:
                e = block.x_hat[i, k] - block.x[i, k]
                total += e @ np.linalg.solve(block.P[i, k] if per_run else block.P[k], e) / NX
            np.testing.assert_allclose(value, total / len(samples), **ROUND)


def test_nees_says_what_it_is_and_asks_for_P():
    """Oracle: product.md section 7; no other metric asks for it."""
    metric = estimation.nees(UNITS)
    assert metric.info == ("nees", "", "one", False)
    others = [tracking.mse(UNITS), tracking.mse(UNITS, of="estimate"), estimation.estimation_mse(UNITS)]
    assert metric.needs_P and not any(other.needs_P for other in others)


def filtered(model, x0, P0, rng, runs, n_steps):
    """Runs of a model and the Kalman filter that believes it, step by step."""
    estimator = registry.estimator("kalman", model, n_steps=n_steps, x0=x0, P0=P0)
    x = rng.multivariate_normal(x0, P0, runs, method="svd")
    state, xs, x_hats = estimator.init(runs), [], []
    for k in range(n_steps + 1):
        v = rng.multivariate_normal(np.zeros(len(model.C)), model.R_v, runs)
        state, estimate = estimator.correct(k, state, x @ model.C.T + v)
        xs.append(x)
        x_hats.append(estimate.x_hat)
        u = rng.standard_normal((runs, model.B.shape[1]))
        state = estimator.predict(k, state, u)
        w = rng.multivariate_normal(np.zeros(model.nx), model.Q_w, runs, method="svd")
        x = x @ model.A.T + u @ model.B.T + w
    y = np.zeros((runs, n_steps + 1, 1))
    x, x_hat = np.stack(xs, axis=1), np.stack(x_hats, axis=1)
    return Record(1.0, x, y, x_hat, np.zeros((runs, n_steps, 1)), y[0], estimator.P)


def test_a_scalar_filter_that_is_right_has_nees_one(scalar_model, rng):
    """Oracle: its error over its own deviation is standard normal; twice the covariance gives half."""
    block = filtered(scalar_model, np.zeros(1), np.eye(1), rng, 2000, 30)
    units = Units(30, 1.0, "", "")
    values = estimation.nees(units).evaluate(block)
    assert within_stat(values, 1.0)
    doubled = estimation.nees(units).evaluate(block._replace(P=2.0 * block.P))
    np.testing.assert_allclose(doubled, values / 2.0, **ROUND)


def test_a_filter_of_three_states_that_is_right_has_nees_one(rng):
    """Oracle: the mean of chi-square with three degrees of freedom is 3."""
    model = random_model(rng)
    block = filtered(model, np.ones(3), 4.0 * np.eye(3), rng, 2000, 20)
    assert within_stat(estimation.nees(Units(20, 1.0, "", "")).evaluate(block), 1.0)


def test_nees_of_a_singular_filter_that_is_right_is_its_rank_over_nx(rng):
    """Oracle: a plane that holds the first state and the noise and that A maps into itself; the error stays in it."""
    T = np.array([[1.0, 0.0], [0.3, 1.0], [0.7, -2.0]])  # columns span the plane
    onto = T @ np.linalg.pinv(T)
    A = T @ np.array([[0.9, 0.2], [-0.2, 0.8]]) @ np.linalg.pinv(T) + 0.5 * (np.eye(3) - onto)
    d = T @ np.array([[1.0], [2.0]])
    model = LinearModel(A, np.zeros((3, 1)), [[1.0, 0.0, 1.0]], 0.3 * d @ d.T, [[1.0]])
    block = filtered(model, np.zeros(3), T @ T.T, rng, 2000, 20)
    values = estimation.nees(Units(20, 1.0, "", "")).evaluate(block)
    assert np.isfinite(values).all()
    assert within_stat(values, 2.0 / 3.0)


def one_sample(e, P, x=None):
    """NEES of one run with one error at both samples."""
    x = np.zeros(len(e)) if x is None else np.asarray(x, dtype=float)
    x = np.tile(x, (1, 2, 1))
    y = np.zeros((1, 2, 1))
    P = np.tile(np.asarray(P, dtype=float), (2, 1, 1))
    block = Record(1.0, x, y, x + np.asarray(e, dtype=float), np.zeros((1, 1, 1)), y[0], P)
    return estimation.nees(Units(1, 1.0, "", "")).evaluate(block)[0]


@pytest.mark.parametrize(
    ("e", "P", "value"),
    [
        ([1.0, 2.0], [[4.0, 0.0], [0.0, 1.0]], (0.25 + 4.0) / 2),
        ([3.0, 3.0], [[9.0, 9.0], [9.0, 9.0]], 1.0 / 2),  # along the only direction
        ([3.0, 3.1], [[9.0, 9.0], [9.0, 9.0]], np.inf),  # beside it
        ([3.0, 3.0 + 1e-12], [[9.0, 9.0], [9.0, 9.0]], 1.0 / 2),  # but for rounding
        ([2.0, 0.0], [[4.0, 0.0], [0.0, 0.0]], 1.0 / 2),
        ([2.0, 1e-3], [[4.0, 0.0], [0.0, 0.0]], np.inf),
        ([0.0, 0.0], [[0.0, 0.0], [0.0, 0.0]], 0.0),
        ([0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]], np.inf),
        ([1e-6, 1e6], [[1e-12, 0.0], [0.0, 1e12]], 1.0),  # no coordinate is small beside another one
        ([1.0, 1.0], [[1.0, 0.0], [0.0, -1.0]], np.inf),  # not a covariance
        ([1.0, 1.0], [[1.0, 0.0], [0.0, np.nan]], np.nan),
        ([1.0, 1.0], [[1.0, np.nan], [np.nan, 0.0]], np.nan),
        ([1.0, np.nan], [[1.0, 0.0], [0.0, 0.0]], np.nan),
    ],
)
def test_nees_of_one_error(e, P, value):
    """Oracle: by hand."""
    np.testing.assert_allclose(one_sample(e, P), value, **ROUND)


def test_rounding_of_a_certain_coordinate_is_no_error():
    """Oracle: 1e-10 beside 1e6 is rounding of doubles, beside 1e-3 it is not."""
    P = [[1.0, 0.0], [0.0, 0.0]]
    assert one_sample([1.0, 1e-10], P, x=[0.0, 1e6]) == pytest.approx(0.5, rel=1e-12)
    assert one_sample([1.0, 1e-10], P, x=[0.0, 1e-3]) == np.inf


def test_units_of_the_coordinates_do_not_matter(rng):
    """Oracle: x -> D x leaves the number as it is, singular covariances included."""
    for rank in (3, 2, 1):
        P = random_psd(rng, 3, rank=rank)
        e = P @ rng.standard_normal(3)
        D = np.diag([1e-7, 1.0, 1e7])
        value = one_sample(e, P)
        np.testing.assert_allclose(value, e @ np.linalg.pinv(P, rcond=1e-12, hermitian=True) @ e / 3, rtol=1e-9)
        np.testing.assert_allclose(one_sample(D @ e, D @ P @ D), value, rtol=1e-9)  # of P's condition, not of a solver
