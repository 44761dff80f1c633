"""Controllers of do-mpc for tests, each as a user writes it."""

import numpy as np

from rmpc_bench.adapters.do_mpc import do_mpc_controller, do_mpc_estimator, do_mpc_model


def tracking(model, Hp, Q, R, y_scale=1.0, u_scale=1.0):
    """Return an MPC with the cost of the built-in one, not set up."""
    import casadi
    import do_mpc

    made = do_mpc_model(model)
    mpc = do_mpc.controller.MPC(made)
    mpc.settings.n_horizon = Hp
    cost = Q * casadi.sumsqr((made.aux["y"] - made.tvp["r"]) / y_scale)
    mpc.set_objective(lterm=cost, mterm=cost)
    mpc.set_rterm(u=R / u_scale**2)
    return mpc


@do_mpc_controller
def servo_mpc(model, Hp: int = 10):
    """Weights and scales of zenere2018/fig7.yaml.

    Parameters
    ----------
    Hp : horizon of prediction and of control [samples]
    """
    return tracking(model, Hp, 0.1, 0.1, 2 * np.pi, 440.0)


@do_mpc_controller
def small_mpc(model, Hp: int = 6, R: float = 0.5, limit: float = 1e9):
    """An MPC of the model of one_run.py.

    Parameters
    ----------
    Hp, R : horizon and weight of the moves
    limit : largest magnitude of the input
    """
    mpc = tracking(model, Hp, 1.0, R)
    if limit < 1e9:
        mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -limit, limit
    return mpc


@do_mpc_estimator
def small_mhe(model, P0, Ne: int = 5):
    """An MHE with the weights of the Kalman filter.

    Parameters
    ----------
    Ne : length of the window [samples]
    """
    import do_mpc

    mhe = do_mpc.estimator.MHE(do_mpc_model(model))
    mhe.settings.n_horizon = Ne
    P_x, P_w, P_v = (np.linalg.inv(each) for each in (P0, model.Q_w, model.R_v))
    mhe.set_default_objective(P_x, P_v, P_w=P_w)
    return mhe
