"""Designs and solvers: gain schedules, minimax control, linear programs, plants of differential equations."""

import numpy as np

from perf.row import Row

BLOCK = 50


def gains(kind):
    from rmpc_bench.estimators import kalman, robust_kalman
    from rmpc_bench.models.servo import ServoNoise, design

    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))
    start = {"x0": np.zeros(4), "P0": model.Q_w}
    if kind == "kalman":
        return lambda: kalman.design(model, 200, **start), 200
    return lambda: robust_kalman.design(model, 200, **start, c=0.1), 200


def gains_by_filterpy():
    from filterpy.kalman import KalmanFilter

    from rmpc_bench.models.servo import ServoNoise, design

    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))

    def work():
        kf = KalmanFilter(dim_x=4, dim_z=1)
        kf.F, kf.H, kf.Q, kf.R, kf.P = model.A, model.C, model.Q_w, model.R_v, model.Q_w
        for _ in range(200):
            kf.update(np.zeros(1))
            kf.predict()

    return work, 200


def robust_gains_plain():
    """The same gains in NumPy, the root of (11) by SciPy."""
    from scipy.optimize import brentq

    from rmpc_bench.models.servo import ServoNoise, design

    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))

    def work():
        V = model.Q_w
        for _ in range(200):
            L = V @ model.C.T @ np.linalg.inv(model.C @ V @ model.C.T + model.R_v)
            P = model.A @ (V - L @ model.C @ V) @ model.A.T + model.Q_w
            lam = np.linalg.eigvalsh(P)

            def gap(theta, lam=lam):
                return np.sum(np.log1p(-theta * lam) + 1 / (1 - theta * lam) - 1) - 0.1

            theta = brentq(gap, 0.0, (1 - 1e-9) / lam[-1])
            V = np.linalg.inv(np.linalg.inv(P) - theta * np.eye(4))

    return work, 200


def minimax(by):
    from controllers import minimax_oracles as oracles

    from rmpc_bench.controllers.state_feedback import game_of
    from rmpc_bench.numerics.linalg import psd_sqrt
    from rmpc_bench.numerics.lq_game import solve

    stages, M_w = oracles.paper_stages(20, 20), np.broadcast_to([[5.0, 2.0], [2.0, 5.0]], (20, 2, 2))
    M, x = np.array([[28.0, -9.0], [-9.0, 12.0]]), np.array([3.0, -2.0])
    if by == "cvxpy":
        return lambda: oracles.semidefinite(stages, M, M_w, x), 1
    game, root = game_of(stages, psd_sqrt(M_w)), psd_sqrt(M[None])[0]
    return lambda: [solve(game, root, x) for _ in range(20)], 20


def windows(by, points):
    from numerics import lp_twin
    from numerics.test_bounded_window import data, integrators

    from rmpc_bench.numerics.bounded_window import fit_free

    window, C = integrators(np.random.default_rng(0), BLOCK, points)
    if by == "scipy":
        programs = [data(window, C, i, points) for i in range(BLOCK)]
        return lambda: [lp_twin.solve(each) for each in programs], BLOCK
    return lambda: [fit_free(window, C, points) for _ in range(10)], 10 * BLOCK


def penalties(by):
    from controllers.gpc_twin import full_lp2
    from controllers.test_noise_tuning import windows as signals

    from rmpc_bench.controllers.noise_tuning import LpNoise, NoiseTuning

    parts = signals(np.random.default_rng(0), BLOCK)
    if by == "full":
        return lambda: [full_lp2(*(each[i] for each in parts)) for i in range(BLOCK)], BLOCK
    found, before = NoiseTuning(LpNoise(state_rows=True), 0, 6, 3), np.tile(np.eye(3), (BLOCK, 1, 1))
    window = np.concatenate(parts[:4], axis=2)
    return lambda: found.penalties(0, window, before), BLOCK


def tracking(by):
    from controllers.gpc_twin import dense
    from numerics.test_tracking import problems, tracked

    given = problems(np.random.default_rng(0), 6, 4, 3, 10, BLOCK)
    if by == "stacked":
        A, B, f, C, Q_yw, Q_u, w, x = given
        return lambda: [dense(A[i], B[i], f, C, Q_yw[i], Q_u, w, x[i]) for i in range(BLOCK)], BLOCK
    return lambda: [tracked(*given) for _ in range(20)], 20 * BLOCK


def tanks(method):
    from plants import tanks

    from rmpc_bench.plants.ode import design
    from rmpc_bench.plants.ode_stepping import Solver

    solver = Solver(substeps=10) if method == "ours" else Solver(method)
    n_runs = BLOCK if method == "ours" else 10
    made = design(5.0, 200, ode=tanks.rhs, output=tanks.output, states=tanks.STATES, inputs=tanks.INPUTS,
                  outputs=tanks.OUTPUTS, parameters=tanks.PARAMETERS, solver=solver,
                  x0=tanks.steady_state(8.0, tanks.PARAMETERS),
                  bounds={"h1": (1e-4, 0.6), "h2": (1e-4, 0.6), "pump": (0.0, 30.0)})  # fmt: skip
    rng = np.random.default_rng(5)
    delta = made.draw({name: np.full(n_runs, value) for name, value in made.nominal.items()}, [], 1)
    x, u = rng.uniform(0.05, 0.5, (n_runs, 2)), rng.uniform(0.0, 30.0, (n_runs, 1))
    return lambda: [made.step(0, delta, x, u, np.zeros((n_runs, 2))) for _ in range(5)], 5 * n_runs


SCIPY = "SciPy linprog (HiGHS), run by run"
ROWS = [
    Row("gain schedule: kalman, servo", "step", lambda: gains("kalman"), gains_by_filterpy, "filterpy"),
    Row("gain schedule: robust-kalman, servo", "step", lambda: gains("robust"), robust_gains_plain, "NumPy, brentq"),
    Row("minimax solve, N = 20", "solve", lambda: minimax("ours"), lambda: minimax("cvxpy"), "cvxpy + Clarabel"),
    Row("LP window, Ne = 3", "window", lambda: windows("ours", 4), lambda: windows("scipy", 4), SCIPY),
    Row("LP window, Ne = 8", "window", lambda: windows("ours", 9), lambda: windows("scipy", 9), SCIPY),
    Row("LP2, penalties of a sample", "run", lambda: penalties("ours"), lambda: penalties("full"), SCIPY),
    Row("GPC, first input", "run", lambda: tracking("ours"), lambda: tracking("stacked"), "stacked system, NumPy"),
    Row("plant of an ODE: two tanks", "run-step", lambda: tanks("ours"), lambda: tanks("RK45"), "solve_ivp, RK45"),
]
