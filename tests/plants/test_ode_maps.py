"""Maps x(k+1) = rhs(k Ts, x, u, p) as plants, and the design models made from them."""

import numpy as np
import pytest
from conftest import EXACT, ROUND
from plants import tanks
from plants.test_ode_ends import STEPS, Nothing

from rmpc_bench.models.dynamics import dynamics_of
from rmpc_bench.models.linearised import design as linearise
from rmpc_bench.models.linearised import relinearised
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design as nonlinear
from rmpc_bench.models.nonlinear import design_ode as ode_model
from rmpc_bench.models.operating_point import At
from rmpc_bench.numerics.integration import rk4, sample_times
from rmpc_bench.plants.ode import design
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.simulation.open_loop import Rest
from rmpc_bench.simulation.run_start import RunStart
from rmpc_bench.simulation.scenario import Draws
from rmpc_bench.types import DesignError, Journal, Method, Status

TS, SUBSTEPS = 5.0, 6
NOISE = DesignNoise(process=1e-6, measurement=4e-6)
NAMES = {"states": ["h1", "h2"], "inputs": ["pump"], "outputs": ["level"], "output": tanks.output}
A, B = np.array([[0.9, 0.2], [-0.1, 0.7]]), np.array([[0.0], [0.5]])


def sampled_tanks(x, u, p):
    """The tanks over a sample, by the method of the plant."""
    columns = x.reshape(2, -1)
    inputs, times = u.reshape(1, -1), sample_times(0, SUBSTEPS, TS)
    end = rk4(lambda t, z: np.array(tanks.rhs(z, inputs, p)), times, columns, TS / SUBSTEPS)
    return end.x.reshape(x.shape)


def linear(x, u, p):
    """x(k+1) = A x(k) + B u(k), with a gain of the input."""
    return [0.9 * x[0] + 0.2 * x[1], -0.1 * x[0] + 0.7 * x[1] + 0.5 * p.k * u[0]]


def mapped(ode=linear, **keys):
    """Return a map as plant."""
    names = {"states": ["a", "b"], "inputs": ["f"], "parameters": {"k": 1.0}}
    return design(TS, STEPS, ode=ode, discrete=True, **{**names, **keys})


def test_a_map_of_runge_kutta_steps_is_the_plant_that_takes_them():
    """Oracle: the plant of the differential equation, bit for bit, for a block and for a run alone."""
    given = {**NAMES, "parameters": tanks.PARAMETERS, "x0": [0.2, 0.1]}
    as_map = design(TS, STEPS, ode=sampled_tanks, discrete=True, **given)
    as_equation = design(TS, STEPS, ode=tanks.rhs, solver=Solver(substeps=SUBSTEPS), **given)
    rng = np.random.default_rng(0)
    drawn = {name: value * rng.uniform(0.9, 1.1, 9) for name, value in tanks.PARAMETERS.items()}
    x, u, w = rng.uniform(0.05, 0.4, (9, 2)), rng.uniform(0.0, 20.0, (9, 1)), 1e-3 * rng.standard_normal((9, 2))
    assert as_map.ode.rhs_takes_blocks
    moved = [plant.step(3, plant.draw(drawn, [None] * 9, STEPS), x, u, w) for plant in (as_map, as_equation)]
    np.testing.assert_allclose(moved[0].x, moved[1].x, **EXACT)
    alone = as_map.draw({name: each[4:5] for name, each in drawn.items()}, [None], STEPS)
    np.testing.assert_allclose(as_map.step(3, alone, x[4:5], u[4:5], w[4:5]).x, moved[0].x[4:5], **EXACT)


def test_a_linear_map_is_its_own_linear_model():
    """Oracle: the matrices; the poles are not sampled again."""
    made = linearise(TS, mapped(), at=At(x=[0.3, -0.2], u=0.7), noise=NOISE)
    np.testing.assert_allclose(made.A, A, atol=1e-9)
    np.testing.assert_allclose(made.B, B, atol=1e-9)
    x, u = np.array([0.3, -0.2]), np.array([0.7])
    np.testing.assert_allclose(made.A @ x + made.B @ u + made.f0, A @ x + B @ u, **ROUND)
    assert not [text for label, text in made.facts() if label == "eigenvalues"]


def test_the_steady_state_of_a_map_is_a_fixed_point():
    """Oracle: x = (I - A)^-1 B u."""
    made = linearise(TS, mapped(), at=At(u=2.0, guess=0.1), noise=NOISE)
    np.testing.assert_allclose(made.operating_point.x, np.linalg.solve(np.eye(2) - A, B @ [2.0]), rtol=1e-9)


@pytest.mark.parametrize("numba", [False, True])
@pytest.mark.long
def test_the_nonlinear_model_of_a_map_is_the_map(numba):
    """Oracle: the function of the user, once per sample."""
    if numba:
        pytest.importorskip("numba")
    model = nonlinear(TS, mapped(), noise=NOISE, numba=numba)
    x, u = np.array([0.3, -0.2]), np.array([0.7])
    np.testing.assert_allclose(model.f(x, u), linear(x, u, model.p), **ROUND)
    np.testing.assert_allclose(model.F(x, u), A, atol=1e-9)
    assert model.facts() == []


def test_a_map_has_no_substeps():
    """A design model of a map refuses what only an integration has."""
    with pytest.raises(DesignError, match="has no effect") as caught:
        nonlinear(TS, mapped(), noise=NOISE, substeps=4)
    assert caught.value.parameter == "substeps"


def test_a_map_that_depends_on_the_time_takes_that_of_its_sample():
    """Oracle: t = k Ts exactly, in the plant, in the nonlinear model and in the linear one of a sample."""

    def counted(t, x, u, p):
        return [x[0] + t * u[0]]

    plant = mapped(counted, states=["s"], parameters={})
    delta, zero = plant.draw({}, [None], STEPS), np.zeros((1, 1))
    assert plant.step(7, delta, zero, zero + 1.0, zero).x.tolist() == [[7 * TS]]
    assert nonlinear(TS, plant, noise=NOISE).f([0.0], [1.0], 7).tolist() == [7 * TS]
    around = relinearised(dynamics_of(plant), TS, NOISE).around(7, zero, zero)
    np.testing.assert_allclose(around.B, [[[7 * TS]]], rtol=1e-9)


def test_a_design_model_may_be_a_map_of_its_own():
    """Oracle: the map; with an operating point its matrices."""
    plant = design(TS, STEPS, ode=tanks.rhs, solver=Solver(substeps=2), **{**NAMES, "parameters": tanks.PARAMETERS},
                   x0=[0.2, 0.1])  # fmt: skip
    given = {"ode": linear, "output": tanks.output, "noise": NOISE, "parameters": {"k": 2.0}, "discrete": True}
    model = ode_model(TS, plant, **given)
    np.testing.assert_allclose(model.f([0.3, -0.2], [0.7]), A @ [0.3, -0.2] + 2.0 * B @ [0.7], **ROUND)
    np.testing.assert_allclose(ode_model(TS, plant, **given, at=At(x=0.0, u=0.0)).B, 2.0 * B, atol=1e-9)


@pytest.mark.parametrize("in_block", [True, False])
def test_a_map_that_leaves_its_bounds_ends_the_run_where_it_stood(in_block):
    """Oracle: x doubles at every sample, so that 1 leaves [0, 100] with 128, at the end of sample 6."""

    def doubling(x, u, p):
        return [2.0 * x[0]] if in_block else [2.0 * float(x[0])]

    plant = mapped(doubling, states=["s"], parameters={}, bounds={"s": [0.0, 100.0]}, x0=[1.0])
    assert plant.ode.rhs_takes_blocks is in_block
    journal, w, v = Journal(), np.zeros((2, STEPS + 1, 1)), np.zeros((2, STEPS + 1, 1))
    draws = Draws(plant.draw({}, [None] * 2, STEPS), np.array([[1.0], [0.0]]), w, v)
    method = Method("M", Nothing(), Rest(1))
    record, status = simulate(plant, method, draws, np.zeros((STEPS + 1, 1)), STEPS, start=RunStart(1, (0, 1), journal))
    assert status.tolist() == [Status.OUT_OF_RANGE, Status.OK]
    assert record.x[0, :8, 0].tolist() == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 64.0]
    assert journal.failures[0].message == f"s left its bounds [0, 100] at {7 * TS:g} s"


def test_the_facts_of_a_map_say_what_it_is():
    """No integration is printed for a map."""
    facts = dict(mapped().facts())
    assert facts["equation"] == "x(k+1) = linear(x, u, p)"
    assert "solver" not in facts


@pytest.mark.parametrize("key", ["solver", "events"])
def test_keys_of_an_integration_are_refused(key):
    """There is nothing within a sample that could be integrated or located."""

    def event(x, u, p):
        return x[0]

    event.word = "stop"
    with pytest.raises(DesignError, match="discrete: true") as caught:
        mapped(**{key: {"solver": Solver("LSODA"), "events": event}[key]})
    assert caught.value.parameter == key
