"""The unscented filter of the servomechanism with friction: a block of runs, and filterpy run by run.

Both sides use the same compiled flow, ours for all points of the block at once, filterpy point by point.  A unit is a
prediction and a correction of a run.  The target is 11 points of 1 us, and 5 us.
"""

import numpy as np

from perf.row import Row
from rmpc_bench.extras import is_installed

RUNS, FEW, STEPS, TS = 50, 4, 200, 0.1


def model():
    """Return the design model with friction."""
    from rmpc_bench.models.servo import ServoNoise, design_nonlinear

    made = design_nonlinear(TS, noise=ServoNoise(process=1.0, measurement=1.0))
    made.warm_up()
    return made


def signals(flow):
    """Return voltages and measured angles of loops that turn the load by pi / 2 and then rest."""
    rng = np.random.default_rng(3)
    x, y, u = np.zeros((RUNS, 5)), np.empty((STEPS, RUNS, 1)), np.empty((STEPS, RUNS, 1))
    gain = rng.uniform(100.0, 200.0, (RUNS, 1))
    for k in range(STEPS):
        y[k] = x[:, :1]
        # Proportional to the error of the motor angle, with its velocity as damping.
        u[k] = np.clip(gain * (np.pi / 2 - x[:, 2:3] / 20.0) - 5.0 * x[:, 3:4], -220.0, 220.0)
        x = flow.advance(k, x, u[k])
    return y, u


def ours():
    """Run the filter on a block of runs, as the simulation does."""
    from rmpc_bench.estimators.unscented_kalman import design

    made = model()
    estimator = design(made, STEPS, x0=np.zeros(4), P0=made.Q_w)
    y, u = signals(made.flow)

    def work():
        state = estimator.init(RUNS)
        for k in range(STEPS - 1):
            state, _ = estimator.correct(k, state, y[k])
            state = estimator.predict(k, state, u[k])
        return estimator.correct(STEPS - 1, state, y[-1])[1].x_hat[:FEW]

    return work, RUNS * STEPS


def filterpy_alone():
    """Run filterpy on the first runs."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    made = model()
    flow = made.flow
    y, u = signals(flow)
    x0, P0 = flow.start(np.zeros(4), made.Q_w)

    def work():
        last = []
        for i in range(FEW):
            points = MerweScaledSigmaPoints(5, 1.0, 0.0, 0.0)
            ukf = UnscentedKalmanFilter(
                5, 1, TS, lambda x: x[:1], lambda x, dt, u: flow.advance(0, x[None], u[None])[0], points
            )
            ukf.x, ukf.P, ukf.Q, ukf.R = x0.copy(), P0.copy(), flow.Q_w, flow.R_v
            for k in range(STEPS):
                # The points are placed anew before a correction.
                ukf.sigmas_f = points.sigma_points(ukf.x, ukf.P)
                ukf.update(y[k, i])
                if k < STEPS - 1:
                    ukf.predict(u=u[k, i])
            last.append(ukf.x[:4])
        return np.array(last)

    return work, FEW * STEPS


ROWS = [
    Row("unscented-kalman of the servomechanism", "run-step", ours, filterpy_alone, "filterpy, run by run"),
] * is_installed("filterpy")
