"""The predictive law with constant penalties: brute force, a QP solver, and the laws that it is a case of."""

import pickle
import subprocess
import sys

import cvxpy as cp
import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_model, random_psd
from controllers.gpc_twin import Swing, Varying, commands, dense, estimate_of

from rmpc_bench.controllers import mpc
from rmpc_bench.controllers.gpc import design
from rmpc_bench.controllers.noise_tuning import LpNoise
from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.models.state_dependent import Pair, StateDependentModel
from rmpc_bench.types import DesignError, Estimator, Status

LSTSQ = {"rtol": 1e-9, "atol": 1e-11}  # of two factorisations of systems with conditions up to 1e5


def roots(rng, nu, ny):
    """Roots of the weights that are neither symmetric nor positive."""
    return rng.standard_normal((ny, ny)), rng.standard_normal((nu, nu)) + 2.0 * np.eye(nu)


def with_means(rng, nx, nu, ny):
    """A model whose noises have means."""
    m = random_model(rng, nx, nu, ny)
    return LinearModel(m.A, m.B, m.C, m.Q_w, m.R_v, f0=rng.standard_normal(nx), d0=rng.standard_normal(ny))


def first(controller, x_hat, r, k=0):
    """Command at k after the estimate x_hat, also that of the sample before."""
    state = controller.init(len(x_hat))._replace(x_previous=x_hat)
    return controller.control(k, state, np.zeros((len(x_hat), r.shape[1])), estimate_of(x_hat), r)[1]


@pytest.mark.parametrize("Np", [1, 5])
@pytest.mark.parametrize(("nx", "nu", "ny"), [(1, 1, 1), (4, 1, 1), (3, 2, 2), (3, 2, 1), (3, 1, 2), (6, 4, 3)])
def test_the_law_minimises_the_cost(nx, nu, ny, Np, rng):
    """Oracle: (12) by lstsq; known means of the noises are part of the prediction; r(k) has no effect."""
    m = with_means(rng, nx, nu, ny)
    Q_yw, Q_u = roots(rng, nu, ny)
    controller = design(m, Np=Np, Q_yw=Q_yw.tolist(), Q_u=Q_u.tolist())
    x_hat, r = rng.standard_normal((3, nx)), rng.standard_normal((Np + 1, ny))
    command = first(controller, x_hat, r)
    assert controller.preview == len(r)
    expected = [dense(m.A, m.B, m.f0, m.C, Q_yw, Q_u, r[1:] - m.d0, x) for x in x_hat]
    np.testing.assert_allclose(command.u, [u for u, _ in expected], **LSTSQ)
    np.testing.assert_allclose(command.info["loss"], [loss for _, loss in expected], **LSTSQ)
    np.testing.assert_array_equal(command.status, np.full(3, Status.OK, dtype=np.int8))
    np.testing.assert_array_equal(first(controller, x_hat, np.vstack([r[:1] + 1.0, r[1:]])).u, command.u)


def test_the_law_minimises_the_cost_by_a_qp_solver(rng):
    """Oracle: cvxpy with Clarabel; states, inputs and outputs of the horizon are variables, the model a constraint."""
    m, Np = random_model(rng, 3, 2, 2), 6
    Q_yw, Q_u = roots(rng, 2, 2)
    x_hat, r = rng.standard_normal(3), rng.standard_normal((Np + 1, 2))
    x, u = cp.Variable((Np + 1, 3)), cp.Variable((Np, 2))
    cost = sum(cp.sum_squares(Q_yw @ (m.C @ x[j + 1] - r[j + 1])) + cp.sum_squares(Q_u @ u[j]) for j in range(Np))
    rules = [x[0] == x_hat, *(x[j + 1] == m.A @ x[j] + m.B @ u[j] for j in range(Np))]
    problem = cp.Problem(cp.Minimize(cost), rules)
    problem.solve(solver=cp.CLARABEL)
    command = first(design(m, Np=Np, Q_yw=Q_yw.tolist(), Q_u=Q_u.tolist()), x_hat[None], r)
    np.testing.assert_allclose(command.u[0], u.value[0], **SOLVER)
    np.testing.assert_allclose(command.info["loss"][0], problem.value, **SOLVER)


def test_it_is_mpc_that_weighs_inputs(rng):
    """Oracle: mpc with `law: printed` and Hu = Hp; Q and R there are the squares."""
    m = random_model(rng, 3, 2, 2)
    Q_yw, Q_u = random_psd(rng, 2), random_psd(rng, 2)
    ours = design(m, Np=6, Q_yw=Q_yw.tolist(), Q_u=Q_u.tolist()).gains
    Q, R = ((S @ S + (S @ S).T) / 2.0 for S in (Q_yw, Q_u))
    theirs = mpc.design(m, Hp=6, Hu=6, Q=Q.tolist(), R=R.tolist(), law="printed")
    np.testing.assert_allclose(ours.K_x, theirs.K_x, **LSTSQ)
    np.testing.assert_allclose(ours.K_w, theirs.K_r, **LSTSQ)


def test_without_a_reference_it_is_lqr(rng):
    """Oracle: the stated limit; lqr weighs states x(t+1) as the outputs are weighed here."""
    m = random_model(rng, 4, 2, 3)
    Q_yw, Q_u = roots(rng, 2, 3)
    Q_x = m.C.T @ Q_yw.T @ Q_yw @ m.C
    regulator = lqr(m, 3, Estimator(), horizon=7, Q_x=((Q_x + Q_x.T) / 2.0).tolist(), R_u=(Q_u.T @ Q_u).tolist())
    controller = design(m, Np=7, Q_yw=Q_yw.tolist(), Q_u=Q_u.tolist())
    np.testing.assert_allclose(controller.gains.K_x, regulator.K[0], rtol=1e-8, atol=1e-10)  # Riccati squares


def test_without_a_cost_of_inputs_one_step_reaches_the_reference(rng):
    """Oracle: the stated limit; Np = 1, Q_u = 0 and C B square gives y(k+1) = r(k+1)."""
    m = random_model(rng, 3, 2, 2)
    x_hat, r = rng.standard_normal((5, 3)), rng.standard_normal((2, 2))
    u = first(design(m, Np=1, Q_yw=1.0, Q_u=0.0), x_hat, r).u
    np.testing.assert_allclose((x_hat @ m.A.T + u @ m.B.T) @ m.C.T, np.tile(r[1], (5, 1)), atol=1e-11)


class Constant(StateDependentModel):
    """A linear model in the form of a state-dependent one."""

    largest = 1e6

    def __init__(self, m):
        self.m, self.nx, self.nu, self.ny, self.C, self.Q_w, self.R_v = m, m.nx, m.nu, m.ny, m.C, m.Q_w, m.R_v

    def at_state(self, x):
        """The same pair everywhere."""
        return Pair(*(np.tile(matrix, (len(x), 1, 1)) for matrix in (self.m.A, self.m.B)))


def test_a_model_that_does_not_depend_on_the_state_is_a_linear_one(rng):
    """Oracle: the law with gains, by other code."""
    m = random_model(rng, 4, 2, 3)
    keys = {"Np": 5, "Q_yw": 1.0, "Q_u": [0.1, 0.2]}
    x_hat, y, r = rng.standard_normal((3, 4, 4)), np.zeros((3, 4, 3)), rng.standard_normal((10, 3))
    ours, theirs = (commands(design(each, **keys), x_hat, y, r) for each in (Constant(m), m))
    for left, right in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(left.u, right.u, **LSTSQ)
        np.testing.assert_allclose(left.info["loss"], right.info["loss"], **LSTSQ)


@pytest.mark.parametrize("tuning", [{}, {"tuning": LpNoise(Ne2=9)}], ids=["constant", "not yet tuned"])
def test_a_state_dependent_model_is_frozen_at_the_estimate_before(tuning, rng):
    """Oracle: (12) with the pair at x_hat(k-1), at k = 0 at x_hat(0)."""
    model, x_hat, r = Swing(), rng.standard_normal((3, 5, 2)), rng.standard_normal((20, 1))
    controller = design(model, Np=6, Q_yw=2.0, Q_u=0.3, **tuning)
    found = commands(controller, x_hat, np.zeros((3, 5, 1)), r)
    for k, command in enumerate(found):
        np.testing.assert_array_equal(model.asked[k], x_hat[:, max(k - 1, 0)])
        A, B = Swing().at_state(x_hat[:, max(k - 1, 0)])
        for i in range(3):
            u, loss = dense(A[i], B[i], np.zeros(2), model.C, 2.0 * np.eye(1), 0.3 * np.eye(1), r[k + 1 : k + 7],
                            x_hat[i, k])  # fmt: skip
            np.testing.assert_allclose(command.u[i], u, **LSTSQ)
            np.testing.assert_allclose(command.info["loss"][i], loss, **LSTSQ)


def test_a_varying_model_is_that_of_k_over_the_horizon(rng):
    """Oracle: the law of the model of each k, as if there were no other."""
    models = [random_model(rng, 3, 2, 2) for _ in range(4)]
    x_hat, y, r = rng.standard_normal((3, 4, 3)), np.zeros((3, 4, 2)), rng.standard_normal((10, 2))
    found = commands(design(Varying(models), 4, Np=5, Q_yw=1.0, Q_u=0.5), x_hat, y, r)
    for k, m in enumerate(models):
        alone = first(design(m, Np=5, Q_yw=1.0, Q_u=0.5), x_hat[:, k], r[k : k + 6])
        np.testing.assert_allclose(found[k].u, alone.u, **LSTSQ)


@pytest.mark.parametrize("tuning", [{}, {"tuning": LpNoise(Ne2=2, kp=1.0)}], ids=["constant", "tuned"])
def test_a_varying_model_may_have_means(tuning, rng):
    """Oracle: (12) with the model of k and the penalties that are reported; they change once they are tuned."""
    models, x_hat, y = [with_means(rng, 2, 2, 2) for _ in range(5)], rng.standard_normal((3, 5, 2)), np.zeros((3, 5, 2))
    r = rng.standard_normal((10, 2))
    found = commands(design(Varying(models), 5, Np=3, Q_yw=1.5, Q_u=0.5, **tuning), x_hat, y, r)
    for k, (m, command) in enumerate(zip(models, found, strict=True)):
        for i, Q_yw in enumerate(command.info["Q_yw"]):
            assert np.array_equal(Q_yw, 1.5 * np.eye(2)) == (not tuning or k < 2)
            u, loss = dense(m.A, m.B, m.f0, m.C, Q_yw, 0.5 * np.eye(2), r[k + 1 : k + 4] - m.d0, x_hat[i, k])
            np.testing.assert_allclose(command.u[i], u, **LSTSQ)
            np.testing.assert_allclose(command.info["loss"][i], loss, **LSTSQ)


def test_tuning_counts_means_as_known(rng):
    """Oracle: max |y - C x_hat - d0| and max |x_hat - A x_hat(k-1) - B u(k-1) - f0| of the last three samples.

    The means are those of the models of their own times; the last rows of both fits have no coefficients.
    """
    models, x_hat, y = [with_means(rng, 2, 1, 2) for _ in range(8)], *rng.standard_normal((2, 4, 8, 2))
    controller = design(Varying(models), 8, Np=2, Q_yw=1.0, Q_u=0.5, tuning=LpNoise(Ne2=2))
    found = commands(controller, x_hat, y, np.zeros((12, 2)))
    n = np.stack([y[:, k] - x_hat[:, k] @ m.C.T - m.d0 for k, m in enumerate(models)])
    before = [x_hat[:, k] @ m.A.T + found[k].u @ m.B.T + m.f0 for k, m in enumerate(models)]
    nu = np.stack([x_hat[:, k] - before[k - 1] for k in range(1, 8)])
    for k in range(3, 8):
        np.testing.assert_allclose(found[k].info["r_breve"][:, 1], np.abs(n[k - 2 : k + 1, :, 1]).max(axis=0), **ROUND)
        np.testing.assert_allclose(found[k].info["rho_breve"][:, 1], np.abs(nu[k - 3 : k, :, 1]).max(axis=0), **ROUND)


@pytest.mark.parametrize("n_steps", [None, 4])
def test_a_model_that_could_vary_but_does_not(n_steps, rng):
    """Oracle: the linear model; with the number of steps there are gains, and a pickled design has them too."""
    A = [[0.9, 0.2], [0.0, 0.7]]
    model = mixed_model(4, A=A, B=[[0.0], [1.0]], C=[[1.0, 0.0]], P_w=1.0, P_v=1.0, w_mean=[0.1, 0.2])
    controller = design(model, n_steps, Np=5, Q_yw=1.0, Q_u=0.5)
    assert (controller.gains is None) == (n_steps is None)
    x_hat, r = rng.standard_normal((3, 2)), rng.standard_normal((6, 1))
    linear = LinearModel(A, [[0.0], [1.0]], [[1.0, 0.0]], 1.0, 1.0, f0=np.array([0.1, 0.2]))
    ours, expected = first(controller, x_hat, r), first(design(linear, Np=5, Q_yw=1.0, Q_u=0.5), x_hat, r)
    np.testing.assert_allclose(ours.u, expected.u, **ROUND)
    np.testing.assert_array_equal(first(pickle.loads(pickle.dumps(controller)), x_hat, r).u, ours.u)


@pytest.mark.parametrize("tuning", [{}, {"tuning": LpNoise(Ne2=3)}, {"tuning": LpNoise(Ne2=3, state_rows=False)}])
def test_it_reports_what_its_commands_have(tuning, rng):
    """Oracle: the arrays of a command before and after LP2 has begun."""
    m = random_model(rng, 3, 2, 2)
    controller = design(m, Np=3, Q_yw=[[1.0, 0.2], [0.0, 2.0]], Q_u=1.0, **tuning)
    found = commands(controller, rng.standard_normal((4, 6, 3)), rng.standard_normal((4, 6, 2)), np.zeros((9, 2)))
    for command in (found[0], found[-1]):
        assert {name: values.shape[1:] for name, values in command.info.items()} == controller.reports
    np.testing.assert_array_equal(found[0].info["Q_yw"], np.tile([[1.0, 0.2], [0.0, 2.0]], (4, 1, 1)))


def test_the_least_cost_of_a_run_does_not_depend_on_another_one(rng):
    """Oracle: each run alone, bit for bit; for inputs the conformance suite asks the same."""
    m = random_model(rng, 6, 4, 3)
    controller = design(m, Np=10, Q_yw=1.0, Q_u=0.1)
    x_hat, r = rng.standard_normal((7, 6)), rng.standard_normal((11, 3))
    loss = first(controller, x_hat, r).info["loss"]
    assert [first(controller, x_hat[i : i + 1], r).info["loss"][0] for i in range(7)] == loss.tolist()


@pytest.mark.parametrize(
    ("changes", "parameter", "message"),
    [
        ({"Q_yw": [1.0, 2.0, 3.0]}, "Q_yw", "shape"),
        ({"Q_u": [[1.0]]}, "Q_u", "shape"),
        ({"Q_u": [0.0, 0.0]}, "Q_u", "does not determine"),
        ({"tuning": LpNoise(bounds=(4.0, 0.5))}, "tuning.bounds", "0.5"),
        ({"tuning": LpNoise(Ne2=1)}, "tuning.Ne2", "at least 2"),
        ({"tuning": LpNoise(), "Q_u": [1.0, 0.0]}, "Q_u", "full rank"),
        ({"tuning": LpNoise(), "Q_u": [1.0, 1e-14]}, "Q_u", "full rank"),
        ({"tuning": LpNoise(), "Q_u": [[1.0, 1.0], [1.0, 1.0 + 1e-14]]}, "Q_u", "full rank"),
    ],
)
def test_bad_parameters_are_design_errors_that_name_them(changes, parameter, message, rng):
    """Oracle: DesignError.parameter leads to the line of the YAML."""
    model = random_model(rng, 3, 2, 1)
    with pytest.raises(DesignError, match=message) as caught:
        design(model, **{"Np": 3, "Q_yw": 1.0, "Q_u": 1.0, **changes})
    assert caught.value.parameter == parameter


def test_a_model_that_changes_needs_a_weight_of_every_input():
    """Oracle: which input moves an output may change, too."""
    with pytest.raises(DesignError, match="full rank") as caught:
        design(Swing(), Np=3, Q_yw=1.0, Q_u=0.0)
    assert caught.value.parameter == "Q_u"


def test_constant_penalties_of_a_linear_model_need_no_compiler():
    """Oracle: the modules of a fresh process; `check` builds designs and must stay quick."""
    code = (
        "import sys, numpy as np; from rmpc_bench.models.linear import LinearModel; "
        "from rmpc_bench.controllers.gpc import design; from rmpc_bench.controllers.noise_tuning import LpNoise; "
        "m = LinearModel(np.eye(2), np.eye(2), np.eye(2), 1.0, 1.0); design(m, Np=9, Q_yw=1.0, Q_u=1.0).warm_up(); "
        "design(m, Np=9, Q_yw=1.0, Q_u=1.0, tuning=LpNoise()); assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
