"""Differential-algebraic equations that CasADi integrates."""

import numpy as np
import pytest

pytest.importorskip("casadi")

import casadi
from adapters.casadi_systems import STEPS, TS, dae, two_tanks
from adapters.test_casadi_plant import NOISE, drawn, moved
from conftest import EXACT

from rmpc_bench.adapters.casadi_plant import plant, sampled_dae
from rmpc_bench.models.dynamics import dynamics_of
from rmpc_bench.models.linearised import design as linearise
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, Status


@pytest.mark.parametrize("integrator", ["idas", "collocation"])
def test_it_is_the_plant_whose_algebraic_variables_are_eliminated(integrator):
    """Oracle: the differential equation, by an explicit integration with tight tolerances."""
    eliminated = two_tanks(solver=Solver("DOP853", rtol=1e-12, atol=1e-14))
    theirs = two_tanks(dae(), integrator=integrator)
    np.testing.assert_allclose(moved(theirs), moved(eliminated), rtol=1e-6, atol=1e-7)


def test_tighter_options_reach_the_integrator():
    """Oracle: the same; the error falls with the tolerance."""
    exact = moved(two_tanks(solver=Solver("DOP853", rtol=1e-12, atol=1e-14)))
    usual, tight = (
        np.abs(moved(two_tanks(dae(), **keys)) - exact).max()
        for keys in ({}, {"options": {"reltol": 1e-11, "abstol": 1e-13}})
    )
    assert tight < 0.1 * usual < 1e-7


def test_a_run_does_not_depend_on_the_runs_before_it():
    """Oracle: the same run alone; an integrator that began at its last algebraic variables would differ."""
    made = two_tanks(dae())
    together = moved(made)
    for i in (8, 3, 0):
        np.testing.assert_allclose(moved(made, slice(i, i + 1)), together[i : i + 1], **EXACT)


def test_a_run_that_cannot_be_integrated_has_not_converged():
    """A level below zero has no outflow: the other runs of the block have the bits that they have alone."""
    made = two_tanks(dae(), bounds={})
    delta, x, u = drawn(made)
    alone = moved(made)
    x[4, 0] = -0.1
    motion = made.step(0, delta, x, u, np.zeros_like(x))
    assert motion.status.tolist() == [Status.OK] * 4 + [Status.NOT_CONVERGED] + [Status.OK] * 4
    np.testing.assert_array_equal(np.delete(motion.x, 4, axis=0), np.delete(alone, 4, axis=0))


def test_the_time_of_a_sample_reaches_the_equation():
    """Oracle: x' = cos(t) u over sample 7.  CasADi counts the time of an integrator from its own beginning."""
    t, x, z, u = (casadi.SX.sym(name) for name in "txzu")
    made = plant(0.1, STEPS, casadi={"t": t, "x": x, "z": z, "u": u, "ode": z, "alg": z - u * casadi.cos(t)})
    zero = np.zeros((1, 1))
    end = made.step(7, made.draw({}, [None], STEPS), zero, zero + 2.0, zero).x
    np.testing.assert_allclose(end, 2.0 * (np.sin(0.8) - np.sin(0.7)), rtol=1e-6)


def test_the_linear_model_has_the_sensitivities_of_the_integrator():
    """Oracle: the linear model of the equation without algebraic variables, in a steady state.

    Elsewhere the derivative of x(k+1) follows the trajectory over the sample, and that of the equation does not.
    """
    at = At(u=8.0, guess=0.1)
    ours, theirs = (linearise(TS, made, at=at, noise=NOISE) for made in (two_tanks(), two_tanks(dae())))
    np.testing.assert_allclose(theirs.A, ours.A, atol=1e-7)
    np.testing.assert_allclose(theirs.B, ours.B, atol=1e-9)
    assert not dynamics_of(two_tanks(dae())).continuous


def test_the_guess_of_the_algebraic_variables_selects_the_solution():
    """z^2 = 4 has two solutions, and x' = z gives x(k+1) = +-2 Ts; Newton's method has no step from z = 0."""
    x, z = casadi.SX.sym("x"), casadi.SX.sym("z")
    equation = {"x": x, "z": z, "ode": z, "alg": z * z - 4.0}
    zero = np.zeros((1, 1))
    ends = []
    for guess in (0.3, -0.3):
        made = plant(0.1, STEPS, casadi=equation, algebraic={"speed": guess})
        ends.append(made.step(0, made.draw({}, [None], STEPS), zero, np.zeros((1, 0)), zero).x[0, 0])
    np.testing.assert_allclose(ends, [0.2, -0.2], rtol=1e-6)
    with pytest.raises(DesignError, match="dae fails at x.0 = 0: SolverError"):
        plant(0.1, STEPS, casadi=equation)


@pytest.mark.parametrize(
    ("keys", "key", "message"),
    [
        ({"solver": Solver()}, "solver", "no effect on an equation with z"),
        ({"discrete": True}, "discrete", "has time derivatives"),
        ({"algebraic": {"q": 1.0}}, "algebraic", "has 1 entries; z has 2"),
        ({"options": {"reltoll": 1.0}}, "options", "Unknown option: reltoll"),
    ],
)
def test_mistakes_are_reported_at_their_key(keys, key, message):
    """Each message names the entry that does not fit."""
    with pytest.raises(DesignError, match=message) as caught:
        two_tanks(dae(), **keys)
    assert caught.value.parameter == key


def test_a_consistent_state_at_which_the_default_of_idas_fails():
    """A pendulum whose acceleration z is nearly 0; with its own first time, idas finds no consistent derivatives."""
    t, x, z, u, p = (casadi.SX.sym(name, n) for name, n in (("t", 1), ("x", 2), ("z", 1), ("u", 1), ("p", 2)))
    residual = z + p[0] * casadi.sin(x[0]) + p[1] * x[1] - u - 0.2 * casadi.cos(t) + 0.1 * z**3
    given = {"t": t, "x": x, "z": z, "u": u, "p": p, "ode": casadi.vertcat(x[1], z), "alg": residual}
    rng = np.random.default_rng(0)
    # The last of these states is one of them.
    state, acting = [(rng.standard_normal(2), rng.standard_normal(1)) for _ in range(589)][-1]
    naive, ours, other = (
        sampled_dae(given, 0.1, name, options, None)[0]
        for name, options in (("idas", {"first_time": 0.1}), ("idas", {}), ("collocation", {}))
    )
    with pytest.raises(RuntimeError):
        naive(58.8, state, acting, [2.0, 0.3])
    expected = other(58.8, state, acting, [2.0, 0.3])
    np.testing.assert_allclose(ours(58.8, state, acting, [2.0, 0.3]), expected, rtol=0.0, atol=1e-6)
