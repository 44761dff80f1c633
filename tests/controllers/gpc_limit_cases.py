"""Models, keys and single steps for the tests of gpc with limits."""

import numpy as np
from conftest import random_model
from controllers.gpc_twin import Varying, estimate_of

from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.state_dependent import Pair, StateDependentModel

NP = 5
KEYS = {"Np": NP, "Q_yw": [2.0, 1.0], "Q_u": [0.3, 0.5]}
HARD = Limits(u=[(-0.6, 0.8), (-1.0, 0.5)], du=(-0.5, 0.6), enforce="qp")
KINDS = ["constant", "varying", "state"]
SOFT = {"x.1": SoftLimit(limits=(-0.3, 0.4), scale=0.5, linear=0.05, quadratic=0.2, steps=4)}


class Bent(StateDependentModel):
    """Two inputs and two outputs; the matrices depend on the first state."""

    nx, nu, ny, largest = 3, 2, 2, 1e6

    def __init__(self, m):
        self.m, self.C, self.Q_w, self.R_v = m, m.C, m.Q_w, m.R_v

    def at_state(self, x):
        """Scale both matrices."""
        factor = 1.0 + 0.2 * np.tanh(x[:, 0])[:, None, None]
        return Pair(factor * self.m.A, factor * self.m.B)


def models(rng):
    """A constant model, one that varies with k and one that depends on the state; all stable, with constant parts."""
    made = []
    for _ in range(3):
        m = random_model(rng, 3, 2, 2)
        A = 0.8 * m.A / np.abs(np.linalg.eigvals(m.A)).max()
        made.append(
            LinearModel(A, m.B, m.C, m.Q_w, m.R_v, f0=0.02 * rng.standard_normal(3), d0=0.1 * rng.standard_normal(2))
        )
    return {"constant": made[0], "varying": Varying(made), "state": Bent(made[1])}


def step(controller, x_hat, r, before, k=0):
    """Command at k after the estimate x_hat, also that of the sample before, and the input `before`."""
    state = controller.init(len(x_hat))._replace(x_previous=x_hat, u_previous=before)
    return controller.control(k, state, np.zeros((len(x_hat), r.shape[1])), estimate_of(x_hat), r)[1]
