"""MHE of do-mpc: the numbers of a batch least-squares problem and of the Kalman filter, and its traps."""

from types import SimpleNamespace

import numpy as np
import pytest
from adapters.do_mpc_laws import small_mhe
from components.one_run import MODEL, START, TS, designed, experiment, simulated
from scipy.linalg import expm

from rmpc_bench import SolverError
from rmpc_bench.adapters.do_mpc import do_mpc_estimator, do_mpc_library, do_mpc_model, quiet, refuse_other_order, set_up
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.extras import is_installed
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Status

if not is_installed("do-mpc"):
    pytest.skip("do-mpc is not installed", allow_module_level=True)

NE, K = 5, 14
NEWTON = {"rtol": 0.0, "atol": 1e-9}
"""One Newton step of the solver against an orthogonal factorisation; measured: 3e-15."""


def data():
    """Return K measurements y(1), .. and the inputs before them; estimates are of the size of 1."""
    rng = np.random.default_rng(0)
    return rng.standard_normal((K, 1)), rng.standard_normal((K, 1))


def batch(x_prev, ys, us, model=MODEL):
    """Return the states x(0), .., x(n) of a window by least squares; a NaN in ys is no measurement."""
    n, nx = len(ys), model.nx
    root = {name: np.linalg.cholesky(np.linalg.inv(S)).T for name, S in vars_of(model).items()}
    rows, right = [np.eye(nx, nx * (n + 1))], [x_prev]
    rows[0] = root["P"] @ rows[0]
    right[0] = root["P"] @ x_prev
    for j, (y, u) in enumerate(zip(ys, us, strict=True)):
        step = np.zeros((nx, nx * (n + 1)))
        step[:, j * nx : (j + 2) * nx] = np.hstack([-model.A, np.eye(nx)])
        rows.append(root["w"] @ step)
        right.append(root["w"] @ (model.B @ u + model.f0))
        if np.isfinite(y).all():
            seen = np.zeros((model.ny, nx * (n + 1)))
            seen[:, (j + 1) * nx : (j + 2) * nx] = model.C
            rows.append(root["v"] @ seen)
            right.append(root["v"] @ (y - model.d0))
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0].reshape(n + 1, nx)


def vars_of(model):
    """Return the covariances of the arrival cost and of both noises."""
    return {"P": START["P0"], "w": model.Q_w, "v": model.R_v}


def expected(ys, us):
    """Return the last states of windows of least squares: growing to NE samples, then moving."""
    x_prev, estimates = START["x0"], [START["x0"]]
    for k in range(1, len(ys) + 1):
        begin = max(0, k - NE)
        path = batch(x_prev, ys[begin:k], us[begin:k])
        estimates.append(path[-1])
        x_prev = path[1] if k >= NE else x_prev
    return np.array(estimates)


def started(**keys):
    """Return an object of the adapter at k = 0."""
    law = small_mhe(model=MODEL, P0=START["P0"], Ts=TS, Ne=NE, **keys)
    law.start(START["x0"])
    np.testing.assert_array_equal(law.update(np.ones(1), None, 0.0), START["x0"])
    return law


def estimated(law, ys, us):
    """Call `update` for k = 1, 2, .."""
    return np.array([law.update(y, u, (k + 1) * TS) for k, (y, u) in enumerate(zip(ys, us, strict=True))])


def plain():
    """Return an MHE that is set up, with an initial guess, as a plain loop uses it."""

    def make():
        mhe = do_mpc_library().estimator.MHE(do_mpc_model(MODEL))
        mhe.settings.n_horizon = NE
        P_x, P_w, P_v = (np.linalg.inv(each) for each in vars_of(MODEL).values())
        mhe.set_default_objective(P_x, P_v, P_w=P_w)
        set_up(mhe, TS)
        mhe.x0 = START["x0"]
        mhe.set_initial_guess()
        return mhe

    return quiet(make)()


def test_every_window_is_batch_least_squares():
    """While the window grows, when it is full, and while it moves."""
    ys, us = data()
    np.testing.assert_allclose(estimated(started(), ys, us), expected(ys, us)[1:], **NEWTON)


TIMED = np.sin(1.3 * np.arange(K + 1)) + 0.2 * np.arange(K + 1)
"""A known input of the model that differs from sample to sample: entry j acts between samples j and j + 1."""


def driven(P0, order: str = "yu"):
    """Return an MHE whose model has this input as a time-varying parameter, and measurements in an order."""
    do_mpc = do_mpc_library()
    made = do_mpc.model.Model("discrete", "SX")
    x, u = (made.set_variable(f"_{name}", name, shape=(n, 1)) for name, n in (("x", 2), ("u", 1)))
    d = made.set_variable("_tvp", "d")
    made.set_rhs("x", MODEL.A @ x + MODEL.B @ u + np.array([[0.3], [1.0]]) @ d, process_noise=True)
    for name in order:
        made.set_meas(name, u if name == "u" else MODEL.C @ x, meas_noise=name == "y")
    made.setup()
    mhe = do_mpc.estimator.MHE(made)
    mhe.settings.n_horizon = NE
    P_x, P_w, P_v = (np.linalg.inv(each) for each in vars_of(MODEL).values())
    mhe.set_default_objective(P_x, P_v, P_w=P_w)
    template = mhe.get_tvp_template()

    def tvp_fun(t):
        """As in a full window: the place NE - 1 is the sample of the time, and nothing is known of later ones."""
        now = round(np.ravel(t)[0] / TS)
        for j in range(NE + 1):
            sample = now + j - NE + 1
            template["_tvp", j, "d"] = TIMED[sample] if 0 <= sample <= now else 1e3
        return template

    mhe.set_tvp_fun(tvp_fun)
    return mhe


@pytest.mark.parametrize("order", ["yu", "uy"])
def test_time_varying_parameters_are_those_of_the_samples_in_the_window(order):
    """Oracle: least squares with the parameter as a further input.  The model may measure u before y."""
    ys, us = data()
    ys[[3, 8]] = np.nan
    law = do_mpc_estimator(driven)(model=MODEL, P0=START["P0"], Ts=TS, order=order)
    law.start(START["x0"])
    law.update(np.ones(1), None, 0.0)
    wide = LinearModel(MODEL.A, np.hstack([MODEL.B, [[0.3], [1.0]]]), MODEL.C, MODEL.Q_w, MODEL.R_v)
    x_prev, path = START["x0"], None
    for k, estimate in enumerate(estimated(law, ys, us), start=1):
        begin = max(0, k - NE)
        path = batch(x_prev, ys[begin:k], np.column_stack([us, TIMED[:K]])[begin:k], wide)
        np.testing.assert_allclose(estimate, path[-1], rtol=0.0, atol=1e-8, err_msg=f"k = {k}")
        x_prev = path[1] if k >= NE else x_prev


@pytest.mark.parametrize("noun", ["states", "inputs", "outputs"])
def test_signals_in_another_order_are_refused(noun):
    """A model of the user with the names of the plant; without this the numbers are exchanged."""
    made = do_mpc_library().model.Model("discrete", "SX")
    names = {"states": ["h1", "h2"], "inputs": ["q1", "q2"], "outputs": ["y1", "y2"]}
    own = {**names, noun: names[noun][::-1]}
    x, u = (
        [made.set_variable(f"_{letter}", name) for name in own[key]]
        for letter, key in (("x", "states"), ("u", "inputs"))
    )
    for i, (state, output) in enumerate(zip(own["states"], own["outputs"], strict=True)):
        made.set_rhs(state, 0.9 * x[i] + u[i])
        made.set_meas(output, x[i], meas_noise=True)
    made.setup()
    info = SimpleNamespace(**names)
    with pytest.raises(ValueError, match=f"{noun} of the do-mpc model: .2, .1; they need the order of the plant: .1"):
        refuse_other_order(made, info)
    refuse_other_order(made, SimpleNamespace(**own))
    refuse_other_order(made, None)


def test_a_missing_measurement_is_left_out():
    """NaN in y has no equation: oracle is the problem without it."""
    ys, us = data()
    ys[[2, 7]] = np.nan
    np.testing.assert_allclose(estimated(started(), ys, us), expected(ys, us)[1:], **NEWTON)


def test_a_window_as_long_as_the_run_is_the_kalman_filter():
    """In the loop, where y(0) is not used: the filter gets no information from it."""
    ys, us = data()
    law = small_mhe(model=MODEL, P0=START["P0"], Ts=TS, Ne=K)
    law.start(START["x0"])
    law.update(ys[0], None, 0.0)
    x, P = START["x0"], START["P0"]
    got = estimated(law, ys, us)
    for k in range(K):
        x, P = MODEL.A @ x + MODEL.B @ us[k], MODEL.A @ P @ MODEL.A.T + MODEL.Q_w
        L = P @ MODEL.C.T / (MODEL.C @ P @ MODEL.C.T + MODEL.R_v)
        x, P = x + L @ (ys[k] - MODEL.C @ x), P - L @ MODEL.C @ P
        np.testing.assert_allclose(got[k], x, **NEWTON)


def test_a_plain_loop_repeats_the_oldest_measurement():
    """The first estimates of do-mpc use one measurement several times; later ones are those of the adapter."""
    ys, us = data()
    mhe, right = plain(), expected(ys, us)
    got = np.array([mhe.make_step(np.concatenate(pair)[:, None]).ravel() for pair in zip(ys, us, strict=True)])
    assert np.abs(got[0] - right[1]).max() > 0.1
    np.testing.assert_allclose(estimated(started(), ys, us)[0], right[1], **NEWTON)


def test_y_belongs_to_the_input_before_it():
    """A plain call with y(k) and u(k) instead of u(k-1) is another estimate."""
    ys, us = data()
    wrong = estimated(started(), ys, np.roll(us, -1, axis=0))
    assert np.abs(wrong - expected(ys, us)[1:]).max() > 0.1


@pytest.mark.parametrize("failing", [2, NE, 9])
def test_after_a_failed_step_the_window_has_moved_on(failing):
    """The arrival cost then takes the smoothed state one sample later, and no number of the failed step stays."""
    ys, us = data()
    law, got = started(), []
    solve = law.mhe.solve

    def fail():
        solve()
        law.mhe.opt_x_num.master[:] = np.nan
        law.mhe.solver_stats = {"success": False, "return_status": "Maximum_Iterations_Exceeded", "t_wall_total": 0.0}

    path, began = np.array([START["x0"]]), 0
    for k in range(1, K + 1):
        law.mhe.solve = fail if k == failing else solve
        if k == failing:
            with pytest.raises(SolverError, match="Maximum_Iterations_Exceeded"):
                law.update(ys[k - 1], us[k - 1], k * TS)
            continue
        got.append(law.update(ys[k - 1], us[k - 1], k * TS))
        begin = max(0, k - NE)
        x_prev = START["x0"] if begin == 0 else path[begin - began]
        path, began = batch(x_prev, ys[begin:k], us[begin:k]), begin
        np.testing.assert_allclose(got[-1], path[-1], **NEWTON)


def test_in_the_loop_alone_and_in_a_block():
    """It is near the Kalman filter, which also uses y(0); a run alone has the bits of a run in a block."""
    law = designed("estimators", small_mhe)
    block = simulated(experiment(estimator=law))
    alone = simulated(experiment(estimator=law), 1)
    assert (block[0] == Status.OK).all()
    np.testing.assert_array_equal(block[2]["x_hat"], alone[2]["x_hat"])
    filtered = simulated(experiment(estimator=kalman(MODEL, 12, **START)))[2]["x_hat"]
    assert 1e-3 < np.abs(block[2]["x_hat"] - filtered)[:, -1].max() < 0.5


def test_the_history_does_not_grow():
    """A plain loop keeps every sample; the adapter one window."""
    ys, us = data()
    law, mhe = started(), plain()
    for pair in zip(ys, us, strict=True):
        mhe.make_step(np.concatenate(pair)[:, None])
    estimated(law, ys, us)
    assert len(mhe.data["_y"]) == K
    assert {len(getattr(law.mhe.data, name)) for name in law.mhe.data.data_fields} <= {0, NE}


def test_a_held_run_goes_on():
    """A solver that never converges: the run stops at its first step, or goes on with predictions of the model."""

    def hopeless(model, P0):
        mhe = do_mpc_library().estimator.MHE(do_mpc_model(model))
        mhe.settings.n_horizon = 3
        mhe.settings.nlpsol_opts = {"ipopt.max_iter": 0}
        mhe.set_default_objective(np.eye(2), np.eye(1), P_w=np.eye(2))
        return mhe

    law = do_mpc_estimator(hopeless)
    stopped = simulated(experiment(estimator=designed("estimators", law), n_runs=2))
    assert set(stopped[0]) == {Status.NOT_CONVERGED}
    held = simulated(experiment(estimator=designed("estimators", law, on_failure="hold", max_held=1.0), n_runs=2))
    assert set(held[0]) == {Status.OK}
    x, u = held[2]["x_hat"][0], held[2]["u"][0]
    np.testing.assert_allclose(x[1:], x[:-1] @ MODEL.A.T + u[: len(x) - 1] @ MODEL.B.T, rtol=1e-12, atol=1e-12)


def oscillator(kind, Ts):
    """Return a do-mpc model of x'' = u - x - x' / 2, continuous or sampled."""
    do_mpc = do_mpc_library()
    A, B = np.array([[0.0, 1.0], [-1.0, -0.5]]), np.array([[0.0], [1.0]])
    if kind == "discrete":
        sampled = expm(Ts * np.block([[A, B], [np.zeros((1, 3))]]))
        A, B = sampled[:2, :2], sampled[:2, 2:]
    made = do_mpc.model.Model(kind, "SX")
    x, u = (made.set_variable(f"_{name}", name, shape=(n, 1)) for name, n in (("x", 2), ("u", 1)))
    made.set_rhs("x", A @ x + B @ u)
    made.set_meas("y", x[0], meas_noise=True)
    made.set_meas("u", u, meas_noise=False)
    made.setup()
    return made


def test_a_continuous_model_with_scaled_states():
    """Collocation of degree 6 against the sampled model; both have no process noise."""

    def scaled(model, kind: str = "discrete", scale: float = 1.0):
        mhe = do_mpc_library().estimator.MHE(oscillator(kind, TS))
        mhe.settings.n_horizon, mhe.settings.collocation_deg = NE, 6
        mhe.scaling["_x", "x"] = scale
        mhe.set_default_objective(np.eye(2), 25.0 * np.eye(1))
        return mhe

    got = []
    for kind, scale in (("discrete", 1.0), ("discrete", 3.0), ("continuous", 3.0)):
        law = do_mpc_estimator(scaled)(model=MODEL, Ts=TS, kind=kind, scale=scale)
        law.start(START["x0"])
        got.append(estimated(law, *data()))
    np.testing.assert_allclose(got[1], got[0], **NEWTON)
    # The error of the collocation; measured: 1.4e-8.
    np.testing.assert_allclose(got[2], got[0], rtol=0, atol=1e-6)


def test_measurements_without_noise_are_refused():
    """Their equations could not be left out before the window is full."""

    def exact(model):
        do_mpc = do_mpc_library()
        made = do_mpc.model.Model("discrete", "SX")
        x = made.set_variable("_x", "x", shape=(2, 1))
        made.set_rhs("x", MODEL.A @ x, process_noise=True)
        made.set_meas("y", x[0], meas_noise=False)
        made.setup()
        mhe = do_mpc.estimator.MHE(made)
        mhe.settings.n_horizon = 3
        mhe.set_default_objective(np.eye(2), P_w=np.eye(2))
        return mhe

    with pytest.raises(ValueError, match="1, of which 0 have noise; needed are 1 outputs with noise"):
        do_mpc_estimator(exact)(model=MODEL, Ts=TS)
