"""What goes wrong when filterpy is called as its documentation writes it, and what the adapter does."""

import re
import warnings

import numpy as np
import pytest

pytest.importorskip("filterpy")

import adapters.filterpy_filters as filters
from adapters.loops import alone, failing, loop, signals, without
from components.one_run import MODEL, START, TS, designed, kalman
from filterpy.hinfinity import HInfinityFilter
from filterpy.kalman import (
    EnsembleKalmanFilter,
    ExtendedKalmanFilter,
    IMMEstimator,
    InformationFilter,
    KalmanFilter,
    SquareRootKalmanFilter,
)
from small_experiment import cli

from rmpc_bench.adapters.filterpy import filterpy_estimator
from rmpc_bench.components.single_run import design_function
from rmpc_bench.config_file import factories
from rmpc_bench.conformance.outcome import global_seed
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


@pytest.mark.parametrize("kind", [KalmanFilter, SquareRootKalmanFilter, InformationFilter])
def test_a_filter_without_H(kind):
    """The default H of filterpy is 0: a filter that never uses y and says nothing; `update` may get H in each call."""

    @filterpy_estimator
    def without(model, x0, P0, in_update: bool = False):
        made = kind(2, 1)
        made.x, made.F, made.B, made.Q = x0, model.A, model.B, model.Q_w
        return (made, {"H": model.C, "R": model.R_v}) if in_update else made

    naive = kind(2, 1)
    naive.x = START["x0"][:, None]
    naive.update(np.array([[5.0]]))
    np.testing.assert_array_equal(naive.x[:, 0], START["x0"])
    with pytest.raises(ValueError, match=f"{kind.__name__} has the default H = 0 and ignores y: set H = model.C"):
        without(**GIVEN)
    if kind is KalmanFilter:
        moved, _ = without(**GIVEN, in_update=True).update(np.array([5.0]), None)
        assert np.abs(moved - START["x0"]).max() > 1.0


def kept(marked, **more):
    """Return the texts of the warnings of an adapter."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        marked(**{**GIVEN, **more})
    return {str(each.message) for each in caught if each.category is UserWarning}


def test_defaults_in_place_of_numbers_of_the_experiment_are_said():
    """Each may be meant, so that it is a remark: of `check`, of the run and of the check of the component."""

    @filterpy_estimator
    def few(model, x0, P0):
        made = KalmanFilter(2, 1)
        made.F, made.B, made.H = model.A, model.B, model.C
        return made

    @filterpy_estimator
    def bank(model, x0, P0):
        made = [filters.linear(KalmanFilter, model, x0, P0) for _ in range(2)]
        made[1].R = np.eye(1)
        return IMMEstimator(made, [0.5, 0.5], np.full((2, 2), 0.5))

    @filterpy_estimator
    def information(model, x0, P0):
        made = InformationFilter(2, 1)
        made.F, made.B, made.H, made.Q, made.x = model.A, model.B, model.C, model.Q_w, x0[:, None]
        return made

    has = "KalmanFilter has the default"
    assert kept(few) == {f"{has} {each}" for each in (
        "x = 0 in place of x0", "Q = I in place of model.Q_w", "R = I in place of model.R_v")}  # fmt: skip
    assert kept(bank) == {f"{has} R = I in place of model.R_v"}
    assert kept(information) == {"InformationFilter has the default R_inv = I in place of model.R_v"}
    assert kept(filters.kf) == kept(filters.imm) == kept(filters.information) == set()


def test_another_time_step_of_a_filter_is_said():
    """filterpy calls fx with its own dt; a function that does not use it is right all the same."""

    @filterpy_estimator
    def ukf(x0, P0, dt: float):
        return new(filters.ukf, Ts=dt, x0=x0, P0=P0)

    assert kept(ukf, Ts=TS, dt=TS) == kept(filters.enkf, Ts=TS) == set()
    assert kept(ukf, Ts=TS, dt=1.0) == {f"UnscentedKalmanFilter has dt = 1.0, the sampling time is {TS} s"}


@pytest.mark.long
def test_remarks_on_defaults_reach_check_and_run(tmp_path):
    """With the names of the methods; `check --component` has them, too."""
    (tmp_path / "own.py").write_text(OWN)
    path = tmp_path / "own.yaml"
    path.write_text(PARTS)
    done = cli("check", path)
    said = "UserWarning: KalmanFilter has the default R = I in place of model.R_v"
    assert done.exit_code == 0 and done.stderr.strip(), done.output
    shown = " ".join(done.stdout.split())
    assert f"KF: {said}" in shown and f"KF2: {said}" not in shown
    component = cli("check", "--component", f"{tmp_path / 'own.py'}:kf")
    assert re.search(rf"information +warnings +no call gives a warning\s+{said[:40]}", component.stdout), (
        component.output
    )
    done = cli("run", path, "-o", tmp_path / "out", "-j", 1)
    assert " 1 warning of components: tables/summary.md\n" in done.stdout
    assert f"- KF, 3 times: {said}" in (tmp_path / "out" / "tables" / "summary.md").read_text()


OWN = """
from filterpy.kalman import KalmanFilter
from rmpc_bench.adapters.filterpy import filterpy_estimator


@filterpy_estimator
def kf(model, x0, P0, with_R: bool = False):
    made = KalmanFilter(2, 1)
    made.x, made.P, made.Q, made.F, made.B, made.H = x0, P0, model.Q_w, model.A, model.B, model.C
    if with_R:
        made.R = model.R_v
    return made
"""
PARTS = """
version: 1
name: own
runs: 3
time: {step: 0.1, steps: 5}
plant: {kind: linear, A: [[1, 0.1], [0, 0.98]], B: [[0], [0.1]], C: [[1, 0]]}
model: {from: plant, P_w: 1e-4, P_v: 1e-2}
noise: {process: {gaussian: {cov: 1e-4}}, measurement: {gaussian: {cov: 1e-2}}}
input: {kind: prbs, low: -1, high: 1, hold: 0.5}
methods:
  KF: {estimator: {file: own.py:kf}}
  KF2: {estimator: {file: own.py:kf, with_R: true}}
metrics: [estimation_mse]
"""


def h_infinity(model, x0, P0, gamma=0.0):
    """Return the H-infinity filter of filterpy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = HInfinityFilter(2, 1, 1, gamma)
    made.x, made.P, made.F, made.B, made.H = x0, P0, model.A, model.B, model.C
    made.V, made.W = model.R_v, model.Q_w
    return made


def test_the_h_infinity_filter_is_not_the_kalman_filter():
    """The gain of filterpy contains F, and `predict` multiplies by F again; its P is that of the next sample."""
    marked = filterpy_estimator(h_infinity)
    y, u = signals()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs, right = marked(**GIVEN), alone(kalman(), y, u)[0]
    made = h_infinity(MODEL, START["x0"], START["P0"])
    for k in range(5):
        if k:
            made.predict(u[k - 1])
        made.update(y[k])
        x_hat = theirs.update(y[k], u[k - 1] if k else None)
        np.testing.assert_array_equal(x_hat, made.x)
        assert x_hat.shape == (2,)  # without P
        assert np.abs(x_hat - right[k]).max() > 1e-3
    assert {text.partition(":")[0] for text in kept(marked)} == {
        "HInfinityFilter is not the Kalman filter with gamma = 0"
    }

    @filterpy_estimator
    def without_V(model, x0, P0):
        made = h_infinity(model, x0, P0)
        made._V = made._V_inv = np.zeros((1, 1))
        return made

    with pytest.raises(ValueError, match="HInfinityFilter has the default V = 0 and ignores y: set V = model.R_v"):
        without_V(**GIVEN)


def scaled(x, dt, scale=1.0):
    """Move without an input; the third argument has a default."""
    return scale * (MODEL.A @ x)


@pytest.mark.parametrize("kind", ["ukf", "ckf_redrawn"])
def test_the_input_replaces_no_default_of_fx(kind):
    """Naive form: the third argument is the input, whatever its name and its default."""
    f = lambda x, u, scale=1.0: scale * (MODEL.A @ x + MODEL.B @ u)  # noqa: E731
    functions = {
        "scale": scaled,
        "named": lambda x, dt, scale=1.0, u=None: f(x, u, scale),
        "last": lambda x, dt, u=None, scale=1.0: f(x, u, scale),
        "other": lambda x, dt, inflow, scale=1.0: f(x, inflow, scale),
    }

    def made(name):
        @filterpy_estimator
        def marked(model, Ts, x0, P0):
            made = new(getattr(filters, kind), Ts=Ts, x0=x0, P0=P0)
            made.fx, made.x = functions[name], np.ravel(made.x)
            return made

        return marked(**GIVEN, Ts=TS)

    with pytest.raises(ValueError, match=r"the input does not reach \w+: give fx the third argument u"):
        made("scale")
    ours = getattr(filters, kind)(**GIVEN, Ts=TS)
    y, u = signals()
    every = {name: made(name) for name in ("last", "other")}
    if kind == "ukf":
        every["named"] = made("named")
    else:
        with pytest.raises(ValueError, match="gives the input to the third argument of fx: make u the third"):
            made("named")
    for k in range(4):
        expected = ours.update(y[k], u[k - 1] if k else None)[0]
        for each in every.values():
            np.testing.assert_array_equal(each.update(y[k], u[k - 1] if k else None)[0], expected)


@pytest.mark.parametrize("method", ["predict", "update"])
@pytest.mark.parametrize("name", ["kf", "ukf"])
def test_a_held_step_keeps_the_time_of_the_filter(method, name):
    """Oracle: the Kalman filter without the measurement of the failed samples.  Naive form: one sample behind.

    A prediction fails in two samples in a row; it is made together with the next one.
    """
    # `predict` is called from k = 1 on.
    calls = (3, 4) if method == "predict" else (4, 5)

    @filterpy_estimator
    def fails(model, Ts, x0, P0):
        made = new(getattr(filters, name), Ts=Ts, x0=x0, P0=P0)
        setattr(made, method, failing(getattr(made, method), calls))
        return made

    y, u = signals()
    found = alone(designed("estimators", fails, on_failure="hold", max_held=1.0), y, u)[0]
    np.testing.assert_allclose(found, without(y, u, (4, 5)), rtol=0, atol=1e-9)


def test_missing_measurements_as_the_page_shows_them():
    """Oracle: the Kalman filter without them.  `update` of filterpy leaves out None, and makes NaN of NaN."""

    class Bridging(KalmanFilter):
        def update(self, z, R=None, H=None):
            super().update(None if np.isnan(z).any() else z, R, H)

    @filterpy_estimator(bridges_missing=True)
    def kf(model, x0, P0):
        return filters.linear(Bridging, model, x0, P0)

    y, u = signals()
    y[[0, 4, 5]] = np.nan
    estimator = designed("estimators", kf)
    assert estimator.bridges_missing
    np.testing.assert_allclose(alone(estimator, y, u)[0], without(y, u, (0, 4, 5)), rtol=0, atol=1e-12)


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
    return factories.estimator("kalman", **given)


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
