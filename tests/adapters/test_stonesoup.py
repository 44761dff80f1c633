"""Filters of Stone Soup against the Kalman filter of the bench, and what goes wrong without the adapter."""

from datetime import timedelta

import numpy as np
import pytest

pytest.importorskip("stonesoup")

import adapters.stonesoup_filters as filters
from adapters.loops import alone, failing, loop, signals, without
from components.one_run import MODEL, START, TS, designed, kalman
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState, State
from stonesoup.updater.kalman import KalmanUpdater

from rmpc_bench.adapters.stonesoup import EPOCH, stonesoup_estimator
from rmpc_bench.components.single_run import design_function
from rmpc_bench.config_file import factories
from rmpc_bench.conformance.outcome import global_seed
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.types import OperatingPoint

EQUAL = {"kf": 1e-12, "ekf": 1e-12, "ukf": 1e-10, "ukf_of_input": 1e-10}
"""Filters that are the Kalman filter on a linear model, with the largest difference that rounding may leave."""
GIVEN = {"model": MODEL, "Ts": TS, **START, "rng": np.random.default_rng(1)}


@pytest.mark.parametrize("name", EQUAL)
def test_it_is_the_kalman_filter(name):
    """In a closed loop it gives the same estimates, inputs and states; alone also the same covariance."""
    made = designed("estimators", getattr(filters, name))
    ours, theirs = loop(kalman()), loop(made)
    for signal in ("x_hat", "u", "x"):
        np.testing.assert_allclose(theirs[signal], ours[signal], rtol=0, atol=EQUAL[name])
    for got, expected in zip(alone(made, *signals()), alone(kalman(), *signals()), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=EQUAL[name])


class Times(KalmanPredictor):
    """A predictor that keeps the times it is asked for; a test sets the list."""

    def predict(self, prior, timestamp=None, **more):
        """Keep the time."""
        SEEN.append((timestamp - EPOCH).total_seconds())
        return super().predict(prior, timestamp=timestamp, **more)


SEEN: list[float] = []


def test_times_do_not_drift():
    """Ts = 1/30 s is no whole number of microseconds: a sum of time steps is 0.3 us per sample too short."""
    Ts, n = 0.1 / 3, 3000

    @stonesoup_estimator
    def timed(model):
        predictor = Times(filters.transition(model), filters.LinearControlModel(model.B))
        return predictor, KalmanUpdater(filters.measurement(model))

    made, naive = timed(**{**GIVEN, "Ts": Ts}), EPOCH
    SEEN.clear()
    for k in range(n + 1):
        made.update(np.zeros(1), None if k == 0 else np.zeros(1), k)
        naive += timedelta(seconds=Ts) if k > 0 else timedelta(0)
    assert abs((naive - EPOCH).total_seconds() - n * Ts) > 5e-4
    assert np.abs(SEEN - Ts * np.arange(1, n + 1)).max() < 1e-6


def test_a_sampling_time_below_the_resolution():
    """Stone Soup's times have whole microseconds."""
    assert timedelta(seconds=2e-7) == timedelta(0)
    with pytest.raises(ValueError, match="too long for Ts = 2e-07 s"):
        filters.kf(**{**GIVEN, "Ts": 2e-7})


def test_the_past_of_a_run_is_not_kept():
    """Every estimate of Stone Soup holds its prediction, and that one the estimate before."""

    def length(state):
        n = 0
        while state is not None:
            hypothesis = getattr(state, "hypothesis", None)
            state, n = (getattr(hypothesis.prediction, "prior", None), n + 1) if hypothesis else (None, n + 1)
        return n

    predictor = KalmanPredictor(filters.transition(MODEL), filters.LinearControlModel(MODEL.B))
    updater, naive = KalmanUpdater(filters.measurement(MODEL)), GaussianState(START["x0"], START["P0"], timestamp=EPOCH)
    ours = filters.kf(**GIVEN)
    for k in range(30):
        now = EPOCH + timedelta(seconds=k * TS)
        if k > 0:
            naive = predictor.predict(naive, timestamp=now, control_input=State(np.zeros(1)))
        naive = updater.update(SingleHypothesis(naive, Detection(np.zeros(1), timestamp=now)))
        x_hat, P = ours.update(np.zeros(1), None if k == 0 else np.zeros(1), k)
        np.testing.assert_array_equal(x_hat, np.ravel(naive.mean))
        np.testing.assert_array_equal(P, naive.covar)
    assert length(naive) == 30
    assert length(ours._last) == 1


def test_an_input_that_the_predictor_ignores():
    """Without a control model it makes one of zeros for two inputs; B of the transition model is not used."""
    B = np.eye(2)
    model = LinearModel(MODEL.A, B, MODEL.C, MODEL.Q_w, MODEL.R_v)
    transition = LinearGaussianTimeInvariantTransitionModel(
        transition_matrix=model.A, control_matrix=B, covariance_matrix=model.Q_w
    )
    prior = GaussianState(START["x0"], START["P0"], timestamp=EPOCH)
    moved = KalmanPredictor(transition).predict(prior, timestamp=EPOCH, control_input=State(np.ones(2)))
    np.testing.assert_array_equal(np.ravel(moved.mean), model.A @ START["x0"])

    @stonesoup_estimator
    def ignores(model):
        return KalmanPredictor(transition), KalmanUpdater(filters.measurement(model))

    @stonesoup_estimator
    def of_particles(model):
        return ParticlePredictor(transition), KalmanUpdater(filters.measurement(model))

    for each in (ignores, of_particles):
        with pytest.raises(ValueError, match="ignores the input"):
            each(**{**GIVEN, "model": model})


def test_a_model_around_an_operating_point():
    """The linear models of Stone Soup have no constant parts."""
    point = OperatingPoint(x=np.array([2.0, 1.0]), u=np.array([3.0]), y=np.array([2.0]))
    model = LinearisedModel(MODEL.A, MODEL.B, MODEL.C, MODEL.Q_w, MODEL.R_v, point=point)
    with pytest.raises(ValueError, match=r"ignore f0 and d0 .*deviation=True"):
        filters.kf(**{**GIVEN, "model": model})

    @stonesoup_estimator(deviation=True)
    def around(model):
        return KalmanPredictor(filters.transition(model), filters.LinearControlModel(model.B)), KalmanUpdater(
            filters.measurement(model)
        )

    y, u = signals()
    given = {"model": model, "n_steps": len(y) - 1, "x0": START["x0"] + point.x, "P0": START["P0"]}
    ours = alone(design_function("estimators", around)(**given, Ts=TS), y + point.y, u + point.u)
    expected = alone(factories.estimator("kalman", **given), y + point.y, u + point.u)
    np.testing.assert_allclose(ours[0], expected[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["predict", "update"])
def test_a_held_step_keeps_the_time_of_the_filter(method):
    """Oracle: the Kalman filter without the measurement of the failed samples.  Naive form: one sample behind."""
    calls = (3, 4) if method == "predict" else (4, 5)

    @stonesoup_estimator
    def fails(model):
        pair = (
            KalmanPredictor(filters.transition(model), filters.LinearControlModel(model.B)),
            KalmanUpdater(filters.measurement(model)),
        )
        part = pair[method == "update"]
        object.__setattr__(part, method, failing(getattr(part, method), calls))
        return pair

    y, u = signals()
    found = alone(designed("estimators", fails, on_failure="hold", max_held=1.0), y, u)[0]
    np.testing.assert_allclose(found, without(y, u, (4, 5)), rtol=0, atol=1e-9)


def test_missing_measurements_as_the_page_shows_them():
    """Oracle: the Kalman filter without them."""

    class Bridging(KalmanUpdater):
        def update(self, hypothesis, **keys):
            if np.isnan(np.asarray(hypothesis.measurement.state_vector, dtype=float)).any():
                return hypothesis.prediction
            return super().update(hypothesis, **keys)

    @stonesoup_estimator(bridges_missing=True)
    def kf(model):
        predictor = KalmanPredictor(filters.transition(model), filters.LinearControlModel(model.B))
        return predictor, Bridging(filters.measurement(model))

    y, u = signals()
    y[[0, 4, 5]] = np.nan
    np.testing.assert_allclose(alone(designed("estimators", kf), y, u)[0], without(y, u, (0, 4, 5)), rtol=0, atol=1e-12)


def test_particles_draw_from_the_generator_of_their_run():
    """Stone Soup takes NumPy's global generator; a cloud of 500 has an error of a few hundredths."""
    made = designed("estimators", filters.particles, n=500)
    with global_seed(1):
        ours = loop(made)["x_hat"]
    with global_seed(2):
        np.testing.assert_array_equal(loop(made, block=2)["x_hat"], ours)
    naive = filters.transition(MODEL)
    with global_seed(1):
        first = naive.rvs()
    with global_seed(2):
        assert not np.array_equal(naive.rvs(), first)
    assert 1e-3 < np.abs(ours - loop(kalman())["x_hat"]).max() < 0.3
