"""MPC of do-mpc in the loop: the numbers of the built-in one and of a bounded least-squares problem."""

from pathlib import Path

import numpy as np
import pytest
import small_experiment
from adapters.do_mpc_laws import small_mpc
from components.one_run import MODEL, TS, designed, experiment, simulated
from controllers.predictions import predict_moves
from scipy.optimize import lsq_linear

from rmpc_bench import load_config
from rmpc_bench.config_file import factories
from rmpc_bench.extras import is_installed
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import Status

if not is_installed("do-mpc"):
    pytest.skip("do-mpc is not installed", allow_module_level=True)

TESTS = Path(__file__).parents[1]
VOLTS = {"rtol": 0.0, "atol": 1e-9}
"""One Newton step of the solver against a closed form; the inputs of the servo are about 100 V."""
BARRIER = {"rtol": 0.0, "atol": 1e-5}
"""An interior-point method stays away from a limit by up to the root of its last barrier parameter, about 1e-9."""
TANKS = """
version: 1
name: tanks
runs: 1
time: {step: 3, duration: 30}
plant:
  ode: plants/tanks.py:rhs
  output: plants/tanks.py:output
  states: {h1: m, h2: m}
  inputs: {pump: ml/s}
  outputs: {level: m}
  parameters: {a1: 7.1e-6, a2: 6.3e-6, k: 1}
  solver: {method: rk4, substeps: 1}
model: {linearise: plant, at: {u: 8, guess: 0.1}, noise: {process: 1e-6, measurement: 4e-6}}
initial: {x: [0.06, 0.09], x_hat: [0.06, 0.09], P: 1e-4}
reference: {kind: square, values: [0.1, 0.12], period: 18}
methods:
  built-in: {controller: {kind: mpc, Hp: 6, Hu: 6, Q: 1, R: 1e-5}}
  do-mpc: {controller: {file: adapters/do_mpc_laws.py:small_mpc, R: 1e-5, preview: 7}}
  held: {controller: {file: adapters/do_mpc_laws.py:small_mpc, R: 1e-5}}
  nonlinear:
    model: {nonlinear: plant, at: {u: 8, guess: 0.1}, noise: {process: 1e-6, measurement: 4e-6}}
    controller: {file: adapters/do_mpc_laws.py:small_mpc, R: 1e-5, preview: 7}
estimator: {kind: kalman}
metrics: [mse]
record: {runs: 1, signals: [u, y]}
"""


def traces(path, n_runs, signal="u"):
    """Return a signal of every method of a configuration that uses files of the tests."""
    made = load_config(path, allow_code=[TESTS]).experiment
    return {each.name: simulate_block(made, each, range(n_runs)).traces[signal] for each in made.methods}


def test_without_limits_it_is_the_built_in_mpc():
    """Oracle: the closed form of `mpc` with Hu = Hp, in a loop of 12 samples with noise in six runs."""
    built_in = factories.controller("mpc", MODEL, Hp=6, Hu=6, Q=1.0, R=0.5)
    expected = simulated(experiment(controller=built_in))
    got = simulated(experiment(controller=designed("controllers", small_mpc, preview=7)))
    assert (got[0] == Status.OK).all()
    np.testing.assert_allclose(got[2]["u"], expected[2]["u"], **VOLTS)


def test_it_is_the_built_in_mpc_on_the_servo_of_figure_7(tmp_path):
    """Inputs [V] of two perturbed servos over two seconds, with the weights and scales of zenere2018/fig7.yaml."""
    law = f"{{file: '{TESTS}/adapters/do_mpc_laws.py:servo_mpc', preview: 11}}"
    built_in = "{kind: mpc, Hp: 10, Hu: 10, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi}}"
    keys = {
        "runs": "2",
        "time": "{step: 0.1, duration: 2}",
        "plant": "{kind: servo, perturb: {J_l: 1 + eps}}",
        "noise": "none",
        "controller": None,
        "methods": f"{{expected: {{estimator: {{kind: kalman}}, controller: {built_in}}}, "
        f"got: {{estimator: {{kind: kalman}}, controller: {law}}}}}",
        "record": "{runs: 2, signals: [u]}",
    }
    u = traces(small_experiment.write(tmp_path, **keys), 2)
    assert np.abs(u["expected"]).max() > 50.0
    np.testing.assert_allclose(u["got"], u["expected"], **VOLTS)


def test_a_changing_reference_and_an_operating_point(tmp_path):
    """The moves begin at the input of the operating point; f0 and the reference of the whole horizon are used."""
    path = tmp_path / "tanks.yaml"
    path.write_text(TANKS.replace("plants/", f"{TESTS}/plants/").replace("adapters/", f"{TESTS}/adapters/"))
    u = traces(path, 1)
    np.testing.assert_allclose(u["do-mpc"], u["built-in"], **VOLTS)
    # The reference steps at k = 3 and 6: an MPC that knows r(k) alone does not move before.
    assert np.abs(u["held"] - u["built-in"]).max() > 1.0
    # The nonlinear model is another one, although not by much: the levels move by 2 cm.
    difference = np.abs(u["nonlinear"] - u["built-in"]).max()
    assert 1e-3 < difference < 5.0


def test_with_limits_it_solves_the_bounded_problem():
    """Oracle: bounded least squares over the inputs of the horizon by SciPy."""
    Hp, R, limit = 6, 0.5, 0.3
    law = small_mpc(model=MODEL, Ts=TS, Hp=Hp, R=R, limit=limit, preview=7)
    Psi, Upsilon, Theta = predict_moves(MODEL, Hp, Hp)
    moves = np.eye(Hp) - np.eye(Hp, k=-1)
    rng = np.random.default_rng(0)
    u_previous, at_limit = np.zeros(1), 0
    for k in range(12):
        x, r = rng.standard_normal(2), rng.standard_normal((Hp + 1, 1))
        first = np.eye(Hp)[:, :1] @ u_previous
        matrix = np.vstack([Theta @ moves, np.sqrt(R) * moves])
        wanted = r[1:, 0] - Psi @ x - Upsilon @ u_previous + Theta @ first
        oracle = lsq_linear(matrix, np.concatenate([wanted, np.sqrt(R) * first]), (-limit, limit), tol=1e-14)
        u = law.control(x, r, u_previous if k else None, k * TS)
        np.testing.assert_allclose(u, oracle.x[:1], **BARRIER)
        at_limit += abs(abs(u[0]) - limit) < 1e-6
        u_previous = u
    assert 3 <= at_limit <= 11
