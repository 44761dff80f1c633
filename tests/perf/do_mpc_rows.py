"""MPC and MHE of do-mpc: through the adapter, and in a plain loop that calls `make_step`.

The objects are made before the clock starts.  Each side has four runs of 60 samples; states and measurements are drawn
once.  A plain MHE repeats its oldest measurement until its window is full, which changes its first estimates only: the
last estimate of every run is compared.
"""

import numpy as np

from perf.row import Row

RUNS, STEPS, TS = 4, 60, 0.5


def signals():
    """Return states, measurements and inputs of all runs, (runs, samples, n)."""
    rng = np.random.default_rng(0)
    return [rng.standard_normal((RUNS, STEPS, n)) for n in (2, 1, 1)]


def mpc():
    """Call the design with 15 samples of horizon."""
    from adapters.do_mpc_laws import small_mpc
    from components.one_run import designed

    from rmpc_bench.types import Estimate

    design, (x, y, _) = designed("controllers", small_mpc, Hp=15), signals()
    start = design.init(RUNS)
    status, r = np.zeros(RUNS, dtype=np.int8), np.ones((1, 1))

    def work():
        state, inputs = start, []
        for k in range(STEPS):
            state, command = design.control(k, state, y[:, k], Estimate(x[:, k], None, None, status, {}), r)
            inputs.append(command.u)
        return np.array(inputs)

    return work, RUNS * STEPS


def plain_mpc():
    """Call `make_step` of one object per run, of a model written in do-mpc itself."""
    from adapters.do_mpc_laws import tracking
    from components.one_run import MODEL

    objects, (x, _, _) = [], signals()
    for _ in range(RUNS):
        made = tracking(MODEL, 15, 1.0, 0.5)
        made.settings.t_step = TS
        made.settings.supress_ipopt_output()
        template = made.get_tvp_template()
        template["_tvp", :, "r"] = 1.0
        made.set_tvp_fun(lambda t, template=template: template)
        made.setup()
        objects.append(made)

    def work():
        inputs = []
        for made in objects:
            made.reset_history()
            made.u0 = np.zeros(1)
            made.set_initial_guess()
        for k in range(STEPS):
            inputs.append([made.make_step(x[i, k, :, None]).ravel() for i, made in enumerate(objects)])
        return np.array(inputs)

    return work, RUNS * STEPS


def mhe():
    """Call the design with a window of ten samples."""
    from adapters.do_mpc_laws import small_mhe
    from components.one_run import designed

    design, (_, y, u) = designed("estimators", small_mhe, Ne=10), signals()
    start = design.init(RUNS)

    def work():
        state = start
        for k in range(STEPS):
            state, estimate = design.correct(k, state, y[:, k])
            state = design.predict(k, state, u[:, k])
        return estimate.x_hat

    return work, RUNS * STEPS


def plain_mhe():
    """Call `make_step` of one object per run."""
    import do_mpc
    from components.one_run import MODEL, START

    from rmpc_bench.adapters.do_mpc import do_mpc_model

    objects, (_, y, u) = [], signals()
    for _ in range(RUNS):
        made = do_mpc.estimator.MHE(do_mpc_model(MODEL))
        made.settings.n_horizon, made.settings.t_step, made.settings.meas_from_data = 10, TS, True
        made.settings.supress_ipopt_output()
        P_x, P_w, P_v = (np.linalg.inv(each) for each in (START["P0"], MODEL.Q_w, MODEL.R_v))
        made.set_default_objective(P_x, P_v, P_w=P_w)
        template = made.get_tvp_template()
        made.set_tvp_fun(lambda t, template=template: template)
        made.setup()
        made.x0 = START["x0"]
        made.set_initial_guess()
        objects.append(made)

    def work():
        for made in objects:
            made.reset_history()
        for k in range(1, STEPS):
            data = np.concatenate([y[:, k], u[:, k - 1]], axis=1)
            last = [made.make_step(each[:, None]).ravel() for made, each in zip(objects, data, strict=True)]
        return np.array(last)

    return work, RUNS * STEPS


ALONE = "do-mpc alone, `make_step` in a plain loop"
ROWS = [
    Row("do-mpc MPC, 15 samples, 2 states", "run and step", mpc, plain_mpc, ALONE),
    Row("do-mpc MHE, 10 samples, 2 states", "run and step", mhe, plain_mhe, ALONE),
]
