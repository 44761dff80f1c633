"""An estimator in a closed loop, and alone on recorded signals."""

import numpy as np
from components.one_run import N, designed, experiment, simulated

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
