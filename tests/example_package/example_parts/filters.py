"""An estimator written for one run."""

import numpy as np

from rmpc_bench import single_run
from rmpc_bench.types import Positive


@single_run
class Exponential:
    """Observer that corrects the predicted output by a constant share of the innovation.

    Parameters
    ----------
    share : share of the innovation that corrects the output
    """

    def __init__(self, model, share: Positive = 0.5):
        self.model = model
        self.gain = share * np.linalg.pinv(model.C)

    def start(self, x0):
        """Begin at the prediction of x(0)."""
        self.x_hat = x0

    def update(self, y, u_previous):
        """Return x_hat(k) from y(k) and u(k-1)."""
        x_pred = self.x_hat if u_previous is None else self.model.A @ self.x_hat + self.model.B @ u_previous
        self.x_hat = x_pred + self.gain @ (y - self.model.C @ x_pred)
        return self.x_hat
