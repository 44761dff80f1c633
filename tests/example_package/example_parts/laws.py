"""A control law written for one run."""

from rmpc_bench import single_run
from rmpc_bench.types import Positive


@single_run
class SaturatedGain:
    """Position and speed feedback to a reference position, with a limit of the input.

    Parameters
    ----------
    K_p, K_d : gains of position and speed
    largest : largest magnitude of the input
    """

    def __init__(self, K_p: Positive = 1.0, K_d: Positive = 1.5, largest: Positive = 5.0):
        self.K_p, self.K_d, self.largest = K_p, K_d, largest

    def control(self, x_hat, r):
        """Return u(k)."""
        u = self.K_p * (r[0] - x_hat[0]) - self.K_d * x_hat[1]
        return [min(max(u, -self.largest), self.largest)]
