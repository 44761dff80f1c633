"""Linear loops beside what a user would write instead: NumPy with all runs at once, and a C++ program run by run.

The servomechanism has the plants, gains and noises of the experiment on both sides, drawn before the clock starts.  The
row of many runs has whole experiments: ours draws, simulates and stores; the baseline draws from one generator and
keeps the numbers in memory.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from perf.row import Row, cpu

CONFIGS = Path(__file__).parent / "configs"
SERVO, CHEAP, TANKS = (CONFIGS / f"{name}.yaml" for name in ("servo-linear", "cheap", "two-tanks-filters"))
RUNS, MANY, RUNS_OF_TANKS, CHECKED = 4000, 100_000, 240, 12
COMPILER = next((name for name in ("c++", "g++", "clang++") if shutil.which(name)), None)


def servo(noise):
    """Return the experiment of the servomechanism and its draws."""
    from rmpc_bench.config.load import load_config

    made = load_config(SERVO, overrides=[f"noise={noise}", f"runs={RUNS}"]).experiment
    return made, made.scenario.draw(made.plant, range(RUNS), made.n_steps)


def gains_of(made, method):
    """Return the matrices of a filter at every sample: F, B, C, K, L."""
    schedule, n = method.estimator.gain_schedule, made.n_steps
    every = [getattr(schedule, name) for name in "FBCKL"]
    return [np.ascontiguousarray(np.broadcast_to(M if len(M) == 1 else M[:n], (n, *M.shape[1:]))) for M in every]


def law_of(made, controller):
    """Return K_x, K_u, the part of the reference in every input, and the limits."""
    r = made.scenario.reference.sample(made.n_steps + 1 + controller.preview)
    ahead = np.stack([r[k + 1 : k + controller.preview].ravel() for k in range(made.n_steps)])
    return controller.K_x, controller.K_u, ahead @ controller.K_r.T, controller.low, controller.high


def servo_block(noise):
    """Simulate a block of runs with both methods; a unit is a sample of a run with a method."""
    from rmpc_bench.simulation.closed_loop import simulate_block
    from rmpc_bench.simulation.threads import single_thread

    made, draws = servo(noise)

    def work():
        with single_thread():
            found = [simulate_block(made, method, range(RUNS), draws) for method in made.methods]
        return np.stack([block.metrics[0] for block in found], axis=1)

    return work, RUNS * made.n_steps * len(made.methods)


def numpy_block(noise):
    """Compute the mean square errors of the same runs with NumPy; a unit is a sample of a run with a method."""
    from rmpc_bench.simulation.threads import single_thread

    made, draws = servo(noise)
    E, G, N = draws.delta.E, draws.delta.G, made.n_steps
    r = made.scenario.reference.sample(1)[0, 0]
    w, v = (np.ascontiguousarray(np.swapaxes(each, 0, 1)) for each in (draws.w, draws.v))

    def errors(method):
        F, B, C, K, L = gains_of(made, method)
        K_x, K_u, given, low, high = law_of(made, method.controller)
        x, x_pred, u, total = draws.x0, np.zeros((RUNS, 4)), np.zeros((RUNS, 1)), np.zeros(RUNS)
        for k in range(N):
            total += (x[:, 0] - r) ** 2
            e = x[:, :1] + v[k] - x_pred @ C[k].T
            x_hat = x_pred + e @ L[k].T
            u = np.clip(u - u @ K_u.T + given[k] - x_hat @ K_x.T, low, high)
            x = (E @ x[:, :, None] + G * u[:, :, None])[:, :, 0] + w[k]
            x_pred = x_pred @ F[k].T + u @ B[k].T + e @ K[k].T
        return total / N

    def work():
        with single_thread():
            return np.stack([errors(method) for method in made.methods], axis=1)

    return work, RUNS * N * len(made.methods)


PROGRAM = """
extern "C" void loop(long runs, long steps, const double *E, const double *G, const double *x0, const double *w,
                     const double *v, const double *F, const double *B, const double *C, const double *K,
                     const double *L, const double *K_x, double K_u, const double *given, double low, double high,
                     double r, double *mse) {
    for (long run = 0; run < runs; run++, E += 16, G += 4, x0 += 4) {
        double x[4], x_pred[4] = {0}, x_hat[4], next[4], u = 0, sum = 0;
        for (int i = 0; i < 4; i++) x[i] = x0[i];
        for (long k = 0; k < steps; k++, w += 4, v++) {
            const double *c = C + 4 * k, *l = L + 4 * k, *f = F + 16 * k, *b = B + 4 * k, *gain = K + 4 * k;
            sum += (x[0] - r) * (x[0] - r);
            double e = x[0] + *v - (c[0] * x_pred[0] + c[1] * x_pred[1] + c[2] * x_pred[2] + c[3] * x_pred[3]);
            for (int i = 0; i < 4; i++) x_hat[i] = x_pred[i] + l[i] * e;
            double fed_back = K_x[0] * x_hat[0] + K_x[1] * x_hat[1] + K_x[2] * x_hat[2] + K_x[3] * x_hat[3];
            u = u - K_u * u + given[k] - fed_back;
            u = u < low ? low : u > high ? high : u;
            for (int i = 0; i < 4; i++) {
                const double *row = E + 4 * i;
                next[i] = row[0] * x[0] + row[1] * x[1] + row[2] * x[2] + row[3] * x[3] + G[i] * u + w[i];
            }
            for (int i = 0; i < 4; i++) x[i] = next[i];
            for (int i = 0; i < 4; i++) {
                const double *row = f + 4 * i;
                next[i] = row[0] * x_pred[0] + row[1] * x_pred[1] + row[2] * x_pred[2] + row[3] * x_pred[3];
                next[i] += b[i] * u + gain[i] * e;
            }
            for (int i = 0; i < 4; i++) x_pred[i] = next[i];
        }
        mse[run] = sum / steps;
    }
}
"""


def compiled():
    """Compile the loop for this processor."""
    place = Path(tempfile.mkdtemp())
    (place / "loop.cpp").write_text(PROGRAM)
    command = [COMPILER, "-O3", "-march=native", "-shared", "-fPIC", "-o", "loop.so", "loop.cpp"]
    subprocess.run(command, cwd=place, check=True, capture_output=True)
    return ctypes.CDLL(str(place / "loop.so")).loop


def native_block(noise):
    """Compute them run by run in C++."""
    made, draws = servo(noise)
    r, function, N = made.scenario.reference.sample(1)[0, 0], compiled(), made.n_steps
    plants = [draws.delta.E, draws.delta.G, draws.x0, draws.w[:, :N], draws.v[:, :N]]

    def argument(value):
        if isinstance(value, np.ndarray):
            return value.ctypes.data_as(ctypes.c_void_p)
        return ctypes.c_long(value) if isinstance(value, int) else ctypes.c_double(value)

    def call(method):
        K_x, K_u, given, low, high = law_of(made, method.controller)
        arrays = [np.ascontiguousarray(each) for each in (*plants, *gains_of(made, method), K_x, given)]
        mse = np.zeros(RUNS)
        values = [RUNS, N, *arrays[:-1], float(K_u[0, 0]), arrays[-1], float(low), float(high), float(r), mse]
        return (arrays, mse), [argument(each) for each in values]

    calls = [call(method) for method in made.methods]

    def work():
        for _, arguments in calls:
            function(*arguments)
        return np.stack([mse for (_, mse), _ in calls], axis=1)

    return work, RUNS * N * len(made.methods)


def stored(path, n_runs, jobs):
    """Compute and store runs of an experiment; a unit is a run with a method."""
    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution.run import run

    config = load_config(path, runs=n_runs, allow_code=["configs/examples/tanks.py"])

    def work():
        with tempfile.TemporaryDirectory() as place:
            table = run(config, directory=place, jobs=jobs).trials
            columns = [table.column(info.name, name)[:CHECKED] for name in table.methods for info in table.metrics]
            return np.stack(columns, axis=1)

    return work, n_runs * len(config.methods)


def cheap_runs(n_runs):
    """Draw and simulate cheap runs with NumPy; what is compared are the first runs, with the draws of the bench."""
    from rmpc_bench.config.load import load_config
    from rmpc_bench.simulation.threads import single_thread

    made = load_config(CHEAP).experiment
    m, n = made.plant.system.at(0), made.n_steps
    filters = [(gains_of(made, method), np.linalg.inv(method.estimator.P)) for method in made.methods]
    root = np.linalg.cholesky([[1.9608, 0.0195], [0.0195, 1.9605]])
    draws = made.scenario.draw(made.plant, range(CHECKED), n)

    def simulated(F_x, x0, w, v):
        found = []
        for (F, _, C, K, L), inverse in filters:
            x, x_pred, square, nees = x0, np.zeros_like(x0), np.zeros(len(x0)), np.zeros(len(x0))
            for k in range(n):
                e = x @ m.C.T + v[k] - x_pred @ C[k].T
                error = x_pred + e @ L[k].T - x
                square += np.sum(error**2, axis=1)
                nees += np.sum(error @ inverse[k] * error, axis=1)
                x = x @ m.A.T + F_x * (x @ m.G_x.T) @ m.H_A.T + w[k]
                x_pred = x_pred @ F[k].T + e @ K[k].T
            found += [square / (2 * n), nees / (2 * n)]
        return np.stack(found, axis=1)

    checked = simulated(draws.delta.F_x[:, 0, 0], draws.x0, np.swapaxes(draws.w, 0, 1), np.swapaxes(draws.v, 0, 1))

    def work():
        rng = np.random.default_rng(1)
        x0, w = rng.standard_normal((n_runs, 2)), rng.standard_normal((n, n_runs, 2)) @ root.T
        with single_thread():
            simulated(rng.uniform(-1.0, 1.0, (n_runs, 1)), x0, w, rng.standard_normal((n, n_runs, 1)))
        return checked

    return work, n_runs * len(filters)


NUMPY, NO_COMPILER = "NumPy, all runs at once", "C++, run by run: this machine has no compiler"
ROWS = []
for what, noise in (("without noise", "none"), ("with noise", "same")):
    name, ours = f"linear servo, 2 methods, {what}", partial(servo_block, noise)
    ROWS.append(Row(name, "run-step", ours, partial(numpy_block, noise), NUMPY, 1e-12))
    native = partial(native_block, noise) if COMPILER else None
    ROWS.append(Row(name, "run-step", ours, native, "C++ -O3, run by run" if native else NO_COMPILER, 1e-12))
ROWS += [
    Row(
        f"{MANY:,} cheap runs, 2 methods, stored",
        "run",
        lambda: stored(CHEAP, MANY, 1),
        lambda: cheap_runs(MANY),
        f"{NUMPY}, draws included, not stored",
        1e-12,
    ),
    *(
        Row(
            f"two tanks, 4 filters, 2 workers, {what}",
            "run",
            lambda: stored(TANKS, RUNS_OF_TANKS, 2),
            lambda: stored(TANKS, RUNS_OF_TANKS, 1),
            "1 worker",
            0.0,
            clock,
        )
        for what, clock in (("CPU", cpu), ("time that passes", time.monotonic))
    ),
]
