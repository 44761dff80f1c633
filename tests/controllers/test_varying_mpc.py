"""mpc on models that vary with k: gains per k from the matrices along the horizon."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_model
from controllers.gpc_twin import Varying, estimate_of
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.controllers.mpc import design
from rmpc_bench.controllers.mpc_law import Mpc, MpcState
from rmpc_bench.estimators import kalman_disturbance
from rmpc_bench.types import ConfigError, DesignError

MPC = "{kind: mpc, Hp: 3, Hu: 2, Q: 1, R: 0.5}"
KEYS = {
    "plant": '{kind: linear, A: [["1 + 0.1*k"]], B: 1, C: 1}',
    "model": '{kind: linear, A: [["1 + 0.1*k"]], B: 1, C: 1, P_w: 1, P_v: 1}',
    "initial": "{x: 1, x_hat: 1, P: 1}",
    "noise": "none",
    "time": "{steps: 4}",
    "reference": "{kind: constant, value: 1}",
    "methods": f"{{M: {{estimator: {{kind: kalman}}, controller: {MPC}}}}}",
    "metrics": "[mse]",
}


class Changing(Varying):
    """Models of k; an error beyond the last one, as of design models."""

    varies = True

    def at(self, k):
        """The model at k."""
        if k >= len(self.models):
            raise DesignError("no model")
        return self.models[k]


def law_of(tmp_path, **keys):
    """The controller of a configuration."""
    return load_config(write_estimation(tmp_path, **(KEYS | keys))).experiment.methods[0].controller


def commanded(law, k, x_hat, u_previous, r):
    """u(k) of one run."""
    return law.control(
        k, MpcState(np.array([u_previous])), np.zeros((1, r.shape[1])), estimate_of(np.array([x_hat])), r
    )[1].u[0]


def test_the_values_of_a_scalar_model(tmp_path):
    """Oracle: the values of the closed form at two k, and a step of the loop at k = 0."""
    law = law_of(tmp_path)
    np.testing.assert_allclose(commanded(law, 0, [1.0], [0.0], np.zeros((4, 1))), -0.576782670, **SOLVER)
    np.testing.assert_allclose(commanded(law, 2, [1.0], [0.2], np.ones((4, 1))), -0.168933906, **SOLVER)
    np.testing.assert_allclose(commanded(law, 2, [1.0], [-0.2], np.ones((4, 1))), -0.229109958, **SOLVER)
    assert not law.has_compiled_form and law.linear_law() is None


def best(models, k, x, u, r, Hp, Hu, R):
    """First move by least squares on outputs that are simulated sample by sample."""

    def residuals(moves):
        z, v, rows = x, u, []
        for j in range(Hp):
            v = v + moves[j] if j < Hu else v
            now, then = (models[min(k + i, len(models) - 1)] for i in (j, j + 1))
            z = now.A @ z + now.B @ v + now.f0
            rows.append(then.C @ z + then.d0 - r[j + 1])
        return np.concatenate([np.ravel(rows), np.sqrt(R) * moves.ravel()])

    zero = residuals(np.zeros((Hu, len(u))))
    columns = [residuals(e.reshape(Hu, -1)) - zero for e in np.eye(Hu * len(u))]
    return u + np.linalg.lstsq(np.transpose(columns), -zero, rcond=None)[0][: len(u)]


@pytest.mark.parametrize("kind", ["plain", "means"])
def test_the_law_of_every_k_minimises_the_cost(kind, rng):
    """Oracle: least squares on simulated outputs; beyond the last model that one holds."""
    n, Hp, Hu = 5, 4, 2
    models = [random_model(rng, 3, 2, 2) for _ in range(n)]
    if kind == "means":
        parts = [{"f0": rng.standard_normal(3), "d0": rng.standard_normal(2)} for _ in models]
        models = [type(m)(m.A, m.B, m.C, m.Q_w, m.R_v, **each) for m, each in zip(models, parts, strict=True)]

    law = design(Changing(models), n_steps=n, Hp=Hp, Hu=Hu, Q=1.0, R=0.3)
    for k in range(n):
        x, u, r = rng.standard_normal(3), rng.standard_normal(2), rng.standard_normal((Hp + 1, 2))
        np.testing.assert_allclose(commanded(law, k, x, u, r), best(models, k, x, u, r, Hp, Hu, 0.3), **SOLVER)


def test_a_model_that_does_not_change_is_the_constant_law(rng):
    """Oracle: the law of the constant model."""
    m = random_model(rng, 3, 2, 2)
    keys = {"Hp": 4, "Hu": 2, "Q": 1.0, "R": 0.3}
    varying, constant = design(Changing([m] * 20), n_steps=6, **keys), design(m, **keys)
    assert type(constant) is Mpc
    for name in ("K_x", "K_u", "K_r"):
        np.testing.assert_allclose(getattr(varying.laws[3], name), getattr(constant, name), **ROUND)


def test_an_estimated_mean_and_limits(rng):
    """Oracle: the mean adds to every step of the prediction; the input is clipped."""
    m = random_model(rng, 2, 1, 1)
    filter_ = kalman_disturbance.design(m, 3, x0=np.zeros(2), P0=np.eye(2))
    law = design(Changing([m] * 20), filter_, n_steps=3, Hp=4, Hu=2, Q=1.0, R=0.3)
    x, u, r, mean = rng.standard_normal(2), rng.standard_normal(1), rng.standard_normal((5, 1)), rng.standard_normal(2)
    estimate = estimate_of(x[None])._replace(info={"w_mean": mean[None]})
    found = law.control(1, MpcState(u[None]), np.zeros((1, 1)), estimate, r)[1].u[0]
    shifted = type(m)(m.A, m.B, m.C, m.Q_w, m.R_v, f0=mean)
    np.testing.assert_allclose(found, best([shifted], 0, x, u, r, 4, 2, 0.3), **SOLVER)


def test_a_run_of_the_loop_and_what_is_refused(tmp_path):
    """Oracle: limits clip the first value; quadratic programs need a constant model."""
    law = law_of(tmp_path, methods=KEYS["methods"].replace("R: 0.5", "R: 0.5, limits: {u: [-0.1, 0.1]}"))
    np.testing.assert_array_equal(commanded(law, 0, [1.0], [0.0], np.zeros((4, 1))), [-0.1])
    qp = KEYS["methods"].replace("R: 0.5", "R: 0.5, limits: {u: [-0.1, 0.1], enforce: qp}")
    with pytest.raises(ConfigError, match="need a constant prediction model; this model varies with k"):
        law_of(tmp_path, methods=qp)
