"""Predictors and updaters of Stone Soup for the linear system of one_run.py."""

import numpy as np
import pytest

pytest.importorskip("stonesoup")

from stonesoup.base import Property
from stonesoup.models.base import GaussianModel
from stonesoup.models.control.linear import LinearControlModel
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.base import TransitionModel
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import ExtendedKalmanPredictor, KalmanPredictor, UnscentedKalmanPredictor
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVectors
from stonesoup.types.state import ParticleState
from stonesoup.updater.kalman import ExtendedKalmanUpdater, KalmanUpdater, UnscentedKalmanUpdater
from stonesoup.updater.particle import ParticleUpdater

from rmpc_bench.adapters.stonesoup import stonesoup_estimator


class Moves(GaussianModel, TransitionModel):
    """Transition A x + B u, which takes the input itself."""

    model: object = Property(doc="Design model")
    ndim_state = 2

    def covar(self, **ignored):
        """Return Q_w."""
        return self.model.Q_w

    def function(self, state, noise=False, control_input=None, **ignored):
        """Move all points."""
        return self.model.A @ state.state_vector + self.model.B @ control_input.state_vector


def transition(model):
    """Return A, Q_w in the form of Stone Soup."""
    return LinearGaussianTimeInvariantTransitionModel(transition_matrix=model.A, covariance_matrix=model.Q_w)


def measurement(model):
    """Return C, which takes the first state, and R_v."""
    return LinearGaussian(ndim_state=2, mapping=[0], noise_covar=model.R_v)


@stonesoup_estimator
def kf(model):
    """Kalman filter."""
    return KalmanPredictor(transition(model), LinearControlModel(model.B)), KalmanUpdater(measurement(model))


@stonesoup_estimator
def ekf(model):
    """Extended filter of the linear model."""
    predictor = ExtendedKalmanPredictor(transition(model), LinearControlModel(model.B))
    return predictor, ExtendedKalmanUpdater(measurement(model))


@stonesoup_estimator
def ukf(model):
    """Unscented filter with a control model."""
    predictor = UnscentedKalmanPredictor(transition(model), LinearControlModel(model.B))
    return predictor, UnscentedKalmanUpdater(measurement(model))


@stonesoup_estimator
def ukf_of_input(model):
    """Unscented filter whose transition model takes the input."""
    return UnscentedKalmanPredictor(Moves(model)), UnscentedKalmanUpdater(measurement(model))


@stonesoup_estimator
def particles(model, x0, P0, rng, n: int = 50):
    """Particle filter with its own prior."""
    points = StateVectors(rng.multivariate_normal(x0, P0, n).T)
    prior = ParticleState(points, weight=np.full(n, 1 / n))
    predictor = ParticlePredictor(transition(model), control_model=LinearControlModel(model.B))
    return predictor, ParticleUpdater(measurement(model), SystematicResampler()), prior
