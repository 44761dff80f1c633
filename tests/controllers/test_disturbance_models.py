"""Controllers and estimators on a design model with disturbances: what the gains of d are, and what is refused."""

import numpy as np
import pytest

from rmpc_bench.adapters.control_gains import lqr as control_lqr
from rmpc_bench.controllers.gpc import design as gpc
from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.controllers.mpc import design as mpc
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.estimators.kalman_disturbance import design as kalman_disturbance
from rmpc_bench.estimators.oracle import design as oracle
from rmpc_bench.estimators.set_membership import design as set_membership
from rmpc_bench.models.disturbance import Disturbance
from rmpc_bench.models.disturbed import with_disturbance
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.uncertain_linear import design as uncertain
from rmpc_bench.plants.ode import design as ode_plant
from rmpc_bench.plants.uncertain_linear import design as uncertain_plant
from rmpc_bench.types import DesignError, Estimate, OptimisedStep, PlantInfo

STEPS = 20
BASE = LinearModel([[0.9, 0.3], [-0.2, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]], 0.01, 0.1)
BOTH = with_disturbance(BASE, Disturbance(at="input", drift=0.02), STEPS, np.zeros(2))


def start(model):
    return model.start(np.zeros(2), np.eye(2), np.zeros((2, 2)))


def filtered(model):
    given = start(model)
    return kalman(model, STEPS, x0=given["x0"], P0=given["P0"])


def held_inputs(n, Q_x, R_u, x, d):
    """Minimise the cost over all inputs at once, with d held: least squares of stacked states."""
    free, forced, to_d = [], [], []
    A, B = BASE.A, BASE.B
    power, response, held = np.eye(2), np.zeros((2, n)), np.zeros((2, 1))
    for t in range(n):
        response = A @ response
        response[:, t] += B[:, 0]
        power, held = A @ power, A @ held + B
        free.append(power)
        forced.append(response.copy())
        to_d.append(held)
    F, G, H = np.vstack(free), np.vstack(forced), np.vstack(to_d)
    root = np.kron(np.eye(n), np.linalg.cholesky(Q_x).T)
    M = np.vstack([root @ G, np.sqrt(R_u) * np.eye(n)])
    b = np.concatenate([root @ (F @ x + H @ d), np.zeros(n)])
    return np.linalg.lstsq(M, -b, rcond=None)[0]


def test_lqr_weighs_the_state_only(rng):
    """Oracle: all inputs of the window by least squares, with the disturbance held."""
    Q_x = np.array([[2.0, 0.3], [0.3, 1.0]])
    law = lqr(BOTH, STEPS, filtered(BOTH), horizon=7, Q_x=Q_x.tolist(), R_u=0.1)
    x, d = rng.standard_normal(2), rng.standard_normal(1)
    found = -law.K[0] @ np.concatenate([x, d])
    np.testing.assert_allclose(found, held_inputs(7, Q_x, 0.1, x, d)[:1], rtol=1e-10)


def test_the_stationary_law_of_python_control_is_its_limit():
    """Oracle: `lqr` with a horizon of 400 samples, over which everything has decayed."""
    pytest.importorskip("control")
    far = lqr(BOTH, 1, filtered(BOTH), horizon=400, Q_x=[1.0, 2.0], R_u=0.1).K[0]
    found = control_lqr(BOTH, 1, filtered(BOTH), Q_x=[1.0, 2.0], R_u=0.1).K[0]
    np.testing.assert_allclose(found, far, rtol=1e-9)


@pytest.mark.parametrize("law", ["mpc", "gpc"])
def test_predictive_laws_hold_the_disturbance(law, rng):
    """A disturbance at the input is an input that is added: u(x, d) follows from the predictions of x with B (u + d).

    Oracle: the outputs are those that the law without disturbance sees for the input u + d.
    """
    z = np.concatenate([rng.standard_normal(2), [0.7]])
    if law == "mpc":
        keys = {"Hp": 6, "Hu": 3, "Q": 1.0, "R": 0.0}
        both, base = mpc(BOTH, **keys), mpc(BASE, **keys)
        # Without a weight of the moves, u + d is the input of the undisturbed law.
        np.testing.assert_allclose(both.K_x @ z, base.K_x @ z[:2] + z[2:], rtol=1e-8)
    else:
        keys = {"Np": 6, "Q_yw": 1.0, "Q_u": 1e-7}
        both, base = gpc(BOTH, **keys), gpc(BASE, **keys)
        np.testing.assert_allclose(both.gains.K_x @ z, base.gains.K_x @ z[:2] + z[2:], rtol=1e-6)


def test_what_cannot_be_combined_is_refused():
    given = start(BOTH)
    with pytest.raises(DesignError, match="stays at 0") as error:
        set_membership(BOTH, STEPS, **given, inflate=False)
    assert error.value.parameter == "inflate"
    set_membership(BOTH, STEPS, **given)
    with pytest.raises(DesignError, match="every state already"):
        kalman_disturbance(BOTH, STEPS, x0=given["x0"], P0=given["P0"])


def test_the_oracle_knows_the_matrices_and_estimates_the_disturbance(rng):
    """Oracle: without uncertainty it is the Kalman filter of the augmented model."""
    keys = {"A": [[0.9, 0.3], [-0.2, 0.7]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "Bw": 1.0, "Dv": 1.0}
    plant = uncertain_plant(1.0, STEPS, **keys)
    both = with_disturbance(
        uncertain(STEPS, **keys, W=0.01, V=0.1), Disturbance(at="input", drift=0.02), STEPS, np.zeros(2)
    )
    given = start(both)
    ours = oracle(both, STEPS, plant, x0=given["x0"], P0=given["P0"], form="filter")
    theirs, y = filtered(BOTH), rng.standard_normal((3, STEPS + 1, 1))
    delta = plant.draw({}, [np.random.default_rng(i) for i in range(3)], STEPS)
    a, b = ours.init(3, delta), theirs.init(3)
    for k in range(STEPS):
        (a, one), (b, other) = ours.correct(k, a, y[:, k]), theirs.correct(k, b, y[:, k])
        np.testing.assert_allclose(one.x_hat, other.x_hat, rtol=1e-9, atol=1e-12)
        u = rng.standard_normal((3, 1))
        a, b = ours.predict(k, a, u), theirs.predict(k, b, u)


@pytest.mark.parametrize("control", [mpc, gpc])
@pytest.mark.parametrize("name", ["b", "x.1", "own"])
def test_a_limited_signal_has_no_part_of_the_disturbance(control, name, rng):
    """Oracle: the model whose states are x and d, with rows of its own; the keys are those of a method without d."""
    horizon = {"Hp": 5, "Hu": 5, "Q": 1.0, "R": 0.1} if control is mpc else {"Np": 5, "Q_yw": 1.0, "Q_u": 0.1}
    keys = {"states": ["a", "b"], "inputs": ["f"], "outputs": ["y1"], "output": lambda x, p: x[:1]}
    info = PlantInfo.of(ode_plant(1.0, STEPS, ode=lambda x, u, p: [x[1], u[0]], **keys))
    plain = LinearModel(BOTH.A, BOTH.B, BOTH.C, BOTH.Q_w, BOTH.R_v)
    x, found = rng.standard_normal((9, 3)), []
    for model, key, of in ((BOTH, name, [0.0, 1.0]), (plain, "own", [0.0, 1.0, 0.0])):
        soft = {key: SoftLimit((-0.2, 0.3), 0.5, of=of if key == "own" else None)}
        law = control(model, plant_info=info, **horizon, limits=Limits(enforce="qp"), soft=soft)
        estimate = Estimate(x, None, None, np.zeros(9, dtype=np.int8), {})
        found.append(law.control(0, law.init(9), np.zeros((9, 1)), estimate, np.ones((law.preview, 1)))[1])
    np.testing.assert_array_equal(found[0].u, found[1].u)
    assert {*found[0].info["qp"]} - {OptimisedStep.SKIPPED}


def test_the_disturbance_is_no_signal():
    """Rows have one number per state of the model without disturbances, as the names have."""
    limits = Limits(enforce="qp")
    for name, of in (("own", [0.0, 1.0, 0.0]), ("x.2", None)):
        soft = {name: SoftLimit((-1.0, 1.0), 1.0, of=of)}
        with pytest.raises(DesignError, match="2 states|0 to 1"):
            mpc(BOTH, Hp=5, Hu=2, Q=1.0, R=0.1, limits=limits, soft=soft)
