"""MPC of do-mpc in the loop: the numbers of the built-in one, failures, and the YAML of a user."""

from pathlib import Path

import numpy as np
import pytest
import small_experiment
from adapters.do_mpc_laws import small_mpc
from components.one_run import MODEL, designed, experiment, simulated

from rmpc_bench import load_config
from rmpc_bench.components import by_kind
from rmpc_bench.extras import is_installed
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import Status

if not is_installed("do-mpc"):
    pytest.skip("do-mpc is not installed", allow_module_level=True)

TESTS = Path(__file__).parents[1]


def test_without_limits_it_is_the_built_in_mpc():
    """Oracle: the closed form of `mpc` with Hu = Hp, in a loop of 12 samples with noise in six runs."""
    built_in = by_kind.controller("mpc", MODEL, Hp=6, Hu=6, Q=1.0, R=0.5)
    expected = simulated(experiment(controller=built_in))
    got = simulated(experiment(controller=designed("controllers", small_mpc, preview=7)))
    assert (got[0] == Status.OK).all()
    np.testing.assert_allclose(got[2]["u"], expected[2]["u"], rtol=0, atol=1e-9)


def test_it_is_the_built_in_mpc_on_the_servo_of_figure_7(tmp_path):
    """Inputs [V] of two perturbed servos over two seconds; the voltage is about 100 V at the begin."""
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
    made = load_config(small_experiment.write(tmp_path, **keys), allow_code=[TESTS]).experiment
    expected, got = (simulate_block(made, method, range(2)).traces["u"] for method in made.methods)
    assert np.abs(expected).max() > 50.0
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9)
