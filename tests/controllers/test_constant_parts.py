"""Known and estimated means of the noises in every controller and estimator: brute force, and closed loops."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import random_model, random_psd
from controllers.gpc_twin import Varying, dense
from required_keys import REQUIRED

from rmpc_bench import registry
from rmpc_bench.config.load import load_config
from rmpc_bench.controllers import gpc, mpc
from rmpc_bench.controllers.mpc_law import MpcState
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.types import ConfigError, DesignError, Estimate, Estimator, Status

LSTSQ = {"rtol": 1e-9, "atol": 1e-10}  # two factorisations of systems with conditions up to 1e5
SIZES = pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 1, 1), (3, 2, 2), (3, 1, 2)])


class EstimatesMean(Estimator):
    """An estimator that declares an estimate of the mean of the process noise."""

    estimates_mean = True


def with_parts(rng, nx, nu, ny):
    """Random model whose noises have means."""
    m = random_model(rng, nx, nu, ny, 0.9)
    return LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, f0=rng.standard_normal(nx), d0=rng.standard_normal(ny))


def estimate_of(x_hat, w_mean):
    """Estimate with a mean of the process noise."""
    return Estimate(x_hat, None, None, np.zeros(len(x_hat), dtype=np.int8), {"w_mean": w_mean})


def least_squares_input(m, x, u_previous, mean, r, Hu, roots, law):
    """u(k) that minimises the stated cost, by lstsq on predictions that are simulated sample by sample."""
    root_Q, root_R = roots

    def residuals(moves):
        moves = moves.reshape(Hu, m.nu)
        z, u, errors = x, u_previous, []
        for j in range(len(r)):
            if law == "printed":
                u = moves[min(j, Hu - 1)]
            else:
                u = u + (moves[j] if j < Hu else 0.0)
            z = m.A @ z + m.B @ u + m.f0 + mean
            errors.append(root_Q @ (m.C @ z + m.d0 - r[j]))
        return np.concatenate([*errors, (moves @ root_R.T).ravel()])

    at_zero = residuals(np.zeros(Hu * m.nu))
    columns = [residuals(unit) - at_zero for unit in np.eye(Hu * m.nu)]
    found = np.linalg.lstsq(np.array(columns).T, -at_zero, rcond=None)[0][: m.nu]
    return found if law == "printed" else u_previous + found


@SIZES
@pytest.mark.parametrize("law", ["increment", "printed"])
@pytest.mark.parametrize("estimated", [False, True])
def test_mpc_predicts_with_the_means(nx, nu, ny, law, estimated, rng):
    """Oracle: brute force on predictions that are simulated with f0, d0 and the estimated mean."""
    m, Hp, Hu = with_parts(rng, nx, nu, ny), 6, 3
    Q, R = random_psd(rng, ny, 5.0), random_psd(rng, nu, 5.0)
    controller = mpc.design(
        m, EstimatesMean() if estimated else Estimator(), Hp=Hp, Hu=Hu, Q=Q.tolist(), R=R.tolist(), law=law
    )
    x_hat, w_mean, u_previous = (rng.standard_normal((3, n)) for n in (nx, nx, nu))
    r = rng.standard_normal((Hp + 1, ny))
    state = MpcState(u_previous)
    u = controller.control(0, state, np.zeros((3, ny)), estimate_of(x_hat, w_mean), r)[1].u
    roots = [np.linalg.cholesky(weight).T for weight in (Q, R)]
    rows = zip(x_hat, u_previous, w_mean if estimated else np.zeros((3, nx)), strict=True)
    expected = [least_squares_input(m, x, before, mean, r[1:], Hu, roots, law) for x, before, mean in rows]
    np.testing.assert_allclose(u, expected, **LSTSQ)


def test_the_law_of_mpc_is_linear_without_constant_parts_only(rng):
    """Oracle: the definition of `LinearLaw`, which has no constant term but says so."""
    m, keys = random_model(rng, 2, 1, 1), {"Hp": 4, "Hu": 2, "Q": 1.0, "R": 0.1}
    assert not mpc.design(m, Estimator(), **keys).linear_law().affine
    assert mpc.design(with_parts(rng, 2, 1, 1), Estimator(), **keys).linear_law().affine
    assert mpc.design(m, EstimatesMean(), **keys).linear_law() is None


@SIZES
@pytest.mark.parametrize("kind", ["constant", "varying", "tuned"])
def test_gpc_predicts_with_the_estimated_mean(nx, nu, ny, kind, rng):
    """Oracle: (12) by lstsq with f0 plus the estimated mean in every sample; input and loss."""
    m, Np = with_parts(rng, nx, nu, ny), 5
    model = Varying([m] * 20) if kind == "varying" else m
    Q_yw, Q_u = rng.standard_normal((ny, ny)), rng.standard_normal((nu, nu)) + 2.0 * np.eye(nu)
    tuning = {"tuning": LpNoise(Ne2=5)} if kind == "tuned" else {}
    controller = gpc.design(model, None, EstimatesMean(), Np=Np, Q_yw=Q_yw.tolist(), Q_u=Q_u.tolist(), **tuning)
    x_hat, w_mean, r = rng.standard_normal((3, nx)), rng.standard_normal((3, nx)), rng.standard_normal((Np + 1, ny))
    command = controller.control(0, controller.init(3), np.zeros((3, ny)), estimate_of(x_hat, w_mean), r)[1]
    expected = [
        dense(m.A, m.B, m.f0 + mean, m.C, Q_yw, Q_u, r[1:] - m.d0, x) for x, mean in zip(x_hat, w_mean, strict=True)
    ]
    np.testing.assert_allclose(command.u, [u for u, _ in expected], **LSTSQ)
    np.testing.assert_allclose(command.info["loss"], [loss for _, loss in expected], **LSTSQ)


def test_lqr_uses_an_estimated_mean_unless_it_is_told_otherwise(rng):
    """Oracle: lqr with the mean given explicitly."""
    m, keys = random_model(rng, 2, 1, 1), {"horizon": 5, "Q_x": 1.0, "R_u": 0.1}
    estimate = estimate_of(rng.standard_normal((3, 2)), rng.standard_normal((3, 2)))
    for estimator, mean in ((EstimatesMean(), "estimated"), (Estimator(), "known")):
        ours, theirs = lqr(m, 4, estimator, **keys), lqr(m, 4, estimator, **keys, mean=mean)
        np.testing.assert_array_equal(ours.input_of(0, estimate), theirs.input_of(0, estimate))


A, B, C = [[0.9, 0.2], [0.0, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]]
W_MEAN, V_MEAN = [0.1, 0.5], [2.0]
PARTS = {"A": A, "B": B, "C": C}
MODELS = {
    "linear": {"kind": "linear", **PARTS, "P_w": 0.01, "P_v": 0.01},
    "uncertain-linear": {"kind": "uncertain-linear", **PARTS, "Bw": 1, "Dv": 1, "W": 0.01, "V": 0.01},
}
MEANS = {"linear": ("w_mean", "v_mean"), "uncertain-linear": ("wbar", "vbar")}
ESTIMATORS = {kind: REQUIRED.get(kind, {}) for kind in registry.names("estimators")} | {
    "robust-h-infinity": {"alpha": 1.0},
    "kalman-disturbance": {"drift": 0.01},
    "moving-horizon": {"window": 3},
    "nonlinear-moving-horizon": {"window": 3},
}
"""Keys of every estimator."""
CONTROLLERS = {
    "mpc": {"Hp": 10, "Hu": 3, "Q": 1, "R": 0.1},
    "gpc": {"Np": 10, "Q_yw": 1, "Q_u": 0.001},
    "lqr": {"horizon": 20, "Q_x": 1, "R_u": 0.001},
    "minimax-lq": {"horizon": 5, "Q_x": 1, "R_u": 0.1},
    "game-gain": {"horizon": 5, "Q_x": 1, "R_u": 0.1},
    "control-lqr": {"Q_x": 1, "R_u": 0.001},
    "lqg": {"Q_x": 1, "Q_i": 0.01, "R_u": 0.001},
    "pid": {"Kp": 0.1, "Ki": 0.1},
    "tube-mpc": {"horizon": 5, "Q_x": 1, "R_u": 0.1, "limits": {"u": [-100, 100]}, "tightening": "none"},
}
"""Keys of controllers that use a mean or refuse it."""


def loaded(tmp_path, estimator, controller, *, model="linear", reference=1.0, known=True):
    """Configuration of a plant whose noises are constant: W_MEAN and V_MEAN."""
    means = dict(zip(MEANS[model], (W_MEAN, V_MEAN), strict=True)) if known else {}
    plant = {"kind": model, **PARTS} if model == "linear" else {"kind": model, **PARTS, "Bw": 1, "Dv": 1}
    v_mean = V_MEAN if known else [0.0]
    tree = {
        "version": 1, "name": "means", "runs": 1, "time": {"steps": 300}, "plant": plant,
        "model": MODELS[model] | means,
        "noise": {
            "process": {"gaussian": {"mean": W_MEAN, "std": 0}},
            "measurement": {"gaussian": {"mean": v_mean, "std": 0}},
        },
        "initial": {"x": 0, "x_hat": 0, "P": 0.01}, "reference": {"kind": "constant", "value": reference},
        "estimator": estimator, "controller": controller, "methods": {"M": {}}, "metrics": ["input_power"],
        "figures": [],
    }  # fmt: skip
    path = tmp_path / "means.yaml"
    path.write_text(json.dumps(tree), encoding="utf-8")
    return load_config(path).experiment


def simulated(experiment):
    """Signals of the only run."""
    method = experiment.methods[0]
    r = experiment.scenario.reference.sample(experiment.n_steps + 1 + method.controller.preview)
    draws = experiment.scenario.draw(experiment.plant, range(1), experiment.n_steps)
    record, status = simulate(experiment.plant, method, draws, r, experiment.n_steps)
    assert status.tolist() == [Status.OK]
    return record


@pytest.mark.parametrize("kind", sorted(ESTIMATORS))
def test_every_estimator_uses_the_known_means(kind, tmp_path):
    """Oracle: from the true initial state, without deviation from the means, every estimate is the true state.

    The control loop then follows the reference 1, while y without the mean of v does.
    """
    model = "uncertain-linear" if kind == "oracle" else "linear"
    controller = {"kind": "mpc", **CONTROLLERS["mpc"]}
    record = simulated(loaded(tmp_path, {"kind": kind, **ESTIMATORS[kind]}, controller, model=model))
    np.testing.assert_allclose(record.x_hat, record.x, atol=1e-7)  # 1e-8 is the accuracy of a linear program
    np.testing.assert_allclose(record.x[0, -1, 0] + V_MEAN[0], 1.0, atol=1e-6)


@pytest.mark.parametrize("kind", ["mpc", "gpc", "lqr", "lqg"])
@pytest.mark.parametrize("estimator", ["kalman", "kalman-disturbance"])
def test_controllers_that_use_a_mean_reach_their_target(kind, estimator, tmp_path):
    """Oracle: y = C x + d0 = r, or the least quadratic cost of a steady state, solved as a linear system.

    With `kalman` the mean of w is known, with `kalman-disturbance` it is estimated: the model has none.
    """
    known = estimator == "kalman"
    keys = {"drift": 0.01} if not known else {}
    reference = 0.0 if kind == "lqr" else 1.0
    experiment = loaded(
        tmp_path, {"kind": estimator, **keys}, {"kind": kind, **CONTROLLERS[kind]}, reference=reference, known=known
    )
    x, u = (signal[0, -1] for signal in (simulated(experiment).x, simulated(experiment).u))
    d0 = V_MEAN[0] if known else 0.0
    if kind == "lqr":  # R_u is small: (nearly) the steady state with the least |x|, by least squares over u
        gain, free = np.linalg.solve(np.eye(2) - A, np.hstack([B, np.array(W_MEAN)[:, None]])).T
        best = gain * (-(gain @ free) / (gain @ gain)) + free
        np.testing.assert_allclose(x @ x, best @ best, rtol=0.2)  # a receding horizon is not the steady optimum
    else:
        # The cost of gpc weighs u(k) by 1e-6, which moves y by about that.
        np.testing.assert_allclose(x[0] + d0, 1.0, atol=1e-3 if kind == "gpc" else 1e-6)
    assert np.isfinite(u).all()


@pytest.mark.parametrize("kind", ["minimax-lq", "game-gain", "control-lqr", "tube-mpc"])
@pytest.mark.parametrize(("estimator", "known"), [("kalman", True), ("kalman-disturbance", False)])
def test_controllers_that_ignore_a_mean_refuse_it(kind, estimator, known, tmp_path):
    """Oracle: the key to blame and the way out."""
    with pytest.raises(ConfigError, match=r": controller: does not support .* mean of the process noise"):
        loaded(tmp_path, {"kind": estimator}, {"kind": kind, **CONTROLLERS[kind]}, reference=0.0, known=known)


@pytest.mark.parametrize(("f0", "d0"), [([0.5], [0.0]), ([0.0], [2.0])])
def test_mpc_follows_the_reference_with_one_constant_part(f0, d0):
    """Oracle: y = 1 in steady state; without the constant parts y settled above 1.1 and at 3.0."""
    m = LinearModel([[0.8]], [[1.0]], [[1.0]], 1.0, 1.0, f0=np.array(f0), d0=np.array(d0))
    controller = mpc.design(m, Hp=10, Hu=3, Q=1.0, R=0.1)
    x, state = np.zeros((1, 1)), controller.init(1)
    for k in range(200):
        y = x + m.d0
        state, command = controller.control(k, state, y, estimate_of(x, 0.0 * x), np.ones((11, 1)))
        x = x @ m.A.T + command.u @ m.B.T + m.f0
    np.testing.assert_allclose(x + m.d0, 1.0, rtol=1e-9)


def test_gpc_refuses_an_estimated_mean_with_a_state_dependent_model():
    """Oracle: the message."""
    from controllers.gpc_twin import Swing

    with pytest.raises(DesignError, match="estimated mean of the process noise"):
        gpc.design(Swing(), 5, EstimatesMean(), Np=3, Q_yw=1.0, Q_u=1.0)


def test_an_estimated_mean_removes_the_offset_of_the_servomechanism():
    """Oracle: the reference; without the estimated mean dry friction left an error of -0.058 rad after 35 s."""
    change = "methods.S-MPC.estimator={kind: kalman-disturbance, drift: 1}"
    config = load_config(Path(__file__).parents[2] / "configs/zenere2018/sim2.yaml", overrides=[change])
    record = simulated(config.experiment)
    np.testing.assert_allclose(record.y[0, -1], np.pi / 2, atol=1e-6)
