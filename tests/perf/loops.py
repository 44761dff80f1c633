"""Closed loops: whole blocks of this package beside a loop over runs and samples with other libraries."""

import warnings

import numpy as np

from perf.row import Row

FIG7 = "configs/zenere2018/fig7.yaml"
STEPS, RUNS_OF_SCRIPT, STEPS_OF_DO_MPC = 200, 2, 20


def experiment(path=FIG7):
    from rmpc_bench.config.load import load_config

    return load_config(path).experiment


def blocks(path, runs, methods=None):
    """Simulate blocks of an experiment; a unit is a sample of a run."""
    from rmpc_bench.simulation.closed_loop import simulate_block
    from rmpc_bench.simulation.threads import single_thread

    made = experiment(path)
    chosen = [method for method in made.methods if methods is None or method.name in methods]

    def work():
        with single_thread():
            return [simulate_block(made, method, range(runs)) for method in chosen]

    return work, runs * len(chosen) * made.n_steps


def script(n_runs=RUNS_OF_SCRIPT):
    """Fig. 7 with S-MPC as a script: a loop over runs and samples, filterpy's filter, an event-driven integration."""
    from filterpy.kalman import KalmanFilter
    from plants.servo_loops import ReferencePlant
    from plants.servo_oracle import flow

    made = experiment()
    method, filtered = made.method("S-MPC"), made.methods[0].estimator
    rows = made.scenario.draw(ReferencePlant(), range(n_runs), 1).delta
    law, r = method.controller, np.full(method.controller.preview - 1, np.pi / 2)

    def one_run(p):
        kf = KalmanFilter(dim_x=4, dim_z=1, dim_u=1)
        kf.F, kf.B, kf.H = filtered.F[0], filtered.B[0], filtered.C[0]
        kf.Q, kf.R = np.reshape(filtered.Q_w, (-1, 4, 4))[0], np.reshape(filtered.R_v, (-1, 1, 1))[0]
        kf.P, kf.x = kf.Q.copy(), np.zeros((4, 1))
        x, u, total = np.zeros(5), np.zeros(1), 0.0
        for _ in range(STEPS):
            kf.update(x[:1, None])
            total += (x[0] - np.pi / 2) ** 2
            u = np.clip(u - law.K_u @ u + law.K_r @ r - law.K_x @ kf.x[:, 0], law.low, law.high)
            kf.predict(u[:, None])
            x = flow(p, x, float(u[0]), 0.1, rtol=1e-6, atol=1e-8)
        return total / STEPS

    return lambda: [one_run(p) for p in rows], n_runs * STEPS


def do_mpc_steps():
    """Solve the control problem of Fig. 7 at every sample with do-mpc; a unit is a sample of a run."""
    warnings.filterwarnings("ignore")
    import do_mpc

    made = experiment().methods[0].estimator
    A, B, C = made.F[0], made.B[0], made.C[0]
    model = do_mpc.model.Model("discrete")
    x, u = model.set_variable("_x", "x", (4, 1)), model.set_variable("_u", "u", (1, 1))
    model.set_rhs("x", A @ x + B @ u)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.store_full_solution = 10, 0.1, False
    mpc.settings.supress_ipopt_output()
    error = (C @ x - np.pi / 2) / (2 * np.pi)
    mpc.set_objective(mterm=0.1 * error**2, lterm=0.1 * error**2)
    mpc.set_rterm(u=0.1 / 440**2)
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -220.0, 220.0
    mpc.setup()

    def work():
        mpc.x0 = np.zeros((4, 1))
        mpc.set_initial_guess()
        state = np.zeros((4, 1))
        for _ in range(STEPS_OF_DO_MPC):
            state = A @ state + B @ mpc.make_step(state)

    return work, STEPS_OF_DO_MPC


def predictor_script():
    """souto2011 Fig. 4 run by run, in NumPy."""
    from rmpc_bench.simulation.threads import single_thread

    made = experiment("configs/souto2011/fig4.yaml")
    schedule, m, n = made.methods[0].estimator, made.plant.system.at(0), made.n_steps
    draws = made.scenario.draw(made.plant, range(1), n)

    def work():
        with single_thread():
            x, x_hat = draws.x0[0], schedule.x0
            for k in range(n):
                F_x, F_w, F_v = (F[0, k] for F in draws.delta)
                w, v = draws.w[0, k], draws.v[0, k]
                y = (m.C + m.H_C @ F_x @ m.G_x) @ x + (m.Dv + m.H_Dv @ F_v @ m.G_v) @ v
                x_hat = schedule.F[k] @ x_hat + schedule.f[0] + schedule.K[k] @ (y - m.C @ x_hat)
                x = (m.A + m.H_A @ F_x @ m.G_x) @ x + (m.Bw + m.H_Bw @ F_w @ m.G_w) @ w

    return work, n


def runs_of_fig7(n_runs, jobs=1):
    """Compute and store runs of Fig. 7; a unit is a run with one method."""
    import tempfile

    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution.results import run

    config = load_config(FIG7, runs=n_runs)
    return lambda: run(config, directory=tempfile.mkdtemp(), jobs=jobs), n_runs * 4


def joblib_runs():
    """Fig. 7 with joblib, one run with one method per task."""
    from joblib import Parallel, delayed

    from rmpc_bench.simulation.closed_loop import simulate_block

    made = experiment()
    tasks = [delayed(simulate_block)(made, method, range(i, i + 1)) for method in made.methods for i in range(50)]

    def work():
        from joblib.externals.loky import get_reusable_executor

        found = Parallel(n_jobs=2)(tasks)
        # Its workers end, so that their time is known.
        get_reusable_executor().shutdown(wait=True)
        return found

    return work, len(tasks)


SCRIPT = "Python loop, filterpy, event-driven DOP853"
ROWS = [
    Row("servo: Fig. 7, S-MPC", "run-step", lambda: blocks(FIG7, 200, ["S-MPC"]), script, SCRIPT),
    Row("servo: Fig. 7, four methods", "run-step", lambda: blocks(FIG7, 200), script, SCRIPT),
    Row("servo: Fig. 7, S-MPC", "run-step", lambda: blocks(FIG7, 200, ["S-MPC"]), do_mpc_steps, "do-mpc per step"),
    Row(
        "uncertain linear: souto2011 Fig. 4",
        "run-step",
        lambda: blocks("configs/souto2011/fig4.yaml", 200),
        predictor_script,
        "NumPy loop over one run",
    ),
    Row("runs of Fig. 7, stored", "run", lambda: runs_of_fig7(4000), joblib_runs, "joblib, a task per run"),
    Row("100,000 x 4 of Fig. 7", "run", lambda: runs_of_fig7(100_000, 2), lambda: _runs(script(20)), SCRIPT, True),
    Row(
        "100,000 x 4 of Fig. 7", "run", lambda: runs_of_fig7(100_000, 2), lambda: _of_do_mpc(), "do-mpc per step", True
    ),
    Row("1,000,000 x 4 of Fig. 7", "run", lambda: runs_of_fig7(1_000_000, 2), lambda: _runs(script(20)), SCRIPT, True),
]


def _runs(made):
    work, units = made
    return work, units / STEPS


def _of_do_mpc():
    """Twenty solutions at each of 20 runs' first samples stand for whole runs."""
    work, units = do_mpc_steps()
    return lambda: [work() for _ in range(20)], 20 * units / STEPS
