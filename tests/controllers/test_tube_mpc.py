"""Tube MPC: the example of Mayne, Seron and Rakovic (2005), other solvers, corner noise, refusals."""

import pickle
from itertools import product

import numpy as np
import pytest
from conftest import SOLVER, random_model
from scipy.linalg import solve_discrete_are
from scipy.spatial import ConvexHull, HalfspaceIntersection

from rmpc_bench.controllers.state_feedback import lqr
from rmpc_bench.controllers.tube_mpc import design
from rmpc_bench.estimators.kalman import design as kalman
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.linearised import LinearisedModel
from rmpc_bench.types import DesignError, Estimate, OperatingPoint, OptimisedStep, Status

A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]])
MODEL = LinearModel(A, B, np.eye(2), 0.01 / 3, 0.0)
EXAMPLE = {"Q_x": 1.0, "R_u": 0.01, "horizon": 9, "limits": {"u": (-1.0, 1.0), "x.1": (None, 2.0)}, "W": 0.1}
START = np.array([-5.0, -2.0])
PRINTED = {"rtol": 0.0, "atol": 1e-9}
"""Nine or ten digits are given."""


def law_of(**keys):
    """Return the law of the example, with some keys changed."""
    return design(MODEL, **EXAMPLE | keys)


def commanded(law, x):
    """Return the command at states x."""
    x = np.atleast_2d(x)
    return law.control(0, law.init(len(x)), x, Estimate(x), np.zeros((1, len(x[0]))))[1]


def codes(law, x):
    """Return what became of the step at states x."""
    return commanded(law, x).info["qp"].astype(int).tolist()


def corner_noise(runs, steps, seed=0):
    """Return noise at random corners of the box of half width 0.1."""
    return 0.1 * (2.0 * np.random.default_rng(seed).integers(0, 2, (runs, steps, 2)) - 1.0)


def simulated(law, w, start=START, error=None):
    """Return x and u of a loop with a measured state, and whether a step of each run failed; `error` is added to u."""
    x, state, xs, us, failed = np.tile(start, (len(w), 1)), law.init(len(w)), [], [], np.zeros(len(w), dtype=bool)
    for k in range(w.shape[1]):
        state, command = law.control(k, state, x, Estimate(x), np.zeros((1, 2)))
        failed |= command.info["qp"] >= OptimisedStep.INFEASIBLE
        u = command.u if error is None else command.u + error[:, k]
        x = x @ A.T + u @ B.T + w[:, k]
        xs.append(x)
        us.append(u)
    return np.stack(xs, axis=1), np.stack(us, axis=1), failed


# 1  numbers of the example


def test_feedback_of_the_example():
    """Oracle: SciPy for P, the printed digits of P, K and the eigenvalues."""
    found = law_of().plan.feedback
    np.testing.assert_allclose(found.P, [[2.00658684, 0.50990195], [0.50990195, 1.26821157]], rtol=0, atol=6e-9)
    np.testing.assert_allclose(found.K, [[-0.66085320, -1.32605933]], rtol=0, atol=6e-9)
    np.testing.assert_allclose(sorted(np.linalg.eigvals(found.A_K)), [0.01322, 0.33029], rtol=0, atol=6e-6)
    np.testing.assert_allclose(found.P, solve_discrete_are(A, B, np.eye(2), 0.01 * np.eye(1)), rtol=1e-12)


def test_tube_of_the_example():
    """Oracle: digits of an independent study; area also by the hull, the minimal set also by 200 terms."""
    plan = law_of(margin=0.0).plan
    np.testing.assert_allclose(plan.Z.half_widths, [0.251649429, 0.250000535], **PRINTED)
    np.testing.assert_allclose(plan.Z.support(plan.feedback.K), [0.297383555], **PRINTED)
    np.testing.assert_allclose(plan.Z.area, 0.161365347, **PRINTED)
    np.testing.assert_allclose(ConvexHull(plan.Z.outline()).volume, plan.Z.area, rtol=1e-12)
    np.testing.assert_allclose(plan.limits.high - plan.kept_free(0), [0.702616445, 1.749999465], **PRINTED)
    powers = [np.abs(np.linalg.matrix_power(plan.feedback.A_K, i)).sum(axis=1) for i in range(200)]
    np.testing.assert_allclose(0.1 * sum(powers), [0.251648879, 0.25], **PRINTED)
    # 12 terms with alpha = 5.317e-6, the row sum of the matrix power.
    assert plan.Z.generators.shape == (2, 24)
    np.testing.assert_allclose(powers[12].max(), 5.317e-6, rtol=1e-4)


def test_terminal_set_of_the_example():
    """Oracle: rows and area of an independent study; every vertex stays inside under the feedback."""
    plan = law_of(margin=0.0).plan
    H, b, _ = plan.terminal
    hull = ConvexHull(HalfspaceIntersection(np.c_[H, -b], np.zeros(2)).intersections)
    assert len(H) == len(hull.vertices) == 5
    np.testing.assert_allclose(hull.volume, 4.521447507, **PRINTED)
    x = hull.points[hull.vertices]
    for _ in range(20):
        assert (np.abs(x @ plan.feedback.K.T) <= 0.702616445 + 1e-9).all()
        assert (x[:, 1] <= 1.749999465 + 1e-9).all()
        x = x @ plan.feedback.A_K.T


def test_first_step_of_the_example():
    """Oracle: V, s_0 and u of an independent study; 2 + 9 unknowns."""
    law = law_of(margin=0.0)
    command = commanded(law, START)
    np.testing.assert_allclose(command.info["V"], [264.0447041558], rtol=1e-11)
    np.testing.assert_allclose(command.info["s_0"], [[-5.051648365, -1.749999465]], **PRINTED)
    np.testing.assert_allclose(command.u, [[1.0]], rtol=1e-12)
    assert law.plan.rows.A.shape[1] == 11


# 2  other solvers


def solved_by_clarabel(law, states):
    """Return the minimum of the cost and u of every state, from the problem as it is stated; NaN where it has none.

    States and inputs are unknowns, x - z(0) is a combination of the generators, and the limits of `growing` are written
    out for 25 samples beyond the horizon.
    """
    import cvxpy

    plan, N, tightening = law.plan, 9, law.plan.tightening
    K, P, A_K = plan.feedback.K, plan.feedback.P, plan.feedback.A_K
    steps = N if tightening == "tube" else N + 25
    x, z, v = cvxpy.Parameter(2), cvxpy.Variable((steps + 1, 2)), cvxpy.Variable((steps, 1))
    cost = sum(cvxpy.sum_squares(z[j]) + 0.01 * cvxpy.sum_squares(v[j]) for j in range(N)) + cvxpy.quad_form(z[N], P)
    rows = [z[j + 1] == A @ z[j] + B @ v[j] for j in range(steps)] + [v[j] == K @ z[j] for j in range(N, steps)]
    if tightening == "tube":
        e = cvxpy.Variable(plan.Z.generators.shape[1])
        rows += [x - z[0] == plan.Z.generators @ e, cvxpy.abs(e) <= 1.0, plan.terminal.H @ z[N] <= plan.terminal.b]
    else:
        rows.append(z[0] == x)
    powers = [np.linalg.matrix_power(A_K, i) * plan.half_widths for i in range(steps)]
    for j in range(steps):
        G = {"tube": plan.Z.generators, "growing": np.hstack([np.zeros((2, 1)), *powers[:j]])}.get(tightening)
        of_u, of_x = (0.0, 0.0) if G is None else (np.abs(K @ G).sum(), np.abs(G[1]).sum())
        rows.append(cvxpy.abs(v[j]) <= 1.0 - of_u)
        if j > 0 or tightening == "tube":
            rows.append(z[j, 1] <= 2.0 - of_x)
    problem = cvxpy.Problem(cvxpy.Minimize(cost), rows)
    answers = []
    for x.value in states:
        problem.solve(solver=cvxpy.CLARABEL)
        feasible = problem.status in ("optimal", "optimal_inaccurate")
        u = (K @ (x.value - z.value[0]) + v.value[0])[0] if feasible else np.nan
        answers.append((problem.value if feasible else np.nan, u))
    return np.array(answers)


@pytest.mark.parametrize("tightening", ["tube", "growing", "none"])
def test_minimum_is_that_of_another_solver(tightening):
    """Oracle: cvxpy with Clarabel on the problem as it is stated, without closed forms; also where it is infeasible."""
    law, rng = law_of(tightening=tightening), np.random.default_rng(11)
    x = np.vstack([0.2 * rng.standard_normal((4, 2)), rng.uniform([-20.0, -3.0], [6.0, 2.0], (36, 2))])
    command = commanded(law, x)
    expected = solved_by_clarabel(law, x)
    np.testing.assert_array_equal(command.info["qp"] == OptimisedStep.INFEASIBLE, np.isnan(expected[:, 0]))
    found = np.isfinite(expected[:, 0])
    assert 10 < found.sum() < 38
    assert {OptimisedStep.SKIPPED, OptimisedStep.SOLVED, OptimisedStep.INFEASIBLE} == {*command.info["qp"]}
    np.testing.assert_allclose(
        command.info["V"][found], expected[found, 0], **SOLVER, atol=1e-8
    )  # the minimum may be 0
    np.testing.assert_allclose(command.u[found, 0], expected[found, 1], rtol=0, atol=1e-5)  # the minimum is flat in u


@pytest.mark.parametrize("tightening", ["tube", "growing"])
def test_skipped_steps_are_those_of_the_solver(tightening):
    """Oracle: every program solved."""
    from dataclasses import replace

    law = law_of(tightening=tightening)
    x = np.random.default_rng(12).uniform(-1.0, 1.0, (200, 2))
    skipped = law.program.moves(x, np.zeros(0))
    solved = replace(law.program, skips=False).moves(x, np.zeros(0))
    assert 0 < (skipped.steps == OptimisedStep.SKIPPED).sum() < 200
    np.testing.assert_allclose(skipped.V, solved.V, rtol=0, atol=1e-9)


# 3  guarantee


@pytest.mark.parametrize("tightening", ["tube", "growing"])
def test_no_limit_is_violated_under_corner_noise(tightening):
    """Oracle: the guarantee, over 500 runs of 30 samples at corners of W, and over all patterns of seven samples."""
    every = 0.1 * np.array(list(product([-1.0, 1.0], repeat=7)))
    patterns = np.stack([every, -every[:, ::-1]], axis=2)
    for w in (corner_noise(500, 30), patterns):
        x, u, failed = simulated(law_of(tightening=tightening), w)
        assert not failed.any()
        assert x[:, :, 1].max() <= 2.0
        assert np.abs(u).max() <= 1.0 + 1e-9


def test_the_limit_is_violated_without_tightening():
    """The naive form: predictive control that ignores the noise, and clipped linear-quadratic control."""
    w, shares = corner_noise(500, 30), []
    x, u, _ = simulated(law_of(tightening="none"), w)
    shares.append((x[:, :, 1] > 2.0 + 1e-6).mean())
    start, K = np.tile(START, (500, 1)), law_of().plan.feedback.K
    beyond = 0
    for k in range(30):
        start = start @ A.T + np.clip(start @ K.T, -1.0, 1.0) @ B.T + w[:, k]
        beyond += (start[:, 1] > 2.0 + 1e-6).sum()
    shares.append(beyond / (500 * 30))
    # 2.7 % and 4.4 % in an independent study with other noise and another plain controller.
    assert 0.015 < shares[0] < 0.035 < shares[1] < 0.05
    assert np.abs(u).max() <= 1.0 + 1e-9


def test_a_design_without_margin_loses_runs():
    """Trap: where x_2 = 2 exactly one s_0(2) is allowed, and an error of 1e-9 in u leaves none.

    Our solver is exact to about 1e-13 here, so that the error of another solver is added to u.
    """
    w = corner_noise(500, 30)
    error = 1e-9 * np.random.default_rng(1).uniform(-1.0, 1.0, (500, 30, 1))
    lost = {margin: simulated(law_of(margin=margin), w, error=error)[2].sum() for margin in (0.0, 1e-6)}
    assert lost[0.0] > 20
    assert lost[1e-6] == 0


def test_growing_has_a_larger_feasible_set():
    """Oracle: the states of a grid; what the tube can, growing can."""
    x = np.array(list(product(np.linspace(-9.0, 4.0, 40), np.linspace(-3.0, 2.0, 30))))
    feasible = {
        name: commanded(law_of(tightening=name), x).info["qp"] < OptimisedStep.INFEASIBLE
        for name in ("tube", "growing")
    }
    assert not (feasible["tube"] & ~feasible["growing"]).any()
    assert feasible["growing"].sum() > feasible["tube"].sum()


def test_the_cost_of_the_tube_falls_without_noise():
    """Oracle: the minimum is a Lyapunov function: V(k+1) <= V(k) - |z(0)|^2_Qx."""
    law, x, before = law_of(), START[None], np.inf
    for _ in range(12):
        command = commanded(law, x)
        V, s = command.info["V"][0], command.info["s_0"][0]
        assert V <= before + 1e-9
        before = V - s @ s
        x = x @ A.T + command.u @ B.T
    assert V < 1e-9


# 4  limits of the method


def test_without_noise_all_laws_are_one():
    """Oracle: each other; W is 1e-9."""
    x = np.random.default_rng(13).uniform(-3.0, 1.0, (100, 2))
    u = [commanded(law_of(tightening=name, W=1e-9), x).u for name in ("tube", "growing", "none")]
    np.testing.assert_allclose(u[0], u[2], rtol=0, atol=1e-6)
    np.testing.assert_allclose(u[1], u[2], rtol=0, atol=1e-6)


def test_without_active_limits_it_is_linear_quadratic_control():
    """Oracle: lqr over a long horizon."""
    estimator = kalman(MODEL, 3, x0=np.zeros(2), P0=np.eye(2))
    law = lqr(MODEL, 3, estimator, horizon=60, Q_x=1.0, R_u=0.01)
    x = 0.1 * np.random.default_rng(14).standard_normal((20, 2))
    np.testing.assert_allclose(commanded(law_of(), x).u, commanded(law, x).u, rtol=1e-10)
    assert codes(law_of(tightening="growing"), x) == [OptimisedStep.SKIPPED] * 20


@pytest.mark.parametrize("tightening", ["tube", "growing", "none"])
def test_an_operating_point_moves_the_law(tightening):
    """Oracle: the law of the deviations, with the limits moved."""
    m = random_model(np.random.default_rng(3), 2, 2, 2, 0.8)
    point = OperatingPoint(np.array([3.0, -4.0]), np.array([5.0, 6.0]), np.array([1.0, 2.0]))
    model = LinearisedModel(m.A, m.B, m.C, m.Q_w, m.R_v, point=point)
    keys = {"Q_x": 1.0, "R_u": 0.1, "horizon": 4, "W": 0.02, "alpha": 1e-3, "tightening": tightening}
    y, x = model.C @ point.x + model.d0, np.random.default_rng(4).standard_normal((50, 2))
    moved = {"u": [(4.5, 5.5), (5.5, 6.5)], "x.0": (1.0, 5.0), "y.1": (y[1] - 3.0, y[1] + 3.0)}
    plain = {"u.0": (-0.5, 0.5), "u.1": (-0.5, 0.5), "x.0": (-2.0, 2.0), "y.1": (-3.0, 3.0)}
    found = commanded(design(model, **keys, limits=moved), x + point.x)
    expected = commanded(design(model.deviation, **keys, limits=plain), x)
    np.testing.assert_allclose(found.u, expected.u + point.u, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.info["qp"], expected.info["qp"])
    assert len({*found.info["qp"]}) > 1
    assert design(model, **keys, limits=moved).regulates_to.tolist() == point.y.tolist()


def test_a_limit_of_a_signal_of_the_model():
    """Oracle: the same limit of the state, twice as large."""
    named = LinearModel(A, B, np.eye(2), 0.01, 0.0, extra_signals={"speed": np.array([[0.0, 2.0]])})
    limits = {"u": (-1.0, 1.0), "speed": (None, 4.0)}
    x = np.array([START, [-6.0, 1.0]])
    np.testing.assert_allclose(commanded(design(named, **EXAMPLE | {"limits": limits}), x).u, commanded(law_of(), x).u)


# 5  failed steps


FAR = np.array([[-5.0, -2.0], [-30.0, 0.0], [-31.0, 1.0]])
"""The start of the example, and states from which the limits cannot be kept."""


@pytest.mark.parametrize("fallback", ["clip", "hold", "stop"])
def test_a_state_outside_the_feasible_set(fallback):
    """Oracle: the clipped feedback, the previous input, or the end of the run; the other run is not affected."""
    law = law_of(fallback=fallback)
    state = law.init(3)._replace(u_previous=np.array([[0.1], [0.2], [0.3]]))
    after, command = law.control(0, state, FAR, Estimate(FAR), np.zeros((1, 2)))
    K, infeasible = law.plan.feedback.K, int(Status.INFEASIBLE)
    expected = np.array([[0.2], [0.3]]) if fallback == "hold" else np.clip(FAR[1:] @ K.T, -1.0, 1.0)
    np.testing.assert_allclose(command.u, np.vstack([[[1.0]], expected]), rtol=1e-12)
    np.testing.assert_array_equal(after.u_previous, command.u)
    assert command.info["qp"].tolist() == [OptimisedStep.SOLVED, *[OptimisedStep.INFEASIBLE] * 2]
    assert np.isnan(command.info["V"]).tolist() == [False, True, True]
    assert np.isnan(command.info["s_0"]).all(axis=1).tolist() == [False, True, True]
    statuses = [0, infeasible, infeasible]
    assert command.status.tolist() == (statuses if fallback == "stop" else [0, 0, 0])
    if fallback != "stop":
        assert command.step_status is not None
        assert command.step_status.tolist() == statuses


def test_a_state_that_is_not_a_number_is_neither_skipped_nor_solved():
    """Oracle: the other run alone."""
    law = law_of()
    command = commanded(law, np.array([[np.nan, 0.0], [-5.0, -2.0]]))
    assert command.info["qp"].tolist() == [OptimisedStep.NOT_CONVERGED, OptimisedStep.SOLVED]
    np.testing.assert_array_equal(command.u[1:], commanded(law, START).u)


def test_any_block_and_order_has_the_same_bytes():
    """Oracle: run by run, also after a copy to another process."""
    x = np.random.default_rng(15).uniform([-7.0, -3.0], [2.0, 2.0], (60, 2))
    law = law_of()
    together = commanded(law, x).u
    copied = pickle.loads(pickle.dumps(law))
    alone = np.vstack([commanded(copied, each).u for each in x[::-1]])[::-1]
    np.testing.assert_array_equal(together, alone)


# 6  designs that are refused

INTEGRATOR = LinearModel(np.array([[1.0, 1.0], [0.0, 1.0]]), [[1.0], [0.0]], [[1.0, 0.0]], 1.0, 1.0)


@pytest.mark.parametrize(
    ("model", "keys", "key", "message"),
    [
        (MODEL, {"W": 0.5}, "W", r"leaves no room at the limit -?1 of u: the noise takes 1.487 of it"),
        (MODEL, {"W": None}, "W", "`W` is needed with tightening: tube"),
        (MODEL, {"W": [0.1, 0.1, 0.1]}, "W", "3"),
        (MODEL, {"limits": {}}, "limits", "needs a limit"),
        (MODEL, {"limits": {"u": []}}, "limits.u", "has 0 pairs"),
        (MODEL, {"limits": {"x.2": (0.0, 1.0)}}, 'limits."x.2"', "state 2"),
        (MODEL, {"limits": {"u.1": (0.0, 1.0)}}, 'limits."u.1"', "input 1"),
        (MODEL, {"limits": {"torque": (0.0, 1.0)}}, "limits.torque", "not a known signal of the design model"),
        (MODEL, {"limits": {"u": (1.0, -1.0)}}, "limits.u", "must be below the upper bound"),
        (MODEL, {"limits": {"u": (-1.0, 1.0), "x.1": (None, None)}}, 'limits."x.1"', "has no bound"),
        (MODEL, {"limits": {"u": (0.5, 1.0)}}, "limits.u", "between its bounds"),
        (MODEL, {"R_u": 0.0}, "R_u", "positive definite"),
        (MODEL, {"Q_x": 0.0}, "Q_x", "does not weigh every state"),
        (MODEL, {"Q_x": [1.0, 1.0, 1.0]}, "Q_x", "3"),
        (INTEGRATOR, {"limits": {"u": (-1.0, 1.0)}}, "", "do not reach that of the eigenvalue 1"),
    ],
    ids=[
        "W",
        "no W",
        "size",
        "empty",
        "no pair",
        "state",
        "input",
        "signal",
        "order",
        "no bound",
        "point",
        "R_u",
        "Q_x",
        "Q",
        "integrator",
    ],
)
def test_refused(model, keys, key, message):
    """Oracle: the key to blame and the message."""
    with pytest.raises(DesignError, match=message) as caught:
        design(model, **EXAMPLE | keys)
    assert (caught.value.parameter or "") == key


def test_an_unknown_signal_names_the_nearest_one():
    """Oracle: the message."""
    model = LinearModel(A, B, np.eye(2), 0.01, 0.0, extra_signals={"shaft_torque": np.array([[0.0, 2.0]])})
    with pytest.raises(DesignError, match="did you mean 'shaft_torque'"):
        design(model, **EXAMPLE | {"limits": {"shaft_torqe": (-1.0, 1.0)}})


def test_a_set_with_too_many_facets():
    """Oracle: the ways out work."""
    model = random_model(np.random.default_rng(5), 4, 1, 2, 0.9)
    keys = {"Q_x": 1.0, "R_u": 0.1, "horizon": 5, "limits": {"u": (-5.0, 5.0)}, "W": 0.01}
    with pytest.raises(DesignError, match="use `growing`") as caught:
        design(model, **keys)
    assert caught.value.parameter == "tightening"
    assert design(model, **keys, tightening="growing").plan.rows.A.shape[1] == 5


def test_remark_where_the_guarantee_does_not_hold():
    """Oracle: whether the model measures every state without noise."""
    noisy = LinearModel(A, B, np.eye(2), 0.01, 1e-4)
    partly = LinearModel(A, B, [[1.0, 0.0]], 0.01, 0.0)
    assert law_of().remarks == law_of(tightening="none").remarks == ()
    for model in (noisy, partly):
        (remark,) = design(model, **EXAMPLE).remarks
        assert "guaranteed for a measured state only" in remark
