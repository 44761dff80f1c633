"""An estimator in a closed loop, and alone on recorded signals."""

from functools import wraps
from itertools import count

import numpy as np
from components.one_run import MODEL, START, N, designed, experiment, simulated

from rmpc_bench.components.single_run import single_run


@single_run
class Law:
    """A state feedback, so that an error of the estimate acts on the plant."""

    def control(self, x_hat, k):
        """Feed back, and excite the plant."""
        return [0.5 * np.sin(k) - x_hat[0] - 0.4 * x_hat[1]]


def loop(estimator, block=None):
    """Return the trajectories of a closed loop."""
    status, _, traces, journals = simulated(experiment(estimator, designed("controllers", Law)), block)
    assert not status.any(), [each.message for each in journals[0].failures.values()]
    return traces


def alone(estimator, y, u):
    """Return x_hat and P of one run on measurements y(0), .. and inputs u(0), .."""
    state, estimates = estimator.init(1), []
    for k in range(len(y)):
        state, estimate = estimator.correct(k, state, y[k, None])
        assert not estimate.status.any()
        estimates.append((estimate.x_hat[0], np.broadcast_to(estimate.P, (1, 2, 2))[0]))
        state = estimator.predict(k, state, u[k, None])
    return [np.array(each) for each in zip(*estimates, strict=True)]


def signals(n=N + 1, ny=1, nu=1):
    """Return measurements and inputs that have little to do with each other."""
    rng = np.random.default_rng(8)
    return rng.standard_normal((n, ny)), rng.standard_normal((n, nu))


def without(y, u, left_out):
    """Return x_hat of the Kalman filter that leaves out the measurements of some samples, as in a textbook."""
    x, P, found = START["x0"], START["P0"], []
    for k in range(len(y)):
        if k:
            x, P = MODEL.A @ x + MODEL.B @ u[k - 1], MODEL.A @ P @ MODEL.A.T + MODEL.Q_w
        if k not in left_out:
            L = P @ MODEL.C.T / (MODEL.C @ P @ MODEL.C.T + MODEL.R_v)
            x, P = x + L @ (y[k] - MODEL.C @ x), P - L @ MODEL.C @ P
        found.append(x)
    return np.array(found)


def failing(call, at):
    """Return a function with the arguments of another one, whose calls of these numbers, from 0 on, fail."""
    calls = count()

    @wraps(call)
    def fails(*arguments, **keys):
        if next(calls) in at:
            raise FloatingPointError("no number")
        return call(*arguments, **keys)

    return fails
