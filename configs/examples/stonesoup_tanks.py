"""Filters of Stone Soup for stonesoup.yaml: a Kalman and an unscented filter of two tanks in series.

Each function returns a predictor and an updater, and `stonesoup_estimator` makes an estimator of them.  States of Stone
Soup are columns: (n, 1) for one state, (n, m) for m sigma points.
"""

from stonesoup.base import Property
from stonesoup.models.base import GaussianModel
from stonesoup.models.control.linear import LinearControlModel
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.base import TransitionModel
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor, UnscentedKalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.updater.kalman import KalmanUpdater, UnscentedKalmanUpdater

from rmpc_bench.adapters.stonesoup import stonesoup_estimator
from rmpc_bench.types import Positive


class Outputs(LinearGaussian):
    """Measurement y = C x + v; C of Stone Soup's own class can only choose states."""

    C: object = Property(doc="Matrix of the output")

    def matrix(self, **more):
        """Return C."""
        return self.C


@stonesoup_estimator(deviation=True)
def kf(model):
    """Kalman filter around the operating point: these models have no constant parts, so that it works in deviations."""
    transition = LinearGaussianTimeInvariantTransitionModel(transition_matrix=model.A, covariance_matrix=model.Q_w)
    predictor = KalmanPredictor(transition, LinearControlModel(model.B))
    outputs = Outputs(C=model.C, noise_covar=model.R_v, ndim_state=model.nx, mapping=range(model.ny))
    return predictor, KalmanUpdater(outputs)


class Moves(GaussianModel, TransitionModel):
    """Transition x(k+1) = f(x, u) + w of the design model; the unscented predictor hands over the input."""

    model: object = Property(doc="Design model")

    @property
    def ndim_state(self):
        """Number of states."""
        return self.model.nx

    def covar(self, **more):
        """Return the covariance of w."""
        return self.model.Q_w

    def function(self, state, noise=False, control_input=None, **more):
        """Move every column of the state."""
        return StateVectors(self.model.f(state.state_vector.T, control_input.state_vector[:, 0]).T)


class Measures(GaussianModel, MeasurementModel):
    """Measurement y = h(x) + v of the design model."""

    model: object = Property(doc="Design model")

    @property
    def ndim_meas(self):
        """Number of outputs."""
        return self.model.ny

    def covar(self, **more):
        """Return the covariance of v."""
        return self.model.R_v

    def function(self, state, noise=False, **more):
        """Measure every column of the state."""
        return StateVectors(self.model.h(state.state_vector.T).T)


@stonesoup_estimator
def ukf(model, alpha: Positive = 1.0):
    """Unscented Kalman filter.

    Parameters
    ----------
    alpha : spread of the sigma points
    """
    spread = {"alpha": alpha, "beta": 2.0, "kappa": 3.0 - model.nx}
    predictor = UnscentedKalmanPredictor(Moves(model=model), **spread)
    measurement = Measures(model=model, ndim_state=model.nx, mapping=range(model.nx))
    return predictor, UnscentedKalmanUpdater(measurement, **spread)
