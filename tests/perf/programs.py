"""The closed loops of Fig. 7 as plain programs: run by run and sample by sample, with libraries that others use.

Both programs compute the mean square error of S-MPC, with the plants of the experiment: filterpy's Kalman filter, the
servomechanism by SciPy's `solve_ivp` from one event of friction to the next, and a control law.  They differ in the
law: one has the gains, the other solves the control problem with do-mpc at every sample.
"""

import math
import warnings

import numpy as np

FIG7 = "configs/zenere2018/fig7.yaml"
STEPS, TS, TARGET = 200, 0.1, np.pi / 2
SPEEDS, BODIES = (1, 3), ("l", "m")
TOLERANCES = {"rtol": 1e-6, "atol": 1e-8, "max_step": 0.02}
MARGIN = 1e-11
"""By which the torque on a body at rest is larger than friction when it starts to move, relative to friction."""
HP, HU, SCALE = 10, 3, 1e4


def experiment(path=FIG7):
    """Load the first point of an experiment."""
    from rmpc_bench.config.load import load_config

    return load_config(path).experiment


def plants(n_runs):
    """Return the parameters of the servomechanism in each of the first runs."""
    from plants.servo_loops import ReferencePlant

    return experiment().scenario.draw(ReferencePlant(), range(n_runs), 1).delta


def torques(p, x):
    """Return the torques on load and motor without friction."""
    torsion = p["k_theta"] / p["rho"] * (x[2] / p["rho"] - x[0])
    return p["rho"] * torsion - p["beta_l"] * x[1], p["K_t"] * x[4] - torsion - p["beta_m"] * x[3]


def held_by(p, body):
    """Return the largest friction torque of a body at rest."""
    return p[f"alpha_{BODIES[body]}0"] + p[f"alpha_{BODIES[body]}1"]


def direction(p, x, body):
    """Return 1 or -1 for a body that slips, and 0 for a body that rests."""
    torque = torques(p, x)[body]
    if x[SPEEDS[body]] != 0.0:
        return int(math.copysign(1, x[SPEEDS[body]]))
    return 0 if abs(torque) <= held_by(p, body) * (1 + MARGIN) else int(math.copysign(1, torque))


def slopes(p, u, modes):
    """Return the right-hand side between two events."""
    inertias = p["J_l"], p["J_m"]
    friction = [[p[f"alpha_{body}{i}"] for i in range(3)] for body in BODIES]

    def rhs(t, x):
        x = x.tolist()
        found = [x[1], 0.0, x[3], 0.0, (u - p["R"] * x[4] - p["K_t"] * x[3]) / p["L"]]
        for body, torque in enumerate(torques(p, x)):
            sign, (a0, a1, a2) = modes[body], friction[body]
            if sign:
                lost = sign * (a0 + a1 * math.exp(-a2 * sign * x[SPEEDS[body]]))
                found[SPEEDS[body]] = (torque - lost) / inertias[body]
        return found

    return rhs


def event(p, body, sign):
    """Return a function that becomes negative where a body stops, or where it starts to move."""

    def gap(t, x):
        if sign:
            return sign * x[SPEEDS[body]]
        return held_by(p, body) * (1 + MARGIN) - abs(torques(p, x)[body])

    gap.terminal, gap.direction = True, -1
    return gap


def moved(p, x, u, duration=TS):
    """Return the state after a sample with a constant voltage."""
    from scipy.integrate import solve_ivp

    modes, t = [direction(p, x, body) for body in (0, 1)], 0.0
    while t < duration:
        events = [event(p, body, modes[body]) for body in (0, 1)]
        part = solve_ivp(slopes(p, u, modes), (t, duration), x, method="DOP853", events=events, **TOLERANCES)
        t, x = part.t[-1], part.y[:, -1].copy()
        for body in (0, 1):
            if len(part.t_events[body]):
                x[SPEEDS[body]] = 0.0
                modes[body] = direction(p, x, body) if modes[body] else int(np.sign(torques(p, x)[body]))
    return x


def closed_loop(p, model, law):
    """Return the mean square error of a run.

    Parameters
    ----------
    p : parameters of the plant
    model : the design model of the filter
    law : state estimate (4), last input (1) -> next input (1)
    """
    from filterpy.kalman import KalmanFilter

    kf = KalmanFilter(dim_x=4, dim_z=1, dim_u=1)
    kf.F, kf.B, kf.H = model.A, model.B, model.C
    kf.Q, kf.R, kf.P = model.Q_w, model.R_v, model.Q_w
    x, u, total = np.zeros(5), np.zeros(1), 0.0
    for _ in range(STEPS):
        kf.update(x[:1])
        total += (x[0] - TARGET) ** 2
        u = np.clip(law(kf.x[:, 0], u), -220.0, 220.0)
        kf.predict(u[:, None])
        x = moved(p, x, float(u[0]))
    return total / STEPS


def design_model():
    """Return the design model of the servomechanism, for the filter and the predictions."""
    from rmpc_bench.models.servo import ServoNoise, design

    return design(TS, noise=ServoNoise(process=1.0, measurement=1.0))


def gain_law():
    """Return the control law with the gains of the experiment."""
    law = experiment().method("S-MPC").controller
    r = np.full(law.preview - 1, TARGET)
    return lambda x_hat, u: u - law.K_u @ u + law.K_r @ r - law.K_x @ x_hat


def solved_law(model, limit=None):
    """Return the control law that do-mpc finds with the cost and the horizons of the experiment.

    With `limit`, the inputs of the horizon are limited; otherwise the loop clips the first one.

    The input of do-mpc's model is the increment; `moves` is one for the first three of a horizon, and zero after them.
    """
    warnings.filterwarnings("ignore")
    import do_mpc

    plant = do_mpc.model.Model("discrete")
    x, last = plant.set_variable("_x", "x", (4, 1)), plant.set_variable("_x", "last", (1, 1))
    du, moves = plant.set_variable("_u", "du", (1, 1)), plant.set_variable("_tvp", "moves", (1, 1))
    u = last + moves * du
    plant.set_rhs("x", model.A @ x + model.B @ u)
    plant.set_rhs("last", u)
    plant.setup()
    mpc = do_mpc.controller.MPC(plant)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.store_full_solution = HP, TS, False
    mpc.settings.supress_ipopt_output()
    # A factor of the whole cost, which IPOPT's tolerances need.
    error = SCALE * 0.1 * ((model.C @ x - TARGET) / (2 * np.pi)) ** 2
    mpc.set_objective(mterm=error, lterm=error + SCALE * 0.1 * (du / 440.0) ** 2)
    mpc.set_rterm(du=0.0)
    horizon = mpc.get_tvp_template()
    for i in range(HP + 1):
        horizon["_tvp", i, "moves"] = float(i < HU)
    mpc.set_tvp_fun(lambda t: horizon)
    if limit is not None:
        mpc.bounds["lower", "_x", "last"], mpc.bounds["upper", "_x", "last"] = -limit, limit
    mpc.setup()
    mpc.x0 = np.zeros((5, 1))
    mpc.set_initial_guess()
    return lambda x_hat, u: u + mpc.make_step(np.concatenate([x_hat, u])[:, None])[0]


def program(law, n_runs):
    """Return a function that computes the errors of the first runs.

    Parameters
    ----------
    law : "gains" or "do-mpc"
    n_runs : number of runs
    """
    model, parameters = design_model(), plants(n_runs)
    chosen = gain_law() if law == "gains" else solved_law(model)
    return lambda: [closed_loop(p, model, chosen) for p in parameters]
