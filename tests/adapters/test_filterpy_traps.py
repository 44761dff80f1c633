"""What goes wrong when filterpy is called as its documentation writes it, and what the adapter does."""

import numpy as np
import pytest

pytest.importorskip("filterpy")

import adapters.filterpy_filters as filters
from adapters.loops import alone, loop, signals
from components.one_run import MODEL, START, TS, designed, kalman
from filterpy.kalman import EnsembleKalmanFilter, ExtendedKalmanFilter, IMMEstimator, KalmanFilter

from rmpc_bench.adapters.filterpy import filterpy_estimator
from rmpc_bench.components import by_kind
from rmpc_bench.components.single_run import design_function
from rmpc_bench.conformance.global_random import global_seed
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.types import OperatingPoint

GIVEN = {"model": MODEL, **START, "rng": np.random.default_rng(1)}
TWO_OUTPUTS = LinearModel(MODEL.A, MODEL.B, np.eye(2), MODEL.Q_w, 0.3 * np.eye(2))


def new(marked, **given):
    """Return the filter that a marked function makes."""
    return marked(**{**GIVEN, **given}).filter


def first_of(made, marked):
    """Return x_hat(0) of filterpy called as it is, and of the adapter."""
    made.update(np.array([0.134]))
    return np.ravel(made.x), alone(designed("estimators", marked), np.array([[0.134]]), np.zeros((1, 1)))[0][0]


@pytest.mark.parametrize("name", ["ukf", "ckf_redrawn"])
def test_update_before_the_first_predict(name):
    """Sigma points are zero before the first `predict`, and so is the gain: y(0) moves nothing."""
    marked = getattr(filters, name)
    made = new(marked, Ts=TS)
    made.x, made.sigmas_f = made.x.ravel(), np.zeros_like(made.sigmas_f)
    naive, ours = first_of(made, marked)
    expected = alone(kalman(), np.array([[0.134]]), np.zeros((1, 1)))[0][0]
    assert np.abs(naive[:2] - expected).max() > 0.05
    np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_a_cubature_filter_with_a_flat_state_and_measurement():
    """Its prediction is a column: a flat y gives a state of shape (n, n) after the first update."""
    made = new(filters.ckf, Ts=TS)
    made.x = made.x.ravel()
    made.update(np.array([1.0]))
    assert made.x.shape == (2, 2)
    assert new(filters.ckf, Ts=TS).x.shape == (2, 1)


def test_points_of_the_cubature_filter_leave_out_the_process_noise():
    """filterpy takes the points that fx has moved; drawn again they have the covariance of the prediction.

    The adapter runs the filter as it is: a program without the bench has the same estimates.
    """
    y, u = signals()
    right, theirs = alone(kalman(), y, u), alone(designed("estimators", filters.ckf), y, u)
    assert np.abs(theirs[0] - right[0]).max() > 0.05
    made = new(filters.ckf, Ts=TS)
    for k in range(len(y)):
        if k > 0:
            made.predict(fx_args=(u[k - 1],))
        made.update(y[k, :, None])
        np.testing.assert_array_equal(made.x[:, 0], theirs[0][k])


def test_a_state_of_shape_n_1_with_flat_signals():
    """NumPy makes matrices of them without an error; the adapter hands over columns."""
    made = new(filters.kf_column)
    made.predict(u=np.array([1.0, 2.0])[:1])
    made.B = np.eye(2)
    made.predict(u=np.array([1.0, 2.0]))
    assert made.x.shape == (2, 2)
    naive, further = (
        filters.ekf_column(**{**GIVEN, "model": TWO_OUTPUTS}).filter,
        {
            "HJacobian": lambda x: np.eye(2),
            "Hx": lambda x: x,
        },
    )
    naive.update(np.array([1.0, 2.0]), **further)
    assert naive.x.shape == (2, 2)
    ours = filters.ekf_column(**{**GIVEN, "model": TWO_OUTPUTS})
    flat = filters.ekf(**{**GIVEN, "model": TWO_OUTPUTS})
    for u_previous in (None, np.array([0.5])):
        np.testing.assert_array_equal(
            ours.update(np.array([1.0, 2.0]), u_previous)[0], flat.update(np.array([1.0, 2.0]), u_previous)[0]
        )


def test_a_filter_without_B():
    """filterpy leaves the input out; the adapter refuses the filter."""
    made = new(filters.kf)
    made.B = None
    moved = made.F @ made.x
    made.predict(u=np.array([1.0]))
    np.testing.assert_array_equal(made.x, moved)

    @filterpy_estimator
    def without(model, x0, P0):
        made = filters.linear(KalmanFilter, model, x0, P0)
        made.B = None
        return made

    with pytest.raises(ValueError, match="KalmanFilter ignores the input"):
        without(**GIVEN)


@pytest.mark.parametrize("kind", [KalmanFilter, ExtendedKalmanFilter])
def test_a_filter_without_F(kind):
    """The default F of filterpy is I: the state does not change by itself; the adapter refuses the filter."""

    @filterpy_estimator
    def without(model, x0, P0):
        made = kind(dim_x=2, dim_z=1)
        made.x, made.P, made.B = x0, P0, model.B
        return made

    naive = kind(dim_x=2, dim_z=1)
    naive.x, naive.B = START["x0"], MODEL.B
    naive.predict(u=np.array([1.0]))
    np.testing.assert_array_equal(naive.x, START["x0"] + MODEL.B @ [1.0])
    assert np.abs(naive.x - MODEL.A @ START["x0"] - MODEL.B @ [1.0]).max() > 1e-3
    with pytest.raises(ValueError, match=f"{kind.__name__} has the default F = I .* set F = model.A"):
        without(**GIVEN)


POINT = OperatingPoint(x=np.array([2.0, 1.0]), u=np.array([3.0]), y=np.array([2.0]))
LINEARISED = LinearisedModel(MODEL.A, MODEL.B, MODEL.C, MODEL.Q_w, MODEL.R_v, point=POINT)


def test_a_model_around_an_operating_point():
    """A filter of filterpy has no constant parts: it is refused, or works in deviations."""
    with pytest.raises(ValueError, match=r"ignores f0 and d0 .*deviation=True"):
        filters.kf(**{**GIVEN, "model": LINEARISED})
    y, u = signals()
    y, u = y + POINT.y, u + POINT.u
    given = {"model": LINEARISED, "n_steps": len(y) - 1, "x0": START["x0"] + POINT.x, "P0": START["P0"]}
    right, ours = alone(of_bench(given), y, u), alone(in_deviation(given), y, u)
    np.testing.assert_allclose(ours[0], right[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours[1], right[1], rtol=0, atol=1e-12)
    naive = new(filters.kf, x0=given["x0"])
    naive.update(y[0])
    naive.predict(u[0])
    naive.update(y[1])
    assert np.abs(naive.x - right[0][1]).max() > 0.1


def of_bench(given):
    """Return the Kalman filter of the bench."""
    return by_kind.estimator("kalman", **given)


def in_deviation(given):
    """Return a filter of filterpy in deviations."""

    @filterpy_estimator(deviation=True)
    def kf(model, x0, P0):
        return filters.linear(KalmanFilter, model, x0, P0)

    return design_function("estimators", kf)(**given, Ts=TS)


def test_a_nonlinear_model():
    """`predict` of filterpy's own extended filter is F x + B u, with F = I unless it is set."""

    class Nonlinear:
        """A model with functions in place of matrices."""

        nx, nu, ny = 2, 1, 1

    @filterpy_estimator
    def ekf(x0, P0):
        made = ExtendedKalmanFilter(dim_x=2, dim_z=1)
        made.x, made.P = x0, P0
        return made, {"HJacobian": lambda x: np.array([[1.0, 0.0]]), "Hx": lambda x: x[:1]}

    with pytest.raises(ValueError, match="ExtendedKalmanFilter is linear, the model is not"):
        ekf(**{**GIVEN, "model": Nonlinear()})


def test_a_bank_of_unscented_filters():
    """`predict` of a bank gives u to the first argument, which is the time step of an unscented filter."""

    @filterpy_estimator
    def bank(model, Ts, x0, P0):
        every = [new(filters.ukf, Ts=Ts, x0=x0, P0=P0) for _ in range(2)]
        for each in every:
            each.fx = lambda x, dt, u=0.0: x + dt
        return IMMEstimator(every, [0.5, 0.5], np.full((2, 2), 0.5))

    with pytest.raises(ValueError, match="first argument of UnscentedKalmanFilter.predict"):
        bank(**GIVEN, Ts=TS)
    made = new(filters.ukf, Ts=TS)
    made.fx = lambda x, dt, u=0.0: x + dt
    made.predict(100.0)
    np.testing.assert_allclose(made.x, START["x0"] + 100.0)


def test_an_ensemble_draws_from_the_generator_of_its_run():
    """filterpy takes NumPy's global generator: other numbers in every process and for every block length."""

    def naive():
        made = new(filters.enkf, Ts=TS)
        made.update(np.ones(1))
        return made.x

    assert not np.array_equal(naive(), naive())
    estimator = designed("estimators", filters.enkf)
    with global_seed(1):
        ours, after = loop(estimator)["x_hat"], np.random.random()  # noqa: NPY002
    with global_seed(1):
        assert np.random.random() == after  # noqa: NPY002
    with global_seed(2):
        np.testing.assert_array_equal(loop(estimator, block=1)["x_hat"], ours)
    assert len({*ours[:, 0, 0]}) == len(ours)


def test_a_large_ensemble_is_near_the_kalman_filter():
    """Its error is that of a sample of 2000: about 1 / sqrt(2000) standard deviations."""
    ours = loop(designed("estimators", filters.enkf, N=2000))["x_hat"]
    assert 1e-3 < np.abs(ours - loop(kalman())["x_hat"]).max() < 0.15


def test_an_ensemble_whose_input_does_not_arrive():
    """`predict` of filterpy's ensemble takes no input."""

    @filterpy_estimator
    def enkf(model, Ts, x0, P0):
        return EnsembleKalmanFilter(x0, P0, 1, Ts, 5, lambda x: x[:1], lambda x, dt: x)

    with pytest.raises(ValueError, match="the input does not reach EnsembleKalmanFilter"):
        enkf(**GIVEN, Ts=TS)


def test_a_function_without_x0_or_P0():
    """filterpy starts at x = 0, P = I: forgotten start values would not be seen."""
    with pytest.raises(TypeError, match="forgotten needs the argument P0"):

        @filterpy_estimator
        def forgotten(model, x0):
            return KalmanFilter(2, 1)
