"""Components of do-mpc.yaml: a controller and an estimator of do-mpc for the two tanks of tanks.py.

Each function returns a new object of do-mpc, which the adapter sets up.  `do_mpc_model` makes the do-mpc model from the
design model of the configuration: state x, input u, reference r, output aux["y"].  do-mpc is imported where it is used,
so that commands that only read the configuration do not import it.
"""

import numpy as np

from rmpc_bench.adapters.do_mpc import do_mpc_controller, do_mpc_estimator, do_mpc_model
from rmpc_bench.types import Horizon, Positive


@do_mpc_controller
def mpc(model, limits, Hp: Horizon = 12, Q: Positive = 1.0, R: Positive = 1e-5, lowest: float = 1e-3):
    """Nonlinear MPC with limits of the input and a lowest level.

    Minimises sum Q (y - r)^2 over y(k), .., y(k+Hp), plus sum R (u(j) - u(j-1))^2.

    Parameters
    ----------
    Hp : horizon of prediction and of control [samples]
    Q : weight of the error of the level [1/m^2]
    R : weight of the moves of the pump [(s/ml)^2]
    lowest : lower bound of both levels [m]
    """
    import casadi
    import do_mpc

    tanks = do_mpc_model(model)
    law = do_mpc.controller.MPC(tanks)
    law.settings.n_horizon = Hp
    error = Q * casadi.sumsqr(tanks.aux["y"] - tanks.tvp["r"])
    law.set_objective(lterm=error, mterm=error)
    law.set_rterm(u=R)
    law.bounds["lower", "_u", "u"], law.bounds["upper", "_u", "u"] = limits.u
    law.bounds["lower", "_x", "x"] = lowest
    return law


@do_mpc_estimator
def mhe(model, P0, Ne: Horizon = 8, lowest: float = 1e-3):
    """Moving-horizon estimator with the noise covariances of the design model.

    Minimises |x(k-Ne) - x_bar|^2 weighted by the inverse of P0, plus the squares of the noises in the window weighted
    by the inverses of Q_w and R_v.

    Parameters
    ----------
    Ne : length of the window [samples]
    lowest : lower bound of both levels [m]
    """
    import do_mpc

    estimator = do_mpc.estimator.MHE(do_mpc_model(model))
    estimator.settings.n_horizon = Ne
    P_x, P_w, P_v = (np.linalg.inv(each) for each in (P0, model.Q_w, model.R_v))
    estimator.set_default_objective(P_x, P_v, P_w=P_w)
    estimator.bounds["lower", "_x", "x"] = lowest
    return estimator
