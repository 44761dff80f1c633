"""Closed loops: whole blocks of this package beside a loop over runs and samples with other libraries.

Our side also draws the random numbers and computes all metrics of the experiment.
"""

import numpy as np

from perf.programs import FIG7, STEPS, experiment, program
from perf.row import Row

EXP2, STEPS_OF_ROBOT = "configs/belda2017/exp2.yaml", 100
FIG4 = "configs/souto2011/fig4.yaml"
JOBS, RUNS_OF_JOBLIB, RUNS_STORED = 2, 25, 2000


def blocks(path, runs, methods=None):
    """Simulate blocks of an experiment; a unit is a sample of a run."""
    from rmpc_bench.simulation.closed_loop import simulate_block
    from rmpc_bench.simulation.threads import single_thread

    made = experiment(path)
    chosen = [method for method in made.methods if methods is None or method.name in methods]

    def work():
        with single_thread():
            found = [simulate_block(made, method, range(runs)) for method in chosen]
        return found[0].metrics[0]

    return work, runs * len(chosen) * made.n_steps


def loop(law, n_runs):
    """Compute runs of Fig. 7 with S-MPC by a plain program; a unit is a sample of a run."""
    return program(law, n_runs), n_runs * STEPS


def predictor_script(n_runs=3):
    """Compute souto2011 Fig. 4 run by run, in NumPy."""
    from rmpc_bench.simulation.threads import single_thread

    made = experiment(FIG4)
    schedule, m, n = made.methods[0].estimator, made.plant.system.at(0), made.n_steps
    draws = made.scenario.draw(made.plant, range(n_runs), n)

    def one_run(i):
        x, x_hat, squares = draws.x0[i], schedule.x0, 0.0
        for k in range(n):
            F_x, F_w, F_v = (F[i, k] for F in draws.delta)
            w, v = draws.w[i, k], draws.v[i, k]
            y = (m.C + m.H_C @ F_x @ m.G_x) @ x + (m.Dv + m.H_Dv @ F_v @ m.G_v) @ v
            squares += np.sum((x_hat - x) ** 2)
            x_hat = schedule.F[k] @ x_hat + schedule.f[0] + schedule.K[k] @ (y - m.C @ x_hat)
            x = (m.A + m.H_A @ F_x @ m.G_x) @ x + (m.Bw + m.H_Bw @ F_w @ m.G_w) @ w
        return squares / (2 * n)

    def work():
        with single_thread():
            return [one_run(i) for i in range(n_runs)]

    return work, n_runs * n


def robot(name, *, plain):
    """Simulate the first steps of the robot of belda2017 with a method; a unit is a step of a run."""
    from papers import belda_twin

    from rmpc_bench.simulation.closed_loop import simulate
    from rmpc_bench.simulation.threads import single_thread

    made, n = experiment(EXP2), STEPS_OF_ROBOT
    n_runs, method = (1 if plain else 50), made.method(name)
    draws = made.scenario.draw(made.plant, range(n_runs), n)
    r = made.scenario.reference.sample(n + 1 + method.controller.preview)

    def work():
        with single_thread():
            if plain:
                x = belda_twin.simulate(draws.v[0, :n], tuned=name == "tuned").x
            else:
                x = simulate(made.plant, method, draws, r, n)[0].x[0]
        return x[-10:, :3]

    return work, n_runs * n


def runs_of_fig7(n_runs):
    """Compute and store runs of Fig. 7; a unit is a run with one method."""
    import tempfile

    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution.run import run

    config = load_config(FIG7, runs=n_runs)

    def work():
        results = run(config, directory=tempfile.mkdtemp(), jobs=JOBS)
        return results.trials.each[0].column("mse", "S-MPC")[:RUNS_OF_JOBLIB]

    return work, n_runs * 4


def joblib_runs():
    """Compute Fig. 7 with joblib, one run with one method per task; nothing is stored."""
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor

    from rmpc_bench.simulation.closed_loop import simulate_block

    made = experiment()
    tasks = [
        delayed(simulate_block)(made, method, range(i, i + 1)) for method in made.methods for i in range(RUNS_OF_JOBLIB)
    ]

    def work():
        found = Parallel(n_jobs=JOBS)(tasks)
        # Its workers end, so that their time is known.
        get_reusable_executor().shutdown(wait=True)
        return [block.metrics[0, 0] for block in found[:RUNS_OF_JOBLIB]]

    return work, len(tasks)


LOOP = "loop over runs and samples: filterpy, solve_ivp with events"
DO_MPC = "the same loop, the control problem solved by do-mpc at every sample"
ROBOT = "loop over steps in NumPy, linear programs by SciPy linprog (HiGHS)"
ROWS = [
    Row("servo: Fig. 7, S-MPC", "run-step", lambda: blocks(FIG7, 200, ["S-MPC"]), lambda: loop("gains", 2), LOOP),
    Row("servo: Fig. 7, four methods", "run-step", lambda: blocks(FIG7, 200), lambda: loop("gains", 2), LOOP),
    Row("servo: Fig. 7, S-MPC", "run-step", lambda: blocks(FIG7, 200, ["S-MPC"]), lambda: loop("do-mpc", 1), DO_MPC),
    Row(
        "uncertain linear: souto2011 Fig. 4, ERP",
        "run-step",
        lambda: blocks(FIG4, 200, [experiment(FIG4).methods[0].name]),
        predictor_script,
        "loop over runs and steps in NumPy",
        1e-9,
    ),
    Row(
        "robot: belda2017, LP1, GPC",
        "run-step",
        lambda: robot("constant", plain=False),
        lambda: robot("constant", plain=True),
        ROBOT,
        1e-5,
    ),
    Row(
        "robot: belda2017, LP1, LP2, GPC",
        "run-step",
        lambda: robot("tuned", plain=False),
        lambda: robot("tuned", plain=True),
        ROBOT,
        1e-4,
    ),
    Row(
        f"{RUNS_STORED} runs of Fig. 7, {JOBS} workers, stored",
        "run",
        lambda: runs_of_fig7(RUNS_STORED),
        joblib_runs,
        f"joblib, {JOBS} workers, a task per run, not stored",
    ),
]
