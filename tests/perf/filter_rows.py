"""Filters of filterpy and Stone Soup: through their adapters, and alone in a plain loop over runs and samples.

The system has two states, one input and one output.  A unit is a sample of a run: a prediction and a correction.  Both
sides make the filters of all runs, and return the last estimates.
"""

from datetime import datetime, timedelta

import numpy as np

from perf.row import Row
from rmpc_bench.extras import is_installed
from rmpc_bench.models.linear import LinearModel

RUNS, STEPS, TS = 50, 100, 0.5
MODEL = LinearModel([[1.0, 0.1], [-0.2, 0.9]], [[0.0], [0.3]], [[1.0, 0.0]], 0.04 * np.eye(2), [[0.25]])
START = {"x0": np.array([0.5, -0.5]), "P0": np.eye(2)}


def signals():
    """Return measurements and inputs of all runs."""
    rng = np.random.default_rng(3)
    return rng.standard_normal((STEPS + 1, RUNS, 1)), rng.standard_normal((STEPS, RUNS, 1))


def of_filterpy(name, model, x0, P0):
    """Return a filter of filterpy, and what its update needs besides y."""
    from filterpy import kalman

    further = {}
    if name == "UKF":
        points = kalman.MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0)
        A, B, C = model.A, model.B, model.C
        made = kalman.UnscentedKalmanFilter(2, 1, TS, lambda x: C @ x, lambda x, dt, u: A @ x + B @ u, points)
    else:
        made = {"KF": kalman.KalmanFilter, "EKF": kalman.ExtendedKalmanFilter}[name](2, 1)
        made.F, made.B, made.H = model.A, model.B, model.C
        if name == "EKF":
            further = {"HJacobian": lambda x: model.C, "Hx": lambda x: model.C @ x}
    made.x, made.P, made.Q, made.R = x0, P0, model.Q_w, model.R_v
    return made, further


def of_stonesoup(name, model):
    """Return a predictor and an updater of Stone Soup."""
    from stonesoup.models.control.linear import LinearControlModel
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.predictor import kalman as predictors
    from stonesoup.updater import kalman as updaters

    kind = {"KF": "Kalman", "UKF": "UnscentedKalman"}[name]
    moves = LinearGaussianTimeInvariantTransitionModel(transition_matrix=model.A, covariance_matrix=model.Q_w)
    predictor = getattr(predictors, f"{kind}Predictor")(moves, LinearControlModel(model.B))
    return predictor, getattr(updaters, f"{kind}Updater")(LinearGaussian(2, [0], model.R_v))


def through_adapter(library, name):
    """Run the estimator of a marked function on a block of runs, as the simulation does."""
    from rmpc_bench.adapters.filterpy import filterpy_estimator
    from rmpc_bench.adapters.stonesoup import stonesoup_estimator
    from rmpc_bench.components.single_run import design_function

    if library == "filterpy":
        marked = filterpy_estimator(lambda model, x0, P0: of_filterpy(name, model, x0, P0))
    else:
        marked = stonesoup_estimator(lambda model: of_stonesoup(name, model))
    estimator = design_function("estimators", marked)(MODEL, Ts=TS, n_steps=STEPS, **START)
    y, u = signals()

    def work():
        state = estimator.init(RUNS)
        for k in range(STEPS):
            state, _ = estimator.correct(k, state, y[k])
            state = estimator.predict(k, state, u[k])
        return estimator.correct(STEPS, state, y[STEPS])[1].x_hat

    return work, RUNS * STEPS


def filterpy_alone(name):
    """Run filterpy without the bench."""
    y, u = signals()

    def work():
        last = []
        for i in range(RUNS):
            made, further = of_filterpy(name, MODEL, START["x0"], START["P0"])
            if name == "UKF":
                made.sigmas_f = made.points_fn.sigma_points(made.x, made.P)
            made.update(y[0, i], **further)
            for k in range(STEPS):
                made.predict(u=u[k, i])
                made.update(y[k + 1, i], **further)
            last.append(made.x)
        return last

    return work, RUNS * STEPS


def stonesoup_alone(name):
    """Run Stone Soup without the bench."""
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState, State

    y, u = signals()
    epoch = datetime(2000, 1, 1)

    def work():
        last = []
        for i in range(RUNS):
            predictor, updater = of_stonesoup(name, MODEL)
            state = GaussianState(START["x0"], START["P0"], timestamp=epoch)
            for k in range(STEPS + 1):
                now = epoch + timedelta(seconds=k * TS)
                if k > 0:
                    state = predictor.predict(state, timestamp=now, control_input=State(u[k - 1, i], timestamp=now))
                state = updater.update(SingleHypothesis(state, Detection(y[k, i], timestamp=now)))
            last.append(np.ravel(state.mean))
        return last

    return work, RUNS * STEPS


def row(library, name, alone):
    """Return the row of a filter."""
    return Row(f"{library} {name}", "run-step", lambda: through_adapter(library, name), lambda: alone(name), "library")


ROWS = [
    *(row("filterpy", name, filterpy_alone) for name in ("KF", "EKF", "UKF") if is_installed("filterpy")),
    *(row("stonesoup", name, stonesoup_alone) for name in ("KF", "UKF") if is_installed("stonesoup")),
]
