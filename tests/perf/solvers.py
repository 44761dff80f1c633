"""Designs and solvers: gain schedules, minimax control, linear programs, plants of differential equations."""

import numpy as np

from perf.row import Row

BLOCK, STAGES = 50, 10


def gains(kind):
    from rmpc_bench.estimators import kalman, robust_kalman
    from rmpc_bench.models.servo import ServoNoise, design

    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))
    start = {"x0": np.zeros(4), "P0": model.Q_w}
    if kind == "kalman":
        return lambda: kalman.design(model, 200, **start).L[:200], 200
    return lambda: robust_kalman.design(model, 200, **start, c=0.1).L[:200], 200


def gains_by_filterpy():
    from filterpy.kalman import KalmanFilter

    from rmpc_bench.models.servo import ServoNoise, design

    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))

    def work():
        kf = KalmanFilter(dim_x=4, dim_z=1)
        kf.F, kf.H, kf.Q, kf.R, kf.P = model.A, model.C, model.Q_w, model.R_v, model.Q_w
        gains = []
        for _ in range(200):
            kf.update(np.zeros(1))
            gains.append(kf.K)
            kf.predict()
        return gains

    return work, 200


def robust_gains_plain():
    """The same gains in NumPy, the root of (16) by SciPy."""
    from scipy.optimize import brentq

    from rmpc_bench.models.servo import ServoNoise, design

    model = design(0.1, noise=ServoNoise(process=1.0, measurement=1.0))

    def work():
        P, gains = model.Q_w, []
        for _ in range(200):
            lam = np.linalg.eigvalsh(P)

            def gap(theta, lam=lam):
                return np.sum(np.log1p(-theta * lam) + 1 / (1 - theta * lam) - 1) - 0.1

            theta = brentq(gap, 0.0, (1 - 1e-9) / lam[-1])
            V = np.linalg.inv(np.linalg.inv(P) - theta * np.eye(4))
            gains.append(V @ model.C.T @ np.linalg.inv(model.C @ V @ model.C.T + model.R_v))
            P = model.A @ (V - gains[-1] @ model.C @ V) @ model.A.T + model.Q_w
        return gains

    return work, 200


def minimax(by):
    from controllers import minimax_oracles as oracles

    from rmpc_bench.controllers.state_feedback import game_of
    from rmpc_bench.numerics.linalg import psd_sqrt
    from rmpc_bench.numerics.lq_game import solve

    stages, M_w = oracles.paper_stages(20, STAGES), np.broadcast_to([[5.0, 2.0], [2.0, 5.0]], (STAGES, 2, 2))
    M, x = np.array([[28.0, -9.0], [-9.0, 12.0]]), np.array([3.0, -2.0])
    if by == "cvxpy":
        return lambda: oracles.semidefinite(stages, M, M_w, x)[0], 1
    game, root = game_of(stages, psd_sqrt(M_w)), psd_sqrt(M[None])[0]
    return lambda: [solve(game, root, x).rho for _ in range(20)][0], 20


def windows(by, points):
    from numerics import lp_twin
    from numerics.test_bounded_window import data, integrators

    from rmpc_bench.numerics.bounded_window import fit_free

    window, C = integrators(np.random.default_rng(0), BLOCK, points)
    if by == "scipy":
        programs = [data(window, C, i, points) for i in range(BLOCK)]
        return lambda: [lp_twin.solve(each)[0] for each in programs], BLOCK

    def work():
        fits = [fit_free(window, C, points) for _ in range(10)][0]
        return fits.rho.sum(axis=1) + fits.r.sum(axis=1)

    return work, 10 * BLOCK


def penalties(by):
    from controllers.gpc_twin import full_lp2
    from controllers.test_noise_tuning import windows as signals

    from rmpc_bench.controllers.noise_tuning import LpNoise, NoiseTuning

    parts = signals(np.random.default_rng(0), BLOCK)
    if by == "full":
        return lambda: [full_lp2(*(each[i] for each in parts))[1] for i in range(BLOCK)], BLOCK
    found, before = NoiseTuning(LpNoise(state_rows=True), 0, 6, 3), np.tile(np.eye(3), (BLOCK, 1, 1))
    window = np.concatenate(parts[:4], axis=2)
    return lambda: found.penalties(0, window, before)[1]["r_breve"], BLOCK


def tracking(by):
    from controllers.gpc_twin import dense
    from numerics.test_tracking import problems, tracked

    given = problems(np.random.default_rng(0), 6, 4, 3, 10, BLOCK)
    if by == "stacked":
        A, B, f, C, Q_yw, Q_u, w, x = given
        return lambda: [dense(A[i], B[i], f, C, Q_yw[i], Q_u, w, x[i])[0] for i in range(BLOCK)], BLOCK
    return lambda: [tracked(*given)[0] for _ in range(20)][0], 20 * BLOCK


def tanks_plant(solver):
    """Return two tanks as a plant."""
    from plants import tanks

    from rmpc_bench.plants.ode import design

    bounds = {"h1": (1e-4, 0.6), "h2": (1e-4, 0.6), "pump": (0.0, 30.0)}
    return design(5.0, 200, ode=tanks.rhs, output=tanks.output, states=tanks.STATES, inputs=tanks.INPUTS,
                  outputs=tanks.OUTPUTS, parameters=tanks.PARAMETERS, bounds=bounds, solver=solver,
                  x0=tanks.steady_state(8.0, tanks.PARAMETERS))  # fmt: skip


def tanks_sample(made, n_runs):
    """Arguments of a step of a block."""
    rng = np.random.default_rng(5)
    delta = made.draw({name: np.full(n_runs, value) for name, value in made.nominal.items()}, [], 1)
    x, u = rng.uniform(0.05, 0.5, (n_runs, 2)), rng.uniform(0.0, 30.0, (n_runs, 1))
    return 0, delta, x, u, np.zeros((n_runs, 2))


def tanks(method):
    from rmpc_bench.plants.ode_stepping import Solver

    made = tanks_plant(Solver(substeps=10) if method == "ours" else Solver(method))
    sample = tanks_sample(made, BLOCK)
    return lambda: [made.step(*sample).x for _ in range(5)][0], 5 * BLOCK


SCIPY = "SciPy linprog (HiGHS), run by run"
ROWS = [
    Row("gain schedule: kalman, servo", "step", lambda: gains("kalman"), gains_by_filterpy, "filterpy"),
    Row("gain schedule: robust-kalman, servo", "step", lambda: gains("robust"), robust_gains_plain, "NumPy, brentq"),
    Row(f"minimax solve, N = {STAGES}", "solve", lambda: minimax("ours"), lambda: minimax("cvxpy"), "cvxpy + Clarabel"),
    Row("LP window, Ne = 3", "window", lambda: windows("ours", 4), lambda: windows("scipy", 4), SCIPY),
    Row("LP window, Ne = 8", "window", lambda: windows("ours", 9), lambda: windows("scipy", 9), SCIPY),
    Row("LP2, penalties of a sample", "run", lambda: penalties("ours"), lambda: penalties("full"), SCIPY),
    Row("GPC, first input", "run", lambda: tracking("ours"), lambda: tracking("stacked"), "stacked system, NumPy"),
    Row(
        "plant of an ODE: two tanks",
        "run-step",
        lambda: tanks("ours"),
        lambda: tanks("DOP853"),
        "solve_ivp, DOP853",
        1e-4,
    ),
]
