"""Loops that are not stable: the remark in check, run and the table, and stationary gains that do not stabilise."""

import forked_commands
import numpy as np
import pytest

from rmpc_bench.adapters import control_gains
from rmpc_bench.diagnostics.stability import loop_remarks
from rmpc_bench.estimators import kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.types import DesignError

CONFIG = """
version: 1
name: loop
runs: 2
time: {step: 0.1, steps: 25}
plant: {kind: linear, A: [[1.6, -0.64], [1, 0]], B: [[1], [0]], C: [[-1, 1.3]]}
model: {kind: linear, A: [[1.6, -0.64], [1, 0]], B: [[1], [0]], C: [[-1, 1.3]], P_w: 0.0001, P_v: 0.0001}
noise: same
reference: {kind: constant, value: 1}
metrics: [{kind: mse}]
methods:
  short: {estimator: {kind: kalman}, controller: {kind: mpc, Hp: 1, Hu: 1, Q: 1, R: 1.0e-4}}
  long: {estimator: {kind: kalman}, controller: {kind: mpc, Hp: 20, Hu: 3, Q: 1, R: 0.1}}
  pid: {estimator: {kind: kalman}, controller: {kind: pid, Kp: 0.1}}
"""
"""The zero of the plant is 1.3: the law with Hp = 1 inverts the plant, and u grows by 1.3 in every step."""


def test_a_loop_that_is_not_stable_is_named(tmp_path):
    """Oracle: the pole 1.29999556 of the closed loop, from its characteristic polynomial."""
    path = tmp_path / "loop.yaml"
    path.write_text(CONFIG)
    text = "is not stable: its spectral radius is 1.29999556"
    checked = forked_commands.run(["check", path, "--deep"], tmp_path).stdout
    checked = " ".join(checked.split())
    assert f"methods.short.controller: the closed loop with the design model, without limits, {text}" in checked
    assert "methods.long" not in checked and "no linear law" not in checked
    assert text in forked_commands.run(["run", path, "-o", tmp_path / "out"], tmp_path).stderr
    assert text in (tmp_path / "out" / "tables" / "summary.md").read_text()


def test_laws_that_are_not_linear_have_no_remark():
    """A law without gains is not judged."""
    model = LinearModel(2.0 * np.eye(1), np.eye(1), np.eye(1), np.eye(1), np.eye(1))
    filter_ = kalman.design(model, 3, x0=np.zeros(1), P0=np.eye(1))

    assert loop_remarks(model, filter_, Rest(1)) == ()


@pytest.mark.parametrize("kind", ["lqe", "lqr"])
def test_gains_without_a_stabilising_solution_are_refused(kind):
    """Oracle: a double integrator without process noise, or without weight, has the solution 0, which moves nothing."""
    pytest.importorskip("control")
    A, B, C = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]])
    model = LinearModel(A, B, C, np.zeros((2, 2)), np.eye(1))
    filter_ = kalman.design(model, 3, x0=np.zeros(2), P0=np.eye(2))
    with pytest.raises(DesignError, match="stabilising solution|no stationary gain"):
        if kind == "lqe":
            control_gains.lqe(model, 3, x0=np.zeros(2))
        else:
            control_gains.lqr(model, 3, filter_, Q_x=0.0, R_u=1.0)
