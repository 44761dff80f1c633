"""The predictor that is told every F: against a plain loop, filterpy, one big Gaussian, its limit and its errors."""

import numpy as np
import pytest
from conftest import STAT, random_model, random_psd, within_stat
from estimators.uncertain_oracles import P0, X0, benchmark
from filterpy.kalman import KalmanFilter
from plants.uncertain_twin import NAMES, SIZES, at, random_given, true_matrices

from rmpc_bench.estimators import kalman, kalman_predictor, oracle
from rmpc_bench.models import uncertain_linear as models
from rmpc_bench.plants import uncertain_linear as plants
from rmpc_bench.plants.uncertain_linear import Uncertainty
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.types import DesignError, Method, Plant

STEPS = 9
SYSTEMS = pytest.mark.parametrize("sizes", SIZES, ids=lambda sizes: f"nx={sizes['nx']}")
VARIES = pytest.mark.parametrize("n_steps", [0, STEPS], ids=["constant", "varying"])


def world(rng, sizes, n_steps=0, law=None, *, h=0.5, radius=0.7, simple=False):
    """Matrices, plant, model with correlated noises, oracle and start."""
    given = random_given(rng, sizes, n_steps, h=h, radius=radius)
    if simple:
        given = {name: M * (name not in ("Bv", "Dw", "H_Bv", "H_Dw")) for name, M in given.items()}
    nw, nv = sizes["nw"], sizes["nv"]
    joint = random_psd(rng, nw + nv)
    if simple:
        joint[:nw, nw:] = joint[nw:, :nw] = 0.0
    noises = {"W": joint[:nw, :nw].tolist(), "V": joint[nw:, nw:].tolist(), "S": joint[:nw, nw:].tolist()}
    means = {"wbar": rng.standard_normal(nw).tolist(), "vbar": rng.standard_normal(nv).tolist()}
    plant = plants.design(0.1, STEPS, **given, uncertainty=law or Uncertainty())
    model = models.design(STEPS, **given, **noises, **means)
    start = {"x0": rng.standard_normal(sizes["nx"]), "P0": random_psd(rng, sizes["nx"])}
    return given, plant, model, oracle.design(model, STEPS, plant, **start), start


def befalls(rng, plant, model, start, runs):
    """Draws of some runs that obey the model's laws."""
    delta = plant.draw({}, [np.random.default_rng((3, run)) for run in range(runs)], STEPS)
    mean, joint = model.noise
    n = rng.multivariate_normal(mean, joint, (runs, STEPS + 1))
    x0 = rng.multivariate_normal(start["x0"], start["P0"], runs)
    return Draws(delta, x0, n[..., : plant.nw], n[..., plant.nw :])


def filtered(design, delta, y, u):
    """Estimates (runs, samples, nx) and covariances (runs, samples, nx, nx)."""
    state, x_hats, Ps = design.init(len(y), delta), [], []
    for k in range(y.shape[1]):
        state, estimate = design.correct(k, state, np.ascontiguousarray(y[:, k]))
        x_hats.append(estimate.x_hat)
        Ps.append(estimate.P)
        state = design.predict(k, state, np.ascontiguousarray(u[:, k]))
    return np.stack(x_hats, axis=1), np.stack(Ps, axis=1)


def of_run(given, delta, i, k, nx):
    """True A, [Bw Bv], C, [Dw Dv] of a run at k."""
    T = true_matrices(at(given, k), {c: getattr(delta, f"F_{c}")[i, k] for c in NAMES})
    return T[:nx, :nx], T[:nx, nx:], T[nx:, :nx], T[nx:, nx:]


@SYSTEMS
@VARIES
def test_every_run_is_a_kalman_predictor_with_its_own_matrices(sizes, n_steps, rng):
    """Oracle: textbook covariance form with correlated noises, one run at a time, inputs and means included."""
    given, plant, model, design, start = world(rng, sizes, n_steps)
    draws = befalls(rng, plant, model, start, 4)
    y, u = rng.standard_normal((4, STEPS + 1, plant.ny)), rng.standard_normal((4, STEPS + 1, plant.nu))
    ours, P_ours = filtered(design, draws.delta, y, u)
    mean, joint = model.noise
    for i in range(4):
        x, P = start["x0"], start["P0"]
        for k in range(STEPS + 1):
            np.testing.assert_allclose(ours[i, k], x, rtol=1e-9, atol=1e-9)  # roots against the plain form
            np.testing.assert_allclose(P_ours[i, k], P, rtol=1e-9, atol=1e-9)
            A, B, C, D = of_run(given, draws.delta, i, k, plant.nx)
            N, Y = A @ P @ C.T + B @ joint @ D.T, C @ P @ C.T + D @ joint @ D.T
            K = np.linalg.solve(Y, N.T).T
            x = A @ x + at(given, k)["B"] @ u[i, k] + B @ mean + K @ (y[i, k] - C @ x - D @ mean)
            P = A @ P @ A.T + B @ joint @ B.T - K @ N.T


@pytest.mark.parametrize("number", [0, 1, 3])
@VARIES
def test_filterpy_agrees(number, n_steps, rng):
    """Oracle: filterpy with the matrices of the run at every step; noises without correlation or means."""
    sizes = SIZES[number]
    sizes = {**sizes, "nv": max(sizes["nv"], sizes["ny"]), "v": (1, 1)}
    given, plant, model, _, start = world(rng, sizes, n_steps, simple=True)
    W, V = model.W, model.V
    model = models.design(STEPS, **given, W=W.tolist(), V=V.tolist())
    design = oracle.design(model, STEPS, plant, **start)
    draws = befalls(rng, plant, model, start, 3)
    y, u = rng.standard_normal((3, STEPS + 1, plant.ny)), rng.standard_normal((3, STEPS + 1, plant.nu))
    ours, P_ours = filtered(design, draws.delta, y, u)
    for i in range(3):
        other = KalmanFilter(dim_x=plant.nx, dim_z=plant.ny, dim_u=plant.nu)
        other.x, other.P = start["x0"][:, None].copy(), start["P0"].copy()
        for k in range(STEPS + 1):
            np.testing.assert_allclose(ours[i, k], other.x[:, 0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(P_ours[i, k], other.P, rtol=1e-9, atol=1e-9)
            A, B, C, D = of_run(given, draws.delta, i, k, plant.nx)
            Bw, Dv = B[:, : plant.nw], D[:, plant.nw :]
            other.F, other.H, other.Q, other.R, other.B = A, C, Bw @ W @ Bw.T, Dv @ V @ Dv.T, at(given, k)["B"]
            other.update(y[i, k][:, None])
            other.predict(u=u[i, k][:, None])


@SYSTEMS
def test_it_conditions_one_big_gaussian(sizes, rng):
    """Oracle: x(k) given y(0..k-1), from the joint law of x(0) and all noises of one run."""
    given, plant, model, design, start = world(rng, sizes)
    draws = befalls(rng, plant, model, start, 1)
    nx, nn = plant.nx, plant.nw + plant.nv
    mean, joint = model.noise
    centre = np.concatenate([start["x0"], *[mean] * (STEPS + 1)])
    spread = np.zeros((len(centre),) * 2)
    spread[:nx, :nx] = start["P0"]
    state, states, outputs = np.eye(nx, len(centre)), [], []
    for k in range(STEPS + 1):
        A, B, C, D = of_run(given, draws.delta, 0, k, nx)
        here = slice(nx + k * nn, nx + (k + 1) * nn)
        spread[here, here] = joint
        noise = np.zeros((nn, len(centre)))
        noise[:, here] = np.eye(nn)
        states.append(state)
        outputs.append(C @ state + D @ noise)
        state = A @ state + B @ noise
    y = rng.standard_normal((1, STEPS + 1, plant.ny))
    ours, P_ours = filtered(design, draws.delta, y, np.zeros((1, STEPS + 1, plant.nu)))
    for k in range(1, STEPS + 1):
        X, Y = states[k], np.vstack(outputs[:k])
        gain = np.linalg.solve(Y @ spread @ Y.T, Y @ spread @ X.T).T
        expected = X @ centre + gain @ (y[0, :k].ravel() - Y @ centre)
        # The joint covariance of ten samples loses some five digits when it is solved.
        np.testing.assert_allclose(ours[0, k], expected, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(P_ours[0, k], X @ spread @ X.T - gain @ Y @ spread @ X.T, rtol=1e-7, atol=1e-7)


@SYSTEMS
@VARIES
def test_without_uncertainty_it_is_the_kalman_predictor(sizes, n_steps, rng):
    """Oracle: kalman-predictor, whatever F is said to be."""
    _, plant, model, design, start = world(rng, sizes, n_steps, h=0.0)
    theirs = kalman_predictor.design(model, STEPS, **start)
    draws = befalls(rng, plant, model, start, 3)
    y, u = rng.standard_normal((3, STEPS + 1, plant.ny)), rng.standard_normal((3, STEPS + 1, plant.nu))
    ours, P_ours = filtered(design, draws.delta, y, u)
    state = theirs.init(3)
    for k in range(STEPS + 1):
        state, estimate = theirs.correct(k, state, y[:, k])
        np.testing.assert_allclose(ours[:, k], estimate.x_hat, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(P_ours[:, k], np.broadcast_to(estimate.P, P_ours[:, k].shape), atol=1e-9)
        state = theirs.predict(k, state, u[:, k])


@pytest.mark.parametrize("number", [1, 2, 3])
@VARIES
def test_its_errors_have_the_covariance_it_believes(number, n_steps, rng):
    """Oracle: simulation of 1000 runs: errors have mean 0, products of errors that of the run's own P, within STAT."""
    _, plant, model, design, start = world(rng, SIZES[number], n_steps, Uncertainty("uniform", -0.5, 1.0))
    draws = befalls(rng, plant, model, start, 1000)
    method = Method("oracle", design, Rest(plant.nu))
    record, status = simulate(plant, method, draws, np.zeros((STEPS + 1, plant.ny)), STEPS, with_P=True)
    assert not status.any() and record.P.shape == (1000, STEPS + 1, plant.nx, plant.nx)
    e = record.x - record.x_hat
    assert within_stat(e, 0.0)
    assert within_stat(e[..., :, None] * e[..., None, :] - record.P, 0.0)


def test_who_is_told_does_better(rng):
    """Oracle: paired errors of the Kalman predictor of the nominal system on the same runs."""
    _, plant, model, design, start = world(rng, SIZES[1])
    draws = befalls(rng, plant, model, start, 1000)
    errors = []
    for estimator in (design, kalman_predictor.design(model, STEPS, **start)):
        record, _ = simulate(
            plant, Method("m", estimator, Rest(plant.nu)), draws, np.zeros((STEPS + 1, plant.ny)), STEPS
        )
        errors.append(((record.x - record.x_hat) ** 2).sum(axis=2).mean(axis=1))
    difference = errors[1] - errors[0]
    assert difference.mean() > 5.0 * difference.std() / np.sqrt(1000)


@pytest.mark.parametrize("ny", [1, 2])
def test_an_output_that_says_nothing_moves_nothing(ny):
    """Oracle: C = 0 without noise, or P = 0: the gain is zero, and all stays a number."""
    C = np.zeros((1, ny, 2))
    plant = plants.design(0.1, STEPS, A=[0.5, 0.5], C=C, Bw=1.0, Dv=np.eye(ny)[None])
    model = models.design(STEPS, A=[0.5, 0.5], C=C, Bw=1.0, Dv=np.eye(ny)[None], W=1.0, V=0.0)
    design = oracle.design(model, STEPS, plant, x0=np.ones(2), P0=np.eye(2))
    delta = plant.draw({}, [np.random.default_rng(1)], STEPS)
    x_hat, P = filtered(design, delta, np.ones((1, STEPS + 1, ny)), np.zeros((1, STEPS + 1, 1)))
    np.testing.assert_allclose(x_hat[0, :, 0], 0.5 ** np.arange(STEPS + 1.0), rtol=1e-12)
    np.testing.assert_allclose(P[0, :, 0, 0], 4 / 3 - 0.25 ** np.arange(STEPS + 1.0) / 3, rtol=1e-12)


@pytest.mark.parametrize("ny", [1, 2])
def test_a_covariance_without_bounds_fails_its_runs_and_not_the_block(ny):
    """Oracle: a run may fail, a block may not: 3^(2k) leaves the range of numbers at k = 323; C sees nothing of it."""
    n_steps = 400
    C = np.zeros((1, ny, 2))
    C[0, :, 0] = 1.0
    parts = {"A": [0.5, 3.0], "C": C, "Bw": 1.0, "Dv": np.eye(ny)[None], "H_A": 0.1, "G_x": 1.0}
    plant, model = plants.design(0.1, n_steps, **parts), models.design(n_steps, **parts, W=1.0, V=1.0)
    design = oracle.design(model, n_steps, plant, x0=np.zeros(2), P0=np.eye(2))
    rng = np.random.default_rng(1)
    delta = plant.draw({}, [np.random.default_rng(run) for run in range(3)], n_steps)
    shapes = ((3, n_steps + 1, n) for n in (2, ny))
    draws = Draws(delta, np.zeros((3, 2)), *(rng.standard_normal(shape) for shape in shapes))
    _, status = simulate(plant, Method("g", design, Rest(1)), draws, np.zeros((n_steps + 1, ny)), n_steps)
    assert status.all()


def test_what_has_no_uncertain_matrices_is_refused(rng):
    """Oracle: words; a plain model, a plant of another kind, other sizes of noises."""
    _, plant, model, _, start = world(rng, SIZES[1])
    for wrong in ((random_model(rng, 2, 1, 1), plant), (model, Plant())):
        with pytest.raises(DesignError, match="uncertain matrices"):
            oracle.design(wrong[0], STEPS, wrong[1], **start)
    _, other, _, _, _ = world(rng, {**SIZES[1], "nw": 3})
    with pytest.raises(DesignError, match="nw is 3 and 2"):
        oracle.design(model, STEPS, other, **start)


def test_it_is_marked_as_an_oracle_estimator(rng):
    """Oracle: house rule: an oracle estimator says so, and gets the F of every run."""
    _, plant, model, design, start = world(rng, SIZES[2])
    assert design.knows_uncertainty is True
    draws = befalls(rng, plant, model, start, 2)
    state = design.init(2, draws.delta)
    for F, given in zip((state.F_x, state.F_w, state.F_v), draws.delta, strict=True):
        np.testing.assert_array_equal(F, given)


@pytest.mark.parametrize(("low", "floor"), [(-1.0, (4.104, 2.841)), (0.0, (4.929, 8.824))])
def test_the_published_floor_of_the_benchmark(low, floor):
    """Oracle: the reference study section 7, from 20000 runs of an independent study; here the mean P of 1000 runs.

    The published numbers are variances of errors, so sqrt(2 / 20000) = 1 % is their standard error.
    """
    model = benchmark(100)
    given = {name: np.array(M) for name, M in model.system.over_time._asdict().items()}
    plant = plants.design(1.0, 100, **given, uncertainty=Uncertainty("uniform", low, 1.0))
    design = oracle.design(model, 100, plant, x0=X0, P0=P0)
    delta = plant.draw({}, [np.random.default_rng((8, run)) for run in range(1000)], 100)
    state = design.init(1000, delta)
    for k in range(101):
        state, estimate = design.correct(k, state, np.zeros((1000, 1)))
        state = design.predict(k, state, np.zeros((1000, 1)))
    P = estimate.P[:, [0, 1], [0, 1]]
    se = P.std(axis=0) / np.sqrt(1000)
    assert (np.abs(P.mean(axis=0) - floor) <= STAT * np.hypot(se, np.array(floor) / 100)).all()


@SYSTEMS
def test_as_a_filter_without_uncertainty_it_is_the_kalman_filter(sizes):
    """Oracle: the Kalman filter on the nominal model, F = 0, independent noises; in this form x_hat(k) uses y(k)."""
    rng = np.random.default_rng(8)
    _, plant, model, _, start = world(rng, sizes, law=Uncertainty("fixed", value=0.0), simple=True)
    design = oracle.design(model, STEPS, plant, **start, form="filter")
    known = kalman.design(model, STEPS, **start)
    delta = plant.draw({}, [np.random.default_rng(run) for run in range(3)], STEPS)
    y, u = rng.standard_normal((3, STEPS + 1, sizes["ny"])), rng.standard_normal((3, STEPS + 1, plant.nu))
    x_hat, P = filtered(design, delta, y, u)
    state = known.init(3)
    for k in range(STEPS + 1):
        state, estimate = known.correct(k, state, np.ascontiguousarray(y[:, k]))
        np.testing.assert_allclose(x_hat[:, k], estimate.x_hat, rtol=1e-9, atol=1e-9)  # other orders of the same sums
        np.testing.assert_allclose(P[:, k], np.broadcast_to(estimate.P, P[:, k].shape), rtol=1e-9, atol=1e-9)
        state = known.predict(k, state, np.ascontiguousarray(u[:, k]))
